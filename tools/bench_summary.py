"""The summary at the head of a leaderboard: for each scheme, what it brings back, and what it costs in missions.

Sections come from ledgers of several dates, some of which are on other machines: the sums are those of the page's rows.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

from mavfi.campaign.analysis.flight_views import TOTAL
from mavfi.campaign.analysis.statistics import wilson
from mavfi.campaign.bench import Bench, Part, level_of
from mavfi.campaign.config import load_campaign
from mavfi.reports.text import ABSENT, rate

LEVELS = ("state", "message", "instruction", "memory")
OBSERVER = "coupling observer"
"""A group of its own: no scheme is made for alarms that come after the value was read."""
COLUMNS = {"only it lost": "faults", "of these, only it lost": "same value injected"}
"""Heading of the lost missions, and of those that were flown, by the view of a part."""
BACK = "brought back"
GOLDEN = "golden_"
"""What the names of settings with a detector and without a fault begin with."""
BEGIN, END = "<!-- summary:begin -->", "<!-- summary:end -->"
_HEAD = re.compile(rf"\n*{BEGIN}.*?{END}", re.DOTALL)
_SECTION, _CONTENTS = "\n## ", "\n\nParts:\n"
_COUNT = re.compile(r"(\d+)/(\d+)$")
_BACK_NOTE = (
    "**Missions brought back** / missions lost to the fault, over the parts below that were flown with every detector. "
    "{}Per cent, [95 % interval: Wilson, flights in one world taken as independent]; most missions brought back first, "
    "schemes without a detector last."
)
_ALARMS_NOTE = "False alarms per hour of flight without a fault, by autopilot profile, all environments. "
_LOST_NOTE = (
    "**Missions lost by the scheme alone** / missions with a fault under the scheme, over all parts below: success "
    "without the scheme, failure with it. Golden flights lost by the scheme alone count as lost, but are not in the "
    "denominator; at level instruction only faults in the same value are compared. Per cent, intervals as above. "
    "One fault in one value or instruction; what schemes lose where faults last: [their table](lasting.md)."
)
Counts = dict[str, dict[str, tuple[int, int]]]
"""Missions, and those of which they are a part, by scheme and group of parts."""
Sections = Sequence[tuple[Part, Sequence[Mapping[str, str]]]]


def with_summary(page: str, bench: Bench) -> str:
    """The page of a bench with tables of its present sections: before its contents, and before the first section."""
    page = _HEAD.sub("", page)
    sections = _sections(page, bench)
    top, section, rest = page.partition(_SECTION)
    head, contents, parts = top.rstrip().partition(_CONTENTS)
    back, lost = map(_block, (_back_table(sections, bench), _lost_table(lost_alone(sections))))
    return f"{head}{back}{contents}{parts}{lost}\n{section}{rest}" if back or lost else page


def _block(found: str) -> str:
    return f"\n\n{BEGIN}\n{found}\n{END}" if found else ""


def _sections(page: str, bench: Bench) -> Sections:
    """Parts of a bench that are on a page, with the rows of their tables by heading."""
    parts = {part.title: part for part in bench.parts.values()}
    found = []
    for section in page.split(_SECTION)[1:]:
        title, *lines = section.splitlines()
        grid = cells(lines)
        if title in parts:
            found.append((parts[title], [dict(zip(grid[0], row, strict=False)) for row in grid[2:]] if grid else []))
    return found


def cells(lines: Sequence[str]) -> list[list[str]]:
    """Cells of the table among a section's lines; a first cell that is empty is that above it."""
    grid = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    for above, row in pairwise(grid):
        row[0] = row[0] or above[0]
    return grid


def _group(part: Part) -> str:
    """Group of a part: a level, or the coupling under which alarms come late; "" = it is not counted."""
    level = level_of(load_campaign(part.campaign))
    return "" if level not in LEVELS else OBSERVER if part.mission.get("coupling") == "observer" else level


# ---- brought back ---------------------------------------------------------------------------------------------------
def brought_back(sections: Sections, bench: Bench) -> Counts:
    """Missions brought back, and lost, by scheme and group, in parts flown with every detector on the page."""
    injected = [(_group(part), {row["scheme"]: row for row in rows}) for part, rows in sections if _has_schemes(rows)]
    flown = {name for _, rows in injected for name in rows}
    detectors = {name for name, arm in bench.arms.items() if arm.detector} & flown
    found: Counts = {}
    for group, rows in injected:
        if group and detectors <= rows.keys():
            for scheme, row in rows.items():
                if count := _COUNT.search(row.get(BACK, "")):
                    _add(found, scheme, group, (int(count[1]), int(count[2])))
    return found


def false_alarms(sections: Sections) -> dict[str, dict[str, str]]:
    """False alarms per hour in all environments, by autopilot profile and scheme."""
    return {
        part.mission.get("autopilot", "published"): {
            row["setting"].removeprefix(GOLDEN): row["per hour"] for row in rows if row["environment"] == TOTAL[1]
        }
        for part, rows in sections
        if part.view == "false_alarms"
    }


def _back_table(sections: Sections, bench: Bench) -> str:
    found, alarms = brought_back(sections, bench), false_alarms(sections)
    groups = [group for group in (*LEVELS, OBSERVER) if any(group in own for own in found.values())]
    if not groups:
        return ""
    headings = [*groups, *(f"false alarms, `{profile}`" for profile in alarms)]
    note = _BACK_NOTE.format(_ALARMS_NOTE if alarms else "")
    lines = [note, "", f"| scheme | {' | '.join(headings)} |", "| --- |" + " ---: |" * len(headings)]
    bare = {name for name, arm in bench.arms.items() if not arm.detector}
    inline = {scheme: sum(own[level][0] for level in LEVELS if level in own) for scheme, own in found.items()}
    for scheme in sorted(found, key=lambda scheme: (scheme in bare, -inline[scheme])):
        row = [rate(wilson(*found[scheme][group])) if group in found[scheme] else ABSENT for group in groups]
        row += [own.get(scheme, ABSENT) for own in alarms.values()]
        lines.append(f"| {scheme} | {' | '.join(row)} |")
    return "\n".join(lines)


# ---- lost by the scheme alone ---------------------------------------------------------------------------------------
def lost_alone(sections: Sections) -> Counts:
    """Missions lost by a scheme alone, and flown, by scheme and group, over all parts."""
    found: Counts = {}
    for part, rows in sections:
        group = _group(part)
        for row in rows if group and _has_schemes(rows) else ():
            for lost, flown in COLUMNS.items():
                if row.get(lost, "").isdecimal() and row.get(flown, "").isdecimal():
                    _add(found, row["scheme"], group, (int(row[lost]), int(row[flown])))
    return found


def _lost_table(found: Counts) -> str:
    """For each scheme lost and flown missions by group, without late alarms, and in all."""
    if not found:
        return ""
    lines = [
        _LOST_NOTE, "",
        f"| scheme | {' | '.join(LEVELS)} | these together | {OBSERVER} | all parts |",
        "| --- |" + " ---: |" * (len(LEVELS) + 3),
    ]  # fmt: skip
    for scheme, own in found.items():
        inline = [own[level] for level in LEVELS if level in own]
        row = [_count(own.get(level)) for level in LEVELS]
        row += [_share(inline), _count(own.get(OBSERVER)), _share(own.values())]
        lines.append(f"| {scheme} | {' | '.join(row)} |")
    return "\n".join(lines)


def _has_schemes(rows: Sequence[Mapping[str, str]]) -> bool:
    return bool(rows) and "scheme" in rows[0]


def _add(found: Counts, scheme: str, group: str, more: tuple[int, int]) -> None:
    own = found.setdefault(scheme, {})
    before = own.get(group, (0, 0))
    own[group] = before[0] + more[0], before[1] + more[1]


def _count(own: tuple[int, int] | None) -> str:
    return ABSENT if own is None else f"{own[0]}/{own[1]}"


def _share(parts: Iterable[tuple[int, int]]) -> str:
    """E.g. "0 [0, 0.19] 0/2000"."""
    lost, flown = map(sum, zip((0, 0), *parts, strict=True))
    found = wilson(lost, flown)
    if found.rate is None or found.low is None or found.high is None:
        return ABSENT
    return f"{100 * found.rate:.2g} [{100 * found.low:.2g}, {100 * found.high:.2g}] {lost}/{flown}"
