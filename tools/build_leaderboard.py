"""Write the leaderboard, the benefit of each rule in docs/engineers.md, and the frozen faults, from a completed bench.

python -m tools.build_leaderboard out/bench [quick|paper]

Scale quick is docs/generated/leaderboard.md, scale paper leaderboard-paper.md.  Scale quick, and a bench without the
paper's detectors or without faults in instructions, leave engineers.md and README.md as they are.  Sections of the page
that were not flown remain, with their date, and count in the summary at the head of the page.
"""

import csv
import re
import shutil
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from mavfi.api import load, table
from mavfi.campaign.analysis.flight_views import TOTAL
from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.bench import FOLDER, ROWS, Bench, load_bench
from mavfi.errors import BadInputError
from mavfi.reports.text import rate
from tools import detector_pages
from tools.bench_summary import cells, with_summary
from tools.markers import DOCS, GENERATED, IMAGES, ROOT, banner, contents, fill

NAME = "mavfi-bench-1"
COMMAND = "make bench-detectors"
RULES = {
    "collision flag": 1, "collision counter": 1, "path epoch": 2, "trajectory epochs": 2, "path vertices": 3,
    "way-point": 4,
}  # fmt: skip
"""Rule of the page that protects each site of the part `sites`."""
LEVELS = {
    "state": "a value between kernels, every stage alike",
    "sites": "a value between kernels, fields and bits that lose most",
    "message": "a message between kernels: sign, exponent or length of a list",
    "instruction": "an instruction of the planner",
    "memory": "what a node remembers: the words that lose most",
}
"""Parts in README.md, and the place of their faults in words."""
PAPERS, OURS = "gaussian", "recommended"
PAPERS_OTHER = "autoencoder"
CURVES = "Detection at fixed rates of false alarms"
SCORED = {CURVES, "False alarms by regime"}
"""Sections that combine parts."""
_OF = re.compile(r"\d of \d")
_MOVED = 'Where a cell says "of", only faults in the same value count: the scheme\'s false alarms move the others. '
_FLOWN = "Flown on "
_KEPT = re.compile(r"^- (.+): flown on (\S+)$", re.MULTILINE)
_UNSCORED = re.compile(r"^- .+: not scored: .+$", re.MULTILINE)
_SCORED_PARTS = re.compile(r"^- one golden flight for each mission of these parts, .+$", re.MULTILINE)
_PAIR = re.compile(r"^- (.+) against (.+): missions that only one of them .+$", re.MULTILINE)
_HERE = re.compile(r"^- flown here: (.+); the other rows are those published in .+, on the same faults$", re.MULTILINE)
_CONTENTS = re.compile(r"\n\nParts:\n\n(- \[.+\n?)+")
_COMMAND = re.compile(r"(mavfi bench detectors)(?: \S+\.yaml)?(?: --(?:part|level) \S+)*")
FOOTER = (
    "\nCost of detection, in µs per publication and share of the kernels' time: [models](../models.md#recommended). "
    "How far the vehicle strays if alarms come late, coupling `inline` and `observer`: [ROS](../ros.md#coupling). "
    "Faults that last: "
    "[their table](lasting.md).\n"
)
"""End of a page, after its picture."""


def rules(sites: Path, instructions: Path) -> str:
    """Benefit of each rule: missions lost to faults at its site, and recovered by the paper's GAD and by the rules.

    Raises:
        BadInputError: A folder holds no ledger.
    """
    lines = ["| rule | fault in | lost | back, GAD of the paper | back, recommended |", "|---|---|---:|---:|---:|"]
    injected = table(load(sites), "schemes_by_target").entries()
    for target, number in RULES.items():
        own = {entry["arm"]: entry for entry in injected if entry["target"] == target}
        lines.append(_row(number, target, own[PAPERS]["lost"], own[PAPERS]["back"], own[OURS]["back"]))
    nodes = {entry["arm"]: entry for entry in table(load(instructions), "schemes_instructions").entries()}
    died, papers = nodes[OURS]["died_back"], nodes[PAPERS]["died_back"]
    lines.append(_row(5, "the planner's instructions: it dies", died.n, papers, died))
    return "\n".join(lines)


def headline(bench: Path, page: str = "leaderboard") -> str:
    """Missions recovered by the paper's detectors and by the recommended scheme, by level; names the page.

    Levels that were not flown, or not with all three, are left out.

    Raises:
        BadInputError: No level is left.
    """
    lines = [
        "| flipped bit in | lost | GAD of the paper | its AAD | `--detector recommended` |",
        "|---|---:|---:|---:|---:|",
    ]
    for part, where in LEVELS.items():
        try:
            found = table(load(bench / part), load_bench(NAME).parts[part].view)
        except BadInputError:
            continue
        own = {entry["arm"]: entry for entry in found.entries()}
        if all(arm in own for arm in (PAPERS, PAPERS_OTHER, OURS)):
            lost, back = own[OURS]["lost"], (own[arm]["back"] for arm in (PAPERS, PAPERS_OTHER, OURS))
            lines.append(f"| {where} | {lost} | {' | '.join(_share(one, lost) for one in back)} |")
    if len(lines) == 2:
        raise BadInputError(f"{bench}: no part was flown with {PAPERS}, {PAPERS_OTHER} and {OURS}; needed: one")
    moved = _MOVED if any(map(_OF.search, lines)) else ""
    return "\n".join([
        "**And what brings them back?** Missions in `dense` and `factory` lost to one flipped bit, and how many of "
        "them a detector saves:",
        "", *lines, "",
        f"{_alarms(bench)}{moved}`recommended` consists of rules of physics and protocol; nothing is trained. "
        f"[Leaderboard](docs/generated/{page}.md), with intervals; [five rules](docs/engineers.md) for a stack of your "
        "own.",
    ])  # fmt: skip


def _alarms(bench: Path) -> str:
    """A sentence with the false alarms of the same schemes on golden flights; "" if these were not flown."""
    try:
        every = table(load(bench / "golden"), "false_alarms").entries()
    except BadInputError:
        return ""
    rates = {entry["setting"]: entry["per_hour"] for entry in every if entry["environment"] == TOTAL[1]}
    known = [(arm, rates[f"golden_{arm}"]) for arm in (PAPERS, PAPERS_OTHER, OURS) if f"golden_{arm}" in rates]
    told = ", ".join(f"{one.per_hour:.1f} [{one.low:.1f}, {one.high:.1f}] (`{arm}`)" for arm, one in known)
    return f"False alarms per hour of flight without a fault: {told}. "


def _share(back: Rate, lost: int) -> str:
    """E.g. "3 (50 %)"; with the number of which, if not all lost missions can be compared."""
    share = "—" if back.rate is None else f"{100 * back.rate:.0f} %"
    return f"{back.successes}{'' if back.n == lost else f' of {back.n}'} ({share})"


def _row(number: int, target: str, lost: int, papers: Rate, ours: Rate) -> str:
    return f"| {number} | {target} | {lost} | {rate(papers)} | {rate(ours)} |"


def freeze(bench: Path, scale: str) -> None:
    """Copy the fault lists of a completed bench to the shipped configurations.

    Raises:
        BadInputError: A different list is already shipped: frozen lists are not overwritten.
    """
    frozen = ROOT / "configs" / FOLDER / NAME
    frozen.mkdir(exist_ok=True)
    for faults in sorted(bench.glob("*/faults.csv")):
        kept = frozen / f"{faults.parent.name}-{scale}.csv"
        if kept.is_file() and kept.read_bytes() != faults.read_bytes():
            raise BadInputError(f"{faults}: other faults than those of {kept.name}, which is frozen; remove it first")
        shutil.copy(faults, kept)


def publish(page: str, scale: str) -> None:
    """Write the rows of a leaderboard whose faults are frozen to the shipped configurations, one file per part.

    Raises:
        BadInputError: A shipped row would be lost: the page has neither it nor a newer one.
    """
    titles = {part.title: name for name, part in load_bench(NAME).parts.items()}
    written = {}
    for section in page.split("\n## ")[1:]:
        title, *lines = section.splitlines()
        grid = cells(lines)
        frozen = ROOT / "configs" / FOLDER / NAME / f"{titles.get(title)}-{scale}.csv"
        if frozen.is_file() and grid:
            kept, rows = frozen.with_suffix(ROWS), [grid[0], *grid[2:]]
            lost = _named(_rows_of(kept)) - _named(rows)
            if lost:
                raise BadInputError(
                    f"{kept}: rows of {', '.join(sorted({key[-1] for key in lost}))}: not on the page; fly them as "
                    "well, or remove the file first"
                )
            written[kept] = rows
    for kept, rows in written.items():
        with kept.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


def _rows_of(kept: Path) -> list[list[str]]:
    """Shipped rows of a part, with their headings; none if there are none."""
    if not kept.is_file():
        return []
    with kept.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def _named(rows: Sequence[Sequence[str]]) -> set[tuple[str, ...]]:
    """What identifies the rows below the headings: the scheme, or the group and the scheme."""
    keys = 1 if rows and rows[0][0] == "scheme" else 2
    return {tuple(row[:keys]) for row in rows[1:]}


def with_earlier(page: str, earlier: str, titles: Collection[str]) -> str:
    """The page in the order of an earlier one, whose sections remain where it lacks them, each with its date.

    Sections of neither the page nor `titles` are dropped: their part has gone, or has another title.  Schemes that the
    page lacks keep their rows, if faults and columns are the same.  Scores of other parts do not replace those of the
    earlier page.
    """
    top, new = _divided(page)
    head, old = _divided(earlier.partition("\n![")[0].partition(FOOTER)[0])
    flown = next((line for line in head.splitlines() if line.startswith(_FLOWN)), "")
    for title in [title for title in old if title not in titles and title not in new]:
        print(f"dropped the section {title!r}: no part has this title", file=sys.stderr)
        del old[title]
    if has_other_scores(page, earlier):
        print("kept the scores and curves of the earlier page: they are of other parts", file=sys.stderr)
        new = {title: rest for title, rest in new.items() if title not in SCORED}
    for title, rest in old.items():
        old[title] = rest if _FLOWN in rest else f"\n{flown}\n{rest}"
    for title in old.keys() & new.keys():
        if title in SCORED or _faults(new[title]) == _faults(old[title]) != []:
            new[title] = _with_rows(new[title], old[title])
        if title not in SCORED:
            new[title] = _with_pairs(new[title], old[title])
    return "\n\n".join([top, *(f"## {title}\n{rest}" for title, rest in (old | new).items())]) + "\n"


def _with_rows(section: str, earlier: str) -> str:
    """A section with the rows of an earlier one whose schemes it lacks, and notes that say when they were flown.

    Rows that were published, not flown, where a section was flown are those of the earlier one, which are newer.  A
    table in groups, e.g. by environment, has the published rows in its groups already.
    """
    if not _is_by_scheme(section):
        return _with_longer_notes(section, earlier)
    own, others = _schemes(section), _schemes(earlier)
    here = _HERE.search(section)
    flown = here[1].split(", ") if here else list(own)
    for name in (own.keys() & others.keys()).difference(flown):
        section = section.replace("\n".join(own[name]), "\n".join(others[name]), 1)
    own = _schemes(section)
    rows = {name: lines for name, lines in others.items() if name not in own}
    if not rows:
        return section
    date = next(line for line in earlier.splitlines() if line.startswith(_FLOWN)).removeprefix(_FLOWN).split()[0]
    dates = {name: date for name in rows} | {
        name: match[2] for match in _KEPT.finditer(earlier) for name in match[1].split(", ") if name in rows
    }
    notes = [found[0] for found in _UNSCORED.finditer(earlier) if found[0] not in section]
    notes += [
        f"- {', '.join(name for name in rows if dates[name] == date)}: flown on {date}"
        for date in dict.fromkeys(dates.values())
    ]
    table, kept = ("\n".join(line for lines in part.values() for line in lines) for part in (own, rows))
    return "\n".join([section.replace(table, f"{table}\n{kept}", 1), *notes])


def _with_longer_notes(section: str, earlier: str) -> str:
    """A section whose notes have the additions of an earlier one, which are on rows that were not flown again."""
    old = [line for line in earlier.splitlines() if line.startswith("- ")]
    return "\n".join(
        next((note for note in old if note.startswith(f"{line}; ")), line) for line in section.splitlines()
    )


def has_other_scores(page: str, earlier: str) -> bool:
    """Whether a page and an earlier one have scores, but of other parts."""
    own, others = (_SCORED_PARTS.findall(one) for one in (page, earlier))
    return bool(own and others) and own != others


def _faults(section: str) -> list[str]:
    """Hash of a section's faults, and the headings of its table: rows with the same ones can be in one table."""
    found = re.search(r"^- \d+ faults, sha256 (\S+):", section, re.MULTILINE)
    return [found[1], *(line for line in section.splitlines() if line.startswith("| scheme"))] if found else []


def _with_pairs(section: str, earlier: str) -> str:
    """A section with the comparisons of an earlier one between schemes whose rows have not changed."""
    own, others = _schemes(section), _schemes(earlier)
    same = {name for name in own if own[name] == others.get(name)}
    here = {found.groups() for found in _PAIR.finditer(section)}
    notes = [
        found[0] for found in _PAIR.finditer(earlier) if set(found.groups()) <= same and found.groups() not in here
    ]
    return "\n".join([section, *notes])


def in_order(page: str, bench: Bench) -> str:
    """A page with the parts, and in its tables the schemes, in the order of a bench, whenever they were flown.

    Sections that combine parts are last; a list of all sections is first.
    """
    top, found = _divided(page)
    titles = [part.title for part in bench.parts.values()]
    sections = {title: found[title] for title in sorted(found, key=[*titles, *sorted(SCORED), *found].index)}
    places = {name: place for place, name in enumerate(bench.arms)}
    for title, section in sections.items():
        groups = _schemes(section)
        before = "\n".join(line for rows in groups.values() for line in rows)
        if _is_by_scheme(section):
            ordered = [groups[name] for name in sorted(groups, key=lambda name: places.get(name, len(places)))]
        else:
            ordered = [_sorted_group(name, rows, places) for name, rows in groups.items()]
        sections[title] = section.replace(before, "\n".join(line for rows in ordered for line in rows), 1)
    top = f"{_CONTENTS.sub('', top)}\n\n{contents('Parts', sections)}"
    return "\n\n".join([top, *(f"## {title}\n{rest}" for title, rest in sections.items())]) + "\n"


def _is_by_scheme(section: str) -> bool:
    """Whether the first column of a section's table names schemes, not groups of them."""
    return next((line for line in section.splitlines() if line.startswith("|")), "").startswith("| scheme |")


def _sorted_group(group: str, rows: Sequence[str], places: Mapping[str, int]) -> list[str]:
    """Rows of a group, whose first one has its name, by the scheme in the second column (its golden flights)."""
    cells = [row.split("|") for row in rows]
    cells.sort(key=lambda row: places.get(row[2].strip().removeprefix("golden_"), len(places)))
    named = [group, *[""] * (len(rows) - 1)]
    return ["|".join(["", f" {name} ", *row[2:]]) for name, row in zip(named, cells, strict=True)]


def _schemes(section: str) -> dict[str, list[str]]:
    """Rows of a section's table by scheme; a row without one belongs to that above it."""
    found: dict[str, list[str]] = {}
    for line in [line for line in section.splitlines() if line.startswith("|")][2:]:
        name = line.split("|")[1].strip() or next(reversed(found))
        found.setdefault(name, []).append(line)
    return found


def _divided(page: str) -> tuple[str, dict[str, str]]:
    """What comes before the sections of a page, and the sections by title."""
    top, *sections = page.rstrip().split("\n## ")
    return top.rstrip(), {title: rest.rstrip() for title, _, rest in (one.partition("\n") for one in sections)}


def _pictures(bench: Path, name: str, papers: bool, kept: bool) -> str:
    """Copy the curves of a bench, with the paper's detectors or with others, unless earlier ones are kept; captions."""
    own, others = (IMAGES / f"{name.replace('leaderboard', 'curves')}{end}.png" for end in ("", "-others"))
    if (bench / "curves.png").is_file() and not kept:
        shutil.copy(bench / "curves.png", own if papers else others)
    captions = {
        own: "the detectors of this project" if others.is_file() else "the detectors above",
        others: "detectors from other libraries, and bounds",
    }
    hidden = "Of curves that coincide only the last is seen."
    return "".join(
        f"\n![Detection against false alarms](../images/{image.name})\n\n"
        f'The section "{CURVES}" as curves: {of}. {hidden}\n'
        for image, of in captions.items() if image.is_file()
    )  # fmt: skip


def main(arguments: list[str]) -> int:
    """Write the pages; returns the exit code."""
    if len(arguments) not in (1, 2):
        print("bad input: usage: python -m tools.build_leaderboard DIR [SCALE]", file=sys.stderr)
        return 2
    bench, scale = Path(arguments[0]), arguments[1] if len(arguments) == 2 else "quick"
    name = "leaderboard" if scale == "quick" else f"leaderboard-{scale}"
    try:
        compared = set(load(bench / "sites").values("arm")) if (bench / "sites").is_dir() else set()
        worth = recovery = ""
        whole = scale != "quick" and {PAPERS, PAPERS_OTHER, OURS}.issubset(compared)
        if whole and (bench / "instruction").is_dir():
            worth, recovery = rules(bench / "sites", bench / "instruction"), headline(bench, name)
        page, file = (bench / "leaderboard.md").read_text(encoding="utf-8"), GENERATED / f"{name}.md"
        page = _COMMAND.sub(r"\1", page)  # for a detector of one's own: the page has all parts of the shipped bench
        known = load_bench(NAME)
        titles = {part.title for part in known.parts.values()} | SCORED
        earlier = file.read_text(encoding="utf-8") if file.exists() else ""
        kept = has_other_scores(page, earlier)
        page = with_earlier(page, earlier, titles)
        page = _HERE.sub(r"- flown on this day: \1; the other rows earlier, on the same faults", page)
        page = with_summary(in_order(page, known), known)
        freeze(bench, scale)
        publish(page, scale)
    except (BadInputError, OSError) as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    file.write_text(
        banner(COMMAND) + page + _pictures(bench, name, PAPERS in compared, kept) + FOOTER, encoding="utf-8"
    )
    (GENERATED / detector_pages.PAGE.name).write_text(detector_pages.page(known), encoding="utf-8")
    if worth:
        fill(DOCS / "engineers.md", {"rules": worth})
        fill(ROOT / "README.md", {"recovery": recovery})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
