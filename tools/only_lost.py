"""The summary at the head of a leaderboard: missions that only a scheme lost, over all parts of the page.

Sections come from ledgers of several dates, some of which are on other machines: the sums are those of the page's rows.
"""

import re
from collections.abc import Iterable, Mapping, Sequence

from mavfi.campaign.analysis.statistics import wilson
from mavfi.campaign.bench import Bench, Part, level_of
from mavfi.campaign.config import load_campaign
from mavfi.reports.text import ABSENT

LEVELS = ("state", "message", "instruction", "memory")
OBSERVER = "coupling observer"
"""A group of its own: no scheme is made for alarms that come after the value was read."""
COLUMNS = {"only it lost": "faults", "of these, only it lost": "same value injected"}
"""Heading of the lost missions, and of those that were flown, by the view of a part."""
BEGIN, END = "<!-- only-lost:begin -->", "<!-- only-lost:end -->"
_HEAD = re.compile(rf"\n*{BEGIN}.*?{END}", re.DOTALL)
_SECTION = "\n## "
_NOTE = (
    "**Missions lost by the scheme alone** / missions with a fault under the scheme, over all parts below: success "
    "without the scheme, failure with it. Golden flights lost by the scheme alone count as lost, but are not in the "
    "denominator; at level instruction only faults in the same value are compared. Per cent, [95 % interval: Wilson, "
    "flights in one world taken as independent]. One fault in one value or instruction; what schemes lose where faults "
    "last: [their table](lasting.md)."
)
Counts = dict[str, dict[str, tuple[int, int]]]
"""Lost and flown missions by scheme and group of parts."""


def with_summary(page: str, bench: Bench) -> str:
    """The page of a bench with the summary of its present sections before the first; without any, as it is."""
    page = _HEAD.sub("", page)
    found = counts(page, bench)
    top, section, rest = page.partition(_SECTION)
    return f"{top.rstrip()}\n\n{BEGIN}\n{table(found)}\n{END}\n{section}{rest}" if found else page


def counts(page: str, bench: Bench) -> Counts:
    """Sums of the sections of a page by scheme and group: a level, or the coupling under which alarms come late."""
    groups = {part.title: _group(part) for part in bench.parts.values()}
    found: Counts = {}
    for section in page.split(_SECTION)[1:]:
        title, *lines = section.splitlines()
        group = groups.get(title)
        for row in _rows(lines) if group else ():
            for lost, flown in COLUMNS.items():
                if row.get(lost, "").isdecimal() and row.get(flown, "").isdecimal():
                    own = found.setdefault(row["scheme"], {})
                    before = own.get(str(group), (0, 0))
                    own[str(group)] = before[0] + int(row[lost]), before[1] + int(row[flown])
    return found


def _group(part: Part) -> str:
    """Group of a part; "" = it is not counted."""
    level = level_of(load_campaign(part.campaign))
    return "" if level not in LEVELS else OBSERVER if part.mission.get("coupling") == "observer" else level


def _rows(lines: Sequence[str]) -> list[Mapping[str, str]]:
    """Rows of a section's table by heading; none if they are not schemes."""
    grid = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return [dict(zip(grid[0], row, strict=False)) for row in grid[2:]] if grid and grid[0][0] == "scheme" else []


def table(found: Counts) -> str:
    """The summary: for each scheme lost and flown missions by group, without late alarms, and in all."""
    lines = [
        _NOTE, "",
        f"| scheme | {' | '.join(LEVELS)} | these together | {OBSERVER} | all parts |",
        "| --- |" + " ---: |" * (len(LEVELS) + 3),
    ]  # fmt: skip
    for scheme, own in found.items():
        inline = [own[level] for level in LEVELS if level in own]
        cells = [_count(own.get(level)) for level in LEVELS]
        cells += [_share(inline), _count(own.get(OBSERVER)), _share(own.values())]
        lines.append(f"| {scheme} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _count(own: tuple[int, int] | None) -> str:
    return ABSENT if own is None else f"{own[0]}/{own[1]}"


def _share(parts: Iterable[tuple[int, int]]) -> str:
    """E.g. "0 [0, 0.19] 0/2000"."""
    lost, flown = map(sum, zip((0, 0), *parts, strict=True))
    found = wilson(lost, flown)
    if found.rate is None or found.low is None or found.high is None:
        return ABSENT
    return f"{100 * found.rate:.2g} [{100 * found.low:.2g}, {100 * found.high:.2g}] {lost}/{flown}"
