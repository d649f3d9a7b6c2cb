"""Writes docs/generated/NAME.md, a page of one campaign, from its ledger; `make NAME` flies the campaign first.

python -m tools.campaign_pages NAME DIR
"""

import sys
from dataclasses import dataclass
from pathlib import Path

from mavfi.errors import BadInputError
from tools.campaign_page import page
from tools.markers import GENERATED


@dataclass(frozen=True, slots=True)
class Page:
    """Heading, paragraphs below it, and names of the views whose tables follow."""

    title: str
    text: str
    views: tuple[str, ...]


PAGES = {
    "lasting": Page(
        "Faults that last",
        "One bit of a field stays stuck at its flipped value, or several adjacent bits flip once (burst; a flag has "
        "one). Every duration has the same draws of field, instant and bit, so rows differ by the duration alone. How "
        "they are injected: [fault model](../fault-model.md#a-fault-is-data-an-injection-is-an-event); the schemes: "
        "[models](../models.md#recommended).\n\n"
        "*twice*: a second fault while a recovery runs; the resent or recomputed value is corrupted as well. *for "
        "ever*: to the end of the flight. *intermittent*: the same, in a fifth of the publications. `recommended` "
        "restarts a node at most five times, away for 2.4 s together; after that, wrong values of a fault that still "
        "lasts pass. `hold` is `recommended` with that degraded mode: it gives the mission up and keeps the vehicle in "
        "the air.",
        ("schemes", "schemes_by_duration", "schemes_by_target"),
    ),
    "protected": Page(
        "Protected kernels, a detector, and restarts",
        "Faults in instructions of the flown kernels, in plain and in protected code, without and with a detector and "
        "the restart policy that goes with it. `ten_percent` is the plan for 10 % of a flight's kernel time, `full` "
        "protects some kernels in full ([hardening](../hardening.md)); `recommended` is the acceptance test with its "
        "recovery ([models](../models.md#recommended)).",
        ("kernel_effects_by_setting", "schemes_instructions", "failures_per_hour"),
    ),
    "sensors": Page(
        "Failing sensors and motors",
        "Each fails from a random instant of the flight to its end, one of eight types in equal shares. What the types "
        "are, and how they are injected: [fault model](../fault-model.md#sensors-and-motors).",
        ("by_unit", "by_failure", "by_unit_and_environment"),
    ),
}  # fmt: skip
"""By name of the file and of the target."""


def content(name: str, ledger: Path) -> str:
    """A page; errors as of `page`."""
    own = PAGES[name]
    return page(ledger, f"make {name}", own.title, own.text, own.views)


def main(arguments: list[str]) -> int:
    """Write a page; returns the exit code."""
    if len(arguments) != 2 or arguments[0] not in PAGES:
        print(f"bad input: usage: python -m tools.campaign_pages {'|'.join(PAGES)} DIR", file=sys.stderr)
        return 2
    path = GENERATED / f"{arguments[0]}.md"
    try:
        path.write_text(content(arguments[0], Path(arguments[1])), encoding="utf-8")
    except BadInputError as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    print(f"wrote {path.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
