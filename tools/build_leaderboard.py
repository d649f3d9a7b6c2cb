"""Publish a completed bench: its fault lists, the rows of its parts, docs/results/leaderboard.md, README, engineers.md.

    make results NAME=leaderboard                    # flies mavfi-bench-1 at scale paper, hours
    python -m tools.build_leaderboard out/bench quick
    python -m tools.build_leaderboard page           # the page alone, from the rows

Rows are kept in configs/bench/mavfi-bench-1/PART-SCALE.rows.csv: `mavfi bench` shows them beside a custom detector.
Schemes that were not flown keep their rows: all are of the same frozen faults.  Only scale paper has a page.
"""

import csv
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from mavfi.analysis.flight_views import TOTAL
from mavfi.analysis.statistics import Rate, wilson
from mavfi.analysis.table import RATE, Column, Table
from mavfi.api import load, table
from mavfi.campaign.config import load_campaign
from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import FOLDER, ROWS, SCORES, Bench, BenchPart, level_of, load_bench, published_rows
from mavfi.extras.bench.leaderboard import text_rows
from mavfi.report.text import rate
from tools import results
from tools.build_readme import recommended_item
from tools.markers import DOCS, IMAGES, ROOT, fill

NAME = "mavfi-bench-1"
PAGE = "leaderboard"
PUBLISHED = "paper"
"""The scale that has a page."""
RULES = {
    "collision flag": 1,
    "collision counter": 1,
    "path epoch": 2,
    "trajectory epochs": 2,
    "path vertices": 3,
    "way-point": 4,
}
"""Rule of docs/concepts/engineers.md that protects each site of the part `sites`."""
LEVELS = {
    "state": "a value between kernels, every stage alike",
    "sites": "a value between kernels, fields and bits that lose most",
    "message": "a message between kernels: sign, exponent or length of a list",
    "instruction": "an instruction of the planner",
    "memory": "what a node remembers: the words that lose most",
}
"""Parts in README.md, and the place of their faults in words."""
PAPERS = "gaussian"
PAPERS_OTHER = "autoencoder"
OURS = "recommended"
"""Schemes that are compared in README.md: the paper's two detectors and this project's."""
SHOWN = (
    OURS,
    "acceptance",
    "limits",
    "autoencoder all",
    "pca",
    PAPERS,
    "gaussian tuned",
    PAPERS_OTHER,
    "autoencoder tuned",
    "readback",
    "random",
)
"""Schemes on the page; the table has all."""
GROUPS = ("state", "message", "instruction", "memory")
OBSERVER = "coupling observer"
"""A group of its own: no scheme is made for alarms that come after the value was read."""
LOST_ALONE = {"only it lost": "faults", "of these, only it lost": "same value injected"}
"""Heading of the missions lost by the scheme alone, and of those that were flown, by the view of a part."""
BACK = "brought back"
GOLDEN = "golden_"
"""What the names of settings with a detector and without a fault begin with."""
TEXT = (
    "Rules of physics and protocol (`recommended`) bring back every lost mission at every level without a false alarm; "
    "learned limits bring back as much at state level, and nothing where a node dies or its memory is hit. Each scheme "
    "flies the same missions with the same faults. A detector of your own, beside these rows: "
    "`mavfi bench detectors --detector my_package:MyDetector --scale paper`."
)
_OF = re.compile(r"\d of \d")
_MOVED = 'Where a cell says "of", only faults in the same value count: the scheme\'s false alarms move the others. '
_COUNT = re.compile(r"(\d+)/(\d+)$")
Row = dict[str, str]
Counts = dict[str, dict[str, tuple[int, int]]]
"""Missions of a kind, and all of which they are a part, by scheme and group of parts."""


# ---- published rows -------------------------------------------------------------------------------------------------
def freeze(bench: Path, scale: str) -> None:
    """Copy the fault lists of a completed bench to the shipped configurations.

    Raises:
        BadInputError: A different list is already shipped: frozen lists are not overwritten.
    """
    frozen = ROOT / "configs" / FOLDER / NAME
    frozen.mkdir(exist_ok=True)
    for faults in sorted(bench.glob("*/faults.csv")):
        copy = frozen / f"{faults.parent.name}-{scale}.csv"
        if copy.is_file() and copy.read_bytes() != faults.read_bytes():
            raise BadInputError(f"{faults}: other faults than those of {copy.name}, which is frozen; remove it first")
        shutil.copy(faults, copy)


def merged(flown: Sequence[Row], published: Sequence[Row], schemes: Sequence[str]) -> list[Row]:
    """Rows that were flown, and published rows of schemes that were not, in the order of the bench.

    Args:
        flown: Rows of a part; the scheme is in column `scheme`, or in column `setting` within an environment.
        published: The rows so far; those of schemes that the bench no longer has are dropped.
        schemes: Schemes of the bench.
    """
    # published rows that are still valid, then those that were flown
    replaced = {_group_and_scheme(row) for row in flown}
    rows = []
    for row in published:
        group_and_scheme = _group_and_scheme(row)
        if group_and_scheme not in replaced and group_and_scheme[1] in schemes:
            rows.append(row)
    rows += flown

    # groups in the order of their first rows, in each the schemes in the order of the bench
    groups = list(dict.fromkeys(_group_and_scheme(row)[0] for row in rows))
    positions = {scheme: position for position, scheme in enumerate(schemes)}

    def order(row: Row) -> tuple[int, int]:
        group, scheme = _group_and_scheme(row)
        return groups.index(group), positions.get(scheme, len(positions))

    return sorted(rows, key=order)


def _group_and_scheme(row: Mapping[str, str]) -> tuple[str, str]:
    """Environment ("" if the rows are not by environment), and scheme."""
    for heading in ("scheme", "arm"):
        if heading in row:
            return "", row[heading]
    return row["environment"], row["setting"].removeprefix(GOLDEN)


def publish(bench: Bench, folder: Path, scale: str) -> None:
    """Write the rows of all parts that were flown to the shipped configurations."""
    for name, part in bench.parts.items():
        if not (folder / name).is_dir():
            continue
        flown = text_rows(table(load(folder / name), part.view))
        rows = merged(flown, published_rows(bench, name, scale), [*bench.arms])
        path = ROOT / "configs" / FOLDER / NAME / f"{name}-{scale}{ROWS}"
        _write_rows(path, rows)


def publish_scores(bench: Bench, folder: Path) -> None:
    """Write the tables that combine parts, if they were computed; schemes that were not scored keep their rows."""
    for name in (SCORES,):
        path = results.TABLES / PAGE / f"{name}.csv"
        if (folder / path.name).is_file():
            earlier: list[Row] = []
            if path.is_file():
                earlier = _read_rows(path)
            _write_rows(path, merged(_read_rows(folder / path.name), earlier, [*bench.arms]))


def _read_rows(path: Path) -> list[Row]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _write_rows(path: Path, rows: Sequence[Row]) -> None:
    headings = list(dict.fromkeys(heading for row in reversed(rows) for heading in row))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, headings, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


# ---- sums over the parts --------------------------------------------------------------------------------------------
def group_of(part: BenchPart) -> str:
    """Group of a part: a level, or the coupling under which alarms come late; "" = it is not counted."""
    level = level_of(load_campaign(part.campaign))
    if level not in GROUPS:
        return ""
    if part.mission.get("coupling") == "observer":
        return OBSERVER
    return level


def brought_back(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> Counts:
    """Missions brought back, and lost, by scheme and group, in parts that were flown with every detector."""
    by_scheme = {name: {row["scheme"]: row for row in part if "scheme" in row} for name, part in rows.items()}
    flown = {scheme for part in by_scheme.values() for scheme in part}
    detectors = {name for name, arm in bench.arms.items() if arm.detector} & flown
    counts: Counts = {}
    for name, part in by_scheme.items():
        if not detectors <= part.keys():
            continue
        group = group_of(bench.parts[name])
        for scheme, row in part.items():
            count = _COUNT.search(row.get(BACK, ""))
            if count is not None:
                _add(counts, scheme, group, (int(count[1]), int(count[2])))
    return counts


def lost_alone(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> Counts:
    """Missions lost by a scheme alone, and flown, by scheme and group, over all parts."""
    counts: Counts = {}
    for name, part in rows.items():
        for row in part:
            for lost, flown in LOST_ALONE.items():
                if "scheme" in row and row.get(lost, "").isdecimal() and row.get(flown, "").isdecimal():
                    _add(counts, row["scheme"], group_of(bench.parts[name]), (int(row[lost]), int(row[flown])))
    return counts


def _add(counts: Counts, scheme: str, group: str, count: tuple[int, int]) -> None:
    """Add a count of missions, and of all of which they are a part, to those of a scheme and group."""
    missions, total = counts.setdefault(scheme, {}).get(group, (0, 0))
    counts[scheme][group] = (missions + count[0], total + count[1])


def false_alarms(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> dict[str, dict[str, str]]:
    """False alarms per hour in all environments, by autopilot profile and scheme."""
    rates = {}
    for name, part in rows.items():
        if bench.parts[name].view == "false_alarms":
            profile = bench.parts[name].mission.get("autopilot", "published")
            rates[profile] = {
                row["setting"].removeprefix(GOLDEN): row["per hour"] for row in part if row["environment"] == TOTAL[1]
            }
    return rates


def _sums(name: str, title: str, counts: Counts, more: Mapping[str, Mapping[str, str]], notes: Sequence[str]) -> Table:
    """A row for each scheme, a rate for each group, then further columns as text; the highest sums first."""
    groups = [group for group in (*GROUPS, OBSERVER) if any(group in by_group for by_group in counts.values())]
    columns = [Column("scheme", "scheme"), *(Column(group.replace(" ", "_"), group, RATE) for group in groups)]
    columns += [Column(re.sub(r"\W+", "_", heading), heading) for heading in more]

    def missions(scheme: str) -> int:
        return sum(counts[scheme].get(group, (0, 0))[0] for group in GROUPS)

    rows = []
    for scheme in sorted(counts, key=missions, reverse=True):
        cells: list[Rate | str | None] = []
        for group in groups:
            count = counts[scheme].get(group)
            cells.append(None if count is None else wilson(*count))
        cells += [texts.get(scheme) for texts in more.values()]
        rows.append((scheme, *cells))
    return Table(name, title, tuple(columns), rows, notes=tuple(notes))


def summary(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> dict[str, Table]:
    """Tables of what each scheme brings back, and of what it loses alone, summed over the parts."""
    # the table of what comes back has the false alarms beside it
    alarms = {f"false alarms/h, {profile}": rates for profile, rates in false_alarms(bench, rows).items()}
    back = _sums(
        "summary",
        "Missions brought back, of those lost to the fault",
        brought_back(bench, rows),
        alarms,
        [
            "brought back / lost, over the parts that were flown with every detector; per cent, [95 % interval: "
            "Wilson, flights in one world taken as independent]; false alarms: per hour of flight without a fault, by "
            "autopilot profile, all environments"
        ],
    )
    alone = _sums(
        "lost_alone",
        "Missions lost by the scheme alone, of those with a fault",
        lost_alone(bench, rows),
        {},
        [
            "lost alone: success without the scheme, failure with it, over all parts; golden flights lost by the "
            "scheme alone count as lost; at level instruction only faults in the same value are compared"
        ],
    )
    return {"summary": back, "lost_alone": alone}


# ---- docs -----------------------------------------------------------------------------------------------------------
def rules(sites: Path, instructions: Path) -> str:
    """Benefit of each rule: missions lost to faults at its site, and recovered by the paper's GAD and by the rules.

    Raises:
        BadInputError: A folder holds no ledger.
    """
    lines = ["| rule | fault in | lost | back, GAD of the paper | back, recommended |", "|---|---|---:|---:|---:|"]
    entries_of_sites = table(load(sites), "schemes_by_target").entries()
    for target, number in RULES.items():
        entries = {entry["arm"]: entry for entry in entries_of_sites if entry["target"] == target}
        papers = entries[PAPERS]
        lines.append(_rule_row(number, target, papers["lost"], papers["back"], entries[OURS]["back"]))

    # the fifth rule restarts a node that has died
    entries = {entry["arm"]: entry for entry in table(load(instructions), "schemes_instructions").entries()}
    papers_back = entries[PAPERS]["died_back"]
    ours_back = entries[OURS]["died_back"]
    lines.append(_rule_row(5, "the planner's instructions: it dies", ours_back.n, papers_back, ours_back))
    return "\n".join(lines)


def _rule_row(number: int, target: str, lost: int, papers: Rate, ours: Rate) -> str:
    return f"| {number} | {target} | {lost} | {rate(papers)} | {rate(ours)} |"


def headline(bench: Path) -> str:
    """Missions recovered by the paper's detectors and by the recommended scheme, by level, for README.md.

    Levels that were not flown, or not with all three, are left out.

    Raises:
        BadInputError: No level is left.
    """
    # a row for each level that was flown with all three schemes
    lines = [
        "| one flipped bit in | lost | the paper's Gaussian detector | its autoencoder | `recommended` |",
        "|---|---:|---:|---:|---:|",
    ]
    for part, where in LEVELS.items():
        try:
            rows = table(load(bench / part), load_bench(NAME).parts[part].view)
        except BadInputError:
            continue
        entries = {entry["arm"]: entry for entry in rows.entries()}
        if all(arm in entries for arm in (PAPERS, PAPERS_OTHER, OURS)):
            lost = entries[OURS]["lost"]
            shares = [_share(entries[arm]["back"], lost) for arm in (PAPERS, PAPERS_OTHER, OURS)]
            lines.append(f"| {where} | {lost} | {' | '.join(shares)} |")
    if len(lines) == 2:  # the heading alone
        raise BadInputError(f"{bench}: no part was flown with {PAPERS}, {PAPERS_OTHER} and {OURS}; needed: one")

    # the paragraph around them
    remark = ""
    if any(map(_OF.search, lines)):
        remark = _MOVED
    return "\n".join(
        [
            "Missions in the worlds `dense` and `factory` lost to one flipped bit, and how many of them a detector "
            "brings back:",
            "",
            *lines,
            "",
            f"{_alarms(bench)}{remark}`recommended` consists of rules of physics and protocol; nothing is trained. "
            f"[Leaderboard](docs/results/{PAGE}.md), with intervals; [five rules](docs/concepts/engineers.md) for a "
            "stack of your own.",
        ]
    )


def _alarms(bench: Path) -> str:
    """A sentence with the false alarms of the same schemes on golden flights; "" if these were not flown."""
    try:
        entries = table(load(bench / "golden"), "false_alarms").entries()
    except BadInputError:
        return ""
    rates = {entry["setting"]: entry["per_hour"] for entry in entries if entry["environment"] == TOTAL[1]}
    texts = []
    for arm in (PAPERS, PAPERS_OTHER, OURS):
        alarms = rates.get(f"{GOLDEN}{arm}")
        if alarms is not None:
            texts.append(f"{alarms.per_hour:.1f} [{alarms.low:.1f}, {alarms.high:.1f}] (`{arm}`)")
    return f"False alarms per hour of flight without a fault: {', '.join(texts)}. "


def _share(back: Rate, lost: int) -> str:
    """E.g. "3 (50 %)"; with the number of which, if not all lost missions can be compared."""
    share = "—"
    if back.rate is not None:
        share = f"{100 * back.rate:.0f} %"
    if back.n != lost:
        return f"{back.successes} of {back.n} ({share})"
    return f"{back.successes} ({share})"


def about(bench: Bench) -> list[str]:
    """Links to the rows of all parts, and to the curves."""
    folder = f"../../configs/{FOLDER}/{NAME}"
    lines = [
        f"[{part.title}]({folder}/{name}-{PUBLISHED}{ROWS}); its [faults]({folder}/{name}-{PUBLISHED}.csv)"
        for name, part in bench.parts.items()
        if (ROOT / "configs" / FOLDER / NAME / f"{name}-{PUBLISHED}{ROWS}").is_file()
    ]
    lines += [
        f"[detection against false alarms](tables/{PAGE}/{SCORES}.csv) at any threshold, as curves: "
        "[this project's detectors](../images/curves-paper.png), "
        "[other libraries' and bounds](../images/curves-paper-others.png)",
        "cost of detection: [detectors](../reference/detectors.md#cost); "
        "alarms that come late: [ROS](../how-to/ros2.md#coupling); "
        "faults that last: [their page](lasting.md)",
    ]
    return lines


def write_page(bench: Bench) -> Path:
    """Write the page from the published rows of all parts."""
    rows = {name: published_rows(bench, name, PUBLISHED) for name in bench.parts}
    excerpts = [results.Excerpt("summary", lambda row: row["scheme"] in SHOWN)]
    title = f"Leaderboard of {NAME}"
    return results.write(PAGE, title, TEXT, summary(bench, rows), excerpts, about(bench), keep=(SCORES,))


def fly(scale: str, bench: str = NAME) -> Path:
    """Fly a bench, or resume it; returns its folder."""
    folder = Path("out", f"{bench}-{scale}")
    if bench == NAME:
        folder = Path("out", f"bench-{scale}")
    command = [sys.executable, "-m", "mavfi", "bench", "detectors", bench, "--scale", scale, "--out", str(folder)]
    subprocess.run([*command, "--workers", str(os.cpu_count() or 1)], cwd=ROOT, check=True)
    return folder


def main(arguments: Sequence[str]) -> int:
    """Publish a bench; returns the exit code."""
    bench = load_bench(NAME)
    if list(arguments) == ["page"]:
        write_page(bench)
        return 0
    if len(arguments) not in (0, 2):
        print("bad input: usage: python -m tools.build_leaderboard [page | DIR SCALE]", file=sys.stderr)
        return 2
    if arguments:
        folder = Path(arguments[0])
        scale = arguments[1]
    else:
        folder = fly(PUBLISHED)
        scale = PUBLISHED
    try:
        arms: set[str] = set()
        if (folder / "sites").is_dir():
            arms = set(load(folder / "sites").values("arm"))
        if not any((folder / part).is_dir() for part in bench.parts):
            raise BadInputError(f"{folder}: no part of {NAME}; run `mavfi bench detectors`")

        # the rows, at any scale
        freeze(folder, scale)
        publish(bench, folder, scale)
        if scale != PUBLISHED:
            return 0

        # the page, its curves, and the sentences of other pages if what they compare was flown
        publish_scores(bench, folder)
        if (folder / "curves.png").is_file():
            picture = "curves-paper-others.png"
            if PAPERS in arms:
                picture = "curves-paper.png"
            shutil.copy(folder / "curves.png", IMAGES / picture)
        print(f"wrote {write_page(bench).relative_to(ROOT)}")
        if {PAPERS, PAPERS_OTHER, OURS} <= arms and (folder / "instruction").is_dir():
            fill(DOCS / "concepts" / "engineers.md", {"rules": rules(folder / "sites", folder / "instruction")})
            recovery = headline(folder)
            fill(ROOT / "README.md", {"recovery": recovery, "recommended": recommended_item(recovery)})
    except (BadInputError, OSError) as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
