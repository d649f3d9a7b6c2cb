"""Fly the faults of `mavfi demo`, and write `docs/demo.md` with their pictures."""

from collections.abc import Sequence

from mavfi.extras.demo.faults import DEMOS, DETECTOR, FlownDemo, headline
from mavfi.extras.demo.page import picture_of
from tools.markers import DOCS, IMAGES, banner

PAGE = DOCS / "demo.md"
PICTURES = IMAGES / "demo"
_INTRODUCTION = f"""
    mavfi demo

flies these faults and prints what follows; `mavfi demo 3` flies one of them and draws it, and
`mavfi demo --html demo.html` writes a page on which each flight can be seen in three dimensions. Every fault is flown
three times: without it (the golden run), with it, and with it under the detector `{DETECTOR}`
([detectors](reference/detectors.md)). The command below a picture repeats these flights.
"""


def entry(flown: FlownDemo) -> str:
    """The section of a fault."""
    lines = [
        f"## {flown.number}. {flown.demo.title}",
        flown.sentence,
        f"![{flown.demo.title}](images/demo/{flown.number}.png)",
        f"    {flown.demo.command}",
    ]
    return "\n\n".join(lines)


def page(demos: Sequence[FlownDemo]) -> str:
    """The page of the faults."""
    sections = [f"# Ten faults in one mission\n\n{headline(demos)}\n{_INTRODUCTION.rstrip()}", *map(entry, demos)]
    return banner("make docs") + "\n\n".join(sections) + "\n"


def main() -> None:
    """Fly all faults, and write the page and the pictures."""
    demos = [FlownDemo(number, chosen, chosen.fly()) for number, chosen in enumerate(DEMOS, start=1)]
    PICTURES.mkdir(exist_ok=True)
    for flown in demos:
        (PICTURES / f"{flown.number}.png").write_bytes(picture_of(flown))
    PAGE.write_text(page(demos), encoding="utf-8")


if __name__ == "__main__":
    main()
