"""Publish a completed bench: its fault lists, the rows of its parts, docs/results/leaderboard.md, README.

    make results NAME=leaderboard                    # flies mavfi-bench-1 at scale paper, hours
    python -m tools.build_leaderboard out/bench quick
    python -m tools.build_leaderboard page           # page and README alone, from the rows

Rows are kept in configs/bench/mavfi-bench-1/PART-SCALE.rows.csv: `mavfi bench` shows them beside a custom detector.
Schemes that were not flown, or that the bench no longer has, keep their rows: all are of the same frozen faults.  Only
scale paper has a page, which shows the bench's schemes; its tables have all.
"""

import csv
import re
import shutil
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from mavfi.analysis.flight_views import TOTAL
from mavfi.analysis.statistics import wilson
from mavfi.analysis.table import RATE, Column, Table
from mavfi.api import load, table
from mavfi.campaign.config import load_campaign
from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import (
    FOLDER,
    ROWS_ENDING,
    SCORES_TABLE,
    Bench,
    level_of,
    load_bench,
    published_rows,
    scheme_of,
)
from mavfi.extras.bench.leaderboard import default_folder, text_rows
from studies.five_rules.__main__ import rules
from tools import results
from tools.build_readme import BACK, Count, count_of, recommended_item, recovery_block
from tools.markers import DOCS, IMAGES, ROOT, fill

NAME = "mavfi-bench-1"
PAGE = "leaderboard"
PUBLISHED = "paper"
"""The scale that has a page."""
GROUPS = ("state", "message", "instruction", "memory")
OBSERVER = "coupling observer"
"""A group of its own: no scheme is made for alarms that come after the value was read."""
LOST_ALONE = {"only it lost": "faults", "of these, only it lost": "same value injected"}
"""Heading of the missions lost by the scheme alone, and of those that were flown, by the view of a part."""
TEXT = (
    "Rules of physics and protocol (`recommended`) bring back every lost mission at every level without a false alarm; "
    "learned limits bring back as much at state level, and nothing where a node dies or its memory is hit. Learned "
    "models of all fields bring back no more there than `limits`, which has one limit for each field: they have left "
    "the bench, and their rows are in the tables. Each scheme flies the same missions with the same "
    "faults. A detector of your own, beside these rows: "
    "`mavfi bench detectors --detector my_package:MyDetector --scale paper`."
)
Row = dict[str, str]
Rows = Mapping[str, Sequence[Row]]
"""Rows by part."""
Counts = Mapping[str, Mapping[str, Count]]
"""By scheme and group of parts."""


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


def publish(bench: Bench, path: Path, flown: Sequence[Row]) -> None:
    """Write rows in the order of the bench; rows of schemes that were not flown remain.

    Args:
        bench: The bench.
        path: Where the rows are kept.
        flown: One for each scheme, or for each environment and scheme.
    """
    earlier: list[Row] = []
    if path.is_file():
        with path.open(encoding="utf-8", newline="") as file:
            earlier = list(csv.DictReader(file))
    rows = {(row.get("environment", ""), scheme_of(row)): row for row in (*earlier, *flown)}
    environments = list(dict.fromkeys(environment for environment, _ in rows))
    positions = {scheme: position for position, scheme in enumerate(bench.arms)}
    order = sorted(rows, key=lambda key: (environments.index(key[0]), positions.get(key[1], len(positions))))
    headings = dict.fromkeys(heading for row in (*flown, *earlier) for heading in row)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(headings), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[key] for key in order)


# ---- sums over the parts --------------------------------------------------------------------------------------------
def groups_of(bench: Bench) -> dict[str, str]:
    """By part, its level, or the coupling under which alarms come late; parts that are not counted are absent."""
    groups = {}
    for name, part in bench.parts.items():
        level = level_of(load_campaign(part.campaign))
        if level in GROUPS:
            groups[name] = level
            if part.mission.get("coupling") == "observer":
                groups[name] = OBSERVER
    return groups


def brought_back(bench: Bench, rows: Rows) -> Counts:
    """Missions brought back, and lost, in parts that were flown with every detector."""
    schemes = {name: {scheme_of(row) for row in part if BACK in row} for name, part in rows.items()}
    flown = set().union(*schemes.values())
    detectors = {name for name, arm in bench.arms.items() if arm.detector} & flown
    counts = []
    for name, group in groups_of(bench).items():
        if detectors <= schemes.get(name, set()):
            counts += [(scheme_of(row), group, count_of(row.get(BACK, ""))) for row in rows[name]]
    return _sums(counts)


def lost_alone(bench: Bench, rows: Rows) -> Counts:
    """Missions lost by a scheme alone, and flown, over all parts."""
    counts: list[tuple[str, str, Count | None]] = []
    for name, group in groups_of(bench).items():
        for row in rows.get(name, ()):
            for lost, flown in LOST_ALONE.items():
                if row.get(lost, "").isdecimal() and row.get(flown, "").isdecimal():
                    counts.append((scheme_of(row), group, (int(row[lost]), int(row[flown]))))
    return _sums(counts)


def _sums(counts: Sequence[tuple[str, str, Count | None]]) -> Counts:
    sums: dict[str, dict[str, Count]] = defaultdict(dict)
    for scheme, group, count in counts:
        if count is not None:
            missions, total = sums[scheme].get(group, (0, 0))
            sums[scheme][group] = (missions + count[0], total + count[1])
    return sums


def false_alarms(bench: Bench, rows: Rows) -> dict[str, dict[str, str]]:
    """False alarms per hour in all environments, by autopilot profile and scheme."""
    rates = {}
    for name, part in rows.items():
        if bench.parts[name].view == "false_alarms":
            profile = bench.parts[name].mission.get("autopilot", "published")
            rates[profile] = {scheme_of(row): row["per hour"] for row in part if row["environment"] == TOTAL[1]}
    return rates


def _table(name: str, title: str, counts: Counts, more: Mapping[str, Mapping[str, str]], note: str) -> Table:
    """A row for each scheme, a rate for each group, then further columns as text; the highest sums first."""
    groups = [group for group in (*GROUPS, OBSERVER) if any(group in by_group for by_group in counts.values())]
    columns = [Column("scheme", "scheme"), *(Column(group.replace(" ", "_"), group, RATE) for group in groups)]
    columns += [Column(re.sub(r"\W+", "_", heading), heading) for heading in more]
    rows = []
    for scheme in sorted(counts, key=lambda scheme: -sum(counts[scheme].get(group, (0, 0))[0] for group in GROUPS)):
        rates = [wilson(*counts[scheme][group]) if group in counts[scheme] else None for group in groups]
        rows.append((scheme, *rates, *(texts.get(scheme) for texts in more.values())))
    return Table(name, title, tuple(columns), rows, notes=(note,))


def summary(bench: Bench, rows: Rows) -> dict[str, Table]:
    """Tables of what each scheme brings back, and of what it loses alone, summed over the parts."""
    back = _table(
        "summary",
        "Missions brought back, of those lost to the fault",
        brought_back(bench, rows),
        {f"false alarms/h, {profile}": rates for profile, rates in false_alarms(bench, rows).items()},
        "brought back / lost, over the parts that were flown with every detector; per cent, [95 % interval: Wilson, "
        "flights in one world taken as independent]; false alarms: per hour of flight without a fault, by autopilot "
        "profile, all environments",
    )
    alone = _table(
        "lost_alone",
        "Missions lost by the scheme alone, of those with a fault",
        lost_alone(bench, rows),
        {},
        "lost alone: success without the scheme, failure with it, over all parts; golden flights lost by the scheme "
        "alone count as lost; at level instruction only faults in the same value are compared",
    )
    return {"summary": back, "lost_alone": alone}


# ---- docs -----------------------------------------------------------------------------------------------------------
def write_page(bench: Bench) -> Path:
    """Write the page and the blocks of README.md from the published rows of all parts."""
    rows = {name: published_rows(bench, name, PUBLISHED) for name in bench.parts}
    folder = f"../../configs/{FOLDER}/{NAME}"
    about = [
        f"[{bench.parts[name].title}]({folder}/{name}-{PUBLISHED}{ROWS_ENDING}); "
        f"its [faults]({folder}/{name}-{PUBLISHED}.csv)"
        for name in rows
        if rows[name]
    ]
    about += [
        f"[detection against false alarms](tables/{PAGE}/{SCORES_TABLE}.csv) at any threshold, "
        "[as curves](../images/curves-paper.png)",
        "cost of detection: [detectors](../reference/detectors.md#cost); alarms that come late: "
        "[ROS](../how-to/ros2.md#coupling); faults that last: [their page](lasting.md)",
    ]
    recovery = recovery_block(rows, false_alarms(bench, rows).get("published", {}))
    fill(ROOT / "README.md", {"recovery": recovery, "recommended": recommended_item(recovery)})
    excerpts = [results.Excerpt("summary", lambda row: row["scheme"] in bench.arms)]
    title = f"Leaderboard of {NAME}"
    return results.write(PAGE, title, TEXT, summary(bench, rows), excerpts, about, keep=(SCORES_TABLE,))


def main(arguments: Sequence[str]) -> int:
    """Publish a bench; returns the exit code."""
    bench = load_bench(NAME)
    if list(arguments) == ["page"]:
        write_page(bench)
        return 0
    if len(arguments) not in (0, 2):
        print("bad input: usage: python -m tools.build_leaderboard [page | DIR SCALE]", file=sys.stderr)
        return 2
    scale = [PUBLISHED, *arguments][-1]
    if arguments:
        folder = Path(arguments[0])
    else:
        folder = results.fly_bench(NAME, default_folder(PUBLISHED))
    try:
        flown = [part for part in bench.parts if (folder / part).is_dir()]
        if not flown:
            raise BadInputError(f"{folder}: no part of {NAME}; run `mavfi bench detectors`")
        freeze(folder, scale)
        for part in flown:
            rows = text_rows(table(load(folder / part), bench.parts[part].view))
            publish(bench, ROOT / "configs" / FOLDER / NAME / f"{part}-{scale}{ROWS_ENDING}", rows)
        if scale != PUBLISHED:
            return 0

        # what combines parts, if it was computed, and the pages
        if (folder / f"{SCORES_TABLE}.csv").is_file():
            with (folder / f"{SCORES_TABLE}.csv").open(encoding="utf-8", newline="") as file:
                publish(bench, results.TABLES / PAGE / f"{SCORES_TABLE}.csv", list(csv.DictReader(file)))
            shutil.copy(folder / "curves.png", IMAGES / "curves-paper.png")
        if {"sites", "instruction"} <= set(flown):
            fill(DOCS / "concepts" / "engineers.md", {"rules": rules(folder / "sites", folder / "instruction")})
        print(f"wrote {write_page(bench).relative_to(ROOT)}")
    except (BadInputError, OSError) as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
