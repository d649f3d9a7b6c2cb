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
from mavfi.report.text import rate, shown
from tools import results
from tools.markers import DOCS, IMAGES, ROOT, fill

NAME, PAGE = "mavfi-bench-1", "leaderboard"
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
"""Rule of docs/engineers.md that protects each site of the part `sites`."""
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
        kept = frozen / f"{faults.parent.name}-{scale}.csv"
        if kept.is_file() and kept.read_bytes() != faults.read_bytes():
            raise BadInputError(f"{faults}: other faults than those of {kept.name}, which is frozen; remove it first")
        shutil.copy(faults, kept)


def text_rows(full: Table) -> list[Row]:
    """Rows of a table as text by heading."""
    columns, cells = shown(full)
    return [dict(zip([column.heading for column in columns], line, strict=True)) for line in cells]


def merged(flown: Sequence[Row], published: Sequence[Row], schemes: Sequence[str]) -> list[Row]:
    """Rows that were flown, and published rows of schemes that were not, in the order of the bench.

    Args:
        flown: Rows of a part; the scheme is in column `scheme`, or in column `setting` within an environment.
        published: The rows so far; those of schemes that the bench no longer has are dropped.
        schemes: Schemes of the bench.
    """
    new = {_group_and_scheme(row) for row in flown}
    rows = [row for row in published if _group_and_scheme(row) not in new and _group_and_scheme(row)[1] in schemes]
    rows += flown
    groups = list(dict.fromkeys(_group_and_scheme(row)[0] for row in rows))
    places = {scheme: place for place, scheme in enumerate(schemes)}

    def order(row: Row) -> tuple[int, int]:
        group, scheme = _group_and_scheme(row)
        return groups.index(group), places.get(scheme, len(places))

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
        rows = merged(
            text_rows(table(load(folder / name), part.view)), published_rows(bench, name, scale), [*bench.arms]
        )
        path = ROOT / "configs" / FOLDER / NAME / f"{name}-{scale}{ROWS}"
        _write_rows(path, rows)


def publish_scores(bench: Bench, folder: Path) -> None:
    """Write the tables that combine parts, if they were computed; schemes that were not scored keep their rows."""
    for name in (SCORES,):
        path = results.TABLES / PAGE / f"{name}.csv"
        if (folder / path.name).is_file():
            earlier = _read_rows(path) if path.is_file() else []
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
    return OBSERVER if part.mission.get("coupling") == "observer" else level


def brought_back(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> Counts:
    """Missions brought back, and lost, by scheme and group, in parts that were flown with every detector."""
    by_scheme = {name: {row["scheme"]: row for row in part if "scheme" in row} for name, part in rows.items()}
    flown = {scheme for part in by_scheme.values() for scheme in part}
    detectors = {name for name, arm in bench.arms.items() if arm.detector} & flown
    found: Counts = {}
    for name, part in by_scheme.items():
        if detectors <= part.keys():
            for scheme, row in part.items():
                if count := _COUNT.search(row.get(BACK, "")):
                    _add(found, scheme, group_of(bench.parts[name]), (int(count[1]), int(count[2])))
    return found


def lost_alone(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> Counts:
    """Missions lost by a scheme alone, and flown, by scheme and group, over all parts."""
    found: Counts = {}
    for name, part in rows.items():
        for row in part:
            for lost, flown in LOST_ALONE.items():
                if "scheme" in row and row.get(lost, "").isdecimal() and row.get(flown, "").isdecimal():
                    _add(found, row["scheme"], group_of(bench.parts[name]), (int(row[lost]), int(row[flown])))
    return found


def _add(found: Counts, scheme: str, group: str, more: tuple[int, int]) -> None:
    before = found.setdefault(scheme, {}).get(group, (0, 0))
    found[scheme][group] = before[0] + more[0], before[1] + more[1]


def false_alarms(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> dict[str, dict[str, str]]:
    """False alarms per hour in all environments, by autopilot profile and scheme."""
    return {
        bench.parts[name].mission.get("autopilot", "published"): {
            row["setting"].removeprefix(GOLDEN): row["per hour"] for row in part if row["environment"] == TOTAL[1]
        }
        for name, part in rows.items()
        if bench.parts[name].view == "false_alarms"
    }


def _sums(name: str, title: str, found: Counts, more: Mapping[str, Mapping[str, str]], notes: Sequence[str]) -> Table:
    """A row for each scheme, a rate for each group, then further columns as text; the highest sums first."""
    groups = [group for group in (*GROUPS, OBSERVER) if any(group in own for own in found.values())]
    columns = [Column("scheme", "scheme"), *(Column(group.replace(" ", "_"), group, RATE) for group in groups)]
    columns += [Column(re.sub(r"\W+", "_", heading), heading) for heading in more]
    order = sorted(found, key=lambda scheme: -sum(found[scheme].get(group, (0, 0))[0] for group in GROUPS))
    rows = []
    for scheme in order:
        rates = [wilson(*found[scheme][group]) if group in found[scheme] else None for group in groups]
        rows.append((scheme, *rates, *(cells.get(scheme) for cells in more.values())))
    return Table(name, title, tuple(columns), rows, notes=tuple(notes))


def summary(bench: Bench, rows: Mapping[str, Sequence[Row]]) -> dict[str, Table]:
    """Tables of what each scheme brings back, and of what it loses alone, summed over the parts."""
    alarms = {f"false alarms/h, {profile}": own for profile, own in false_alarms(bench, rows).items()}
    back = _sums(
        "summary",
        "Missions brought back, of those lost to the fault",
        brought_back(bench, rows),
        alarms,
        [
            "brought back / lost, over the parts that were flown with every detector; per cent, [95 % interval: "
            "Wilson, "
            "flights in one world taken as independent]; false alarms: per hour of flight without a fault, by "
            "autopilot "
            "profile, all environments"
        ],
    )
    alone = _sums(
        "lost_alone",
        "Missions lost by the scheme alone, of those with a fault",
        lost_alone(bench, rows),
        {},
        [
            "lost alone: success without the scheme, failure with it, over all parts; golden flights lost by "
            "the scheme "
            "alone count as lost; at level instruction only faults in the same value are compared"
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
    injected = table(load(sites), "schemes_by_target").entries()
    for target, number in RULES.items():
        own = {entry["arm"]: entry for entry in injected if entry["target"] == target}
        lines.append(_rule_row(number, target, own[PAPERS]["lost"], own[PAPERS]["back"], own[OURS]["back"]))
    nodes = {entry["arm"]: entry for entry in table(load(instructions), "schemes_instructions").entries()}
    died, papers = nodes[OURS]["died_back"], nodes[PAPERS]["died_back"]
    lines.append(_rule_row(5, "the planner's instructions: it dies", died.n, papers, died))
    return "\n".join(lines)


def _rule_row(number: int, target: str, lost: int, papers: Rate, ours: Rate) -> str:
    return f"| {number} | {target} | {lost} | {rate(papers)} | {rate(ours)} |"


def headline(bench: Path) -> str:
    """Missions recovered by the paper's detectors and by the recommended scheme, by level, for README.md.

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
    return "\n".join(
        [
            "**And what brings them back?** Missions in `dense` and `factory` lost to one flipped bit, and how many of "
            "them a detector saves:",
            "",
            *lines,
            "",
            f"{_alarms(bench)}{moved}`recommended` consists of rules of physics and protocol; nothing is trained. "
            f"[Leaderboard](docs/results/{PAGE}.md), with intervals; [five rules](docs/engineers.md) for a "
            f"stack of your "
            "own.",
        ]
    )


def _alarms(bench: Path) -> str:
    """A sentence with the false alarms of the same schemes on golden flights; "" if these were not flown."""
    try:
        every = table(load(bench / "golden"), "false_alarms").entries()
    except BadInputError:
        return ""
    rates = {entry["setting"]: entry["per_hour"] for entry in every if entry["environment"] == TOTAL[1]}
    known = [(arm, rates[f"{GOLDEN}{arm}"]) for arm in (PAPERS, PAPERS_OTHER, OURS) if f"{GOLDEN}{arm}" in rates]
    told = ", ".join(f"{one.per_hour:.1f} [{one.low:.1f}, {one.high:.1f}] (`{arm}`)" for arm, one in known)
    return f"False alarms per hour of flight without a fault: {told}. "


def _share(back: Rate, lost: int) -> str:
    """E.g. "3 (50 %)"; with the number of which, if not all lost missions can be compared."""
    share = "—" if back.rate is None else f"{100 * back.rate:.0f} %"
    return f"{back.successes}{'' if back.n == lost else f' of {back.n}'} ({share})"


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
        "cost of detection: [models](../models.md#recommended); alarms that come late: [ROS](../ros.md#coupling); "
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
    folder = Path("out") / (f"bench-{scale}" if bench == NAME else f"{bench}-{scale}")
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
    folder, scale = (Path(arguments[0]), arguments[1]) if arguments else (fly(PUBLISHED), PUBLISHED)
    try:
        compared = set(load(folder / "sites").values("arm")) if (folder / "sites").is_dir() else set()
        if not any((folder / part).is_dir() for part in bench.parts):
            raise BadInputError(f"{folder}: no part of {NAME}; run `mavfi bench detectors`")
        freeze(folder, scale)
        publish(bench, folder, scale)
        if scale != PUBLISHED:
            return 0
        publish_scores(bench, folder)
        if (folder / "curves.png").is_file():
            picture = "curves-paper.png" if PAPERS in compared else "curves-paper-others.png"
            shutil.copy(folder / "curves.png", IMAGES / picture)
        print(f"wrote {write_page(bench).relative_to(ROOT)}")
        if {PAPERS, PAPERS_OTHER, OURS} <= compared and (folder / "instruction").is_dir():
            fill(DOCS / "engineers.md", {"rules": rules(folder / "sites", folder / "instruction")})
            fill(ROOT / "README.md", {"recovery": headline(folder)})
    except (BadInputError, OSError) as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
