"""What a bench says about a scheme: a sentence for each part, and its table sorted and cut to what decides."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rich.table import Table as RichTable

from mavfi.analysis.statistics import EventRate, Rate
from mavfi.analysis.table import Table
from mavfi.cli.console import titled_table
from mavfi.report.text import ABSENT, cell

_RATE = re.compile(r"([\d.]+) \[([\d.]+), ([\d.]+)\] (\d+)/(\d+)")
_PER_HOUR = re.compile(r"([\d.]+) \[([\d.]+), ([\d.]+)\]")
"""Cells of published rows, which are text: a rate with its interval and count, events per hour with their interval."""
_BACK = "back"
_MOST_COLUMNS = 6
_OWN_ROW = "bold green"
_OWN_MARK = "▶ "
"""How the user's rows stand out, also without colours."""


class CountedShare(NamedTuple):
    """A share with its count and interval, per cent."""

    hits: int
    n: int
    low: float
    high: float

    def __str__(self) -> str:
        if not self.n:
            return ABSENT
        return f"{100 * self.hits / self.n:.0f} % [{self.low:.0f}, {self.high:.0f}]"


@dataclass(frozen=True, slots=True)
class SchemeResult:
    """What decides between schemes; None = not measured.

    Attributes:
        keys: Cells that name the row: the scheme last, e.g. after a group of faults.
        back: Of the missions that the faults lose, those that succeed under the scheme.
        newly_lost: Missions that fail only under the scheme.
        false_alarms: Per hour of flight, with its interval.
        late: Late missions, and how many of them are in time under the scheme, as text.
        alarm_after: Median time from fault to alarm, as text.
    """

    keys: tuple[str, ...]
    back: CountedShare
    newly_lost: int | None
    false_alarms: tuple[float, float, float] | None
    late: str
    alarm_after: str

    @property
    def scheme(self) -> str:
        """Name of the scheme."""
        return self.keys[-1]

    @property
    def share(self) -> float:
        """Share of the lost missions that the scheme brings back; below 0 if no fault loses one."""
        if not self.back.n:
            return -1.0
        return self.back.hits / self.back.n

    @property
    def rank(self) -> tuple[float, ...]:
        """What sorts schemes, the best first: missions brought back, missions lost, false alarms, missions in time."""
        per_hour = 0.0
        if self.false_alarms is not None:
            per_hour = self.false_alarms[0]
        return (
            -self.share,
            float(self.newly_lost or 0),
            per_hour,
            -float(self.late.partition("/")[0].strip(ABSENT) or 0),
        )

    @property
    def cells(self) -> tuple[str, ...]:
        """The result as a row of the short table."""
        back = ABSENT
        if self.back.n:
            back = f"{self.back.hits}/{self.back.n} {self.back}".replace(" %", "")
        newly_lost = ABSENT
        if self.newly_lost is not None:
            newly_lost = str(self.newly_lost)
        false_alarms = ABSENT
        if self.false_alarms is not None:
            false_alarms = "{:.0f} [{:.0f}, {:.0f}]".format(*self.false_alarms)
        return (*self.keys, back, newly_lost, false_alarms, self.late, self.alarm_after)


def results_of(table: Table) -> list[SchemeResult]:
    """The results in a table of schemes, the best first within each group; none in a table of something else."""
    results = []
    for entry in table.entries():
        back = _counted(entry.get(_BACK))
        if back is None:
            continue
        late_missions = _counted(entry.get("late_in_time"))
        late = ABSENT
        if late_missions is not None and late_missions.n:
            late = f"{late_missions.hits}/{late_missions.n}"
        keys = tuple(str(entry[column.key]) for column in table.columns[: table.keys])
        results.append(
            SchemeResult(
                keys,
                back=back,
                newly_lost=_number(entry.get("newly_lost")),
                false_alarms=_per_hour(entry.get("per_hour")),
                late=late,
                alarm_after=_text(table, entry, "alarm_after"),
            )
        )
    groups = list(dict.fromkeys(result.keys[:-1] for result in results))
    return sorted(results, key=lambda result: (groups.index(result.keys[:-1]), *result.rank))


def sentences(results: Sequence[SchemeResult], user_schemes: Collection[str]) -> list[str]:
    """What the results say about some schemes, or about the best one if none is named."""
    texts = []
    for group in dict.fromkeys(result.keys[:-1] for result in results):
        group_results = [result for result in results if result.keys[:-1] == group]
        heading = "".join(f"{part}: " for part in group)
        user_results = [result for result in group_results if result.scheme in user_schemes]
        if not user_results:
            user_results = group_results[:1]
            heading += "the best one, "
        for result in user_results:
            others = [other for other in group_results if other.scheme not in user_schemes and other is not result]
            texts.append(f"{heading}{_sentence(result, others)}")
    return texts


def _sentence(result: SchemeResult, others: Sequence[SchemeResult]) -> str:
    """One scheme against others on the same faults."""
    back = result.back
    if not back.n:
        return f"{result.scheme}: no fault loses a mission here, so there is none to bring back."
    facts = []
    if others:
        worse = sum(other.share < result.share for other in others)
        same = sum(other.share == result.share for other in others)
        fact = f"better than {worse} of {len(others)} schemes"
        if same:
            fact += f", as good as {same}"
        elif not worse:
            fact = f"worse than all {len(others)} schemes"
        facts.append(fact)
    if result.false_alarms is not None:
        per_hour, _, upper = result.false_alarms
        facts.append(f"{per_hour:.1f} false alarms per hour")
        if per_hour == 0:
            facts[-1] = f"no false alarm (at most {upper:.0f} per hour)"
    if result.newly_lost == 0:
        facts.append("loses nothing")
    elif result.newly_lost is not None:
        facts.append(f"loses {result.newly_lost} that succeed without it")
    return f"{result.scheme} brings back {back.hits} of {back.n}, {back}: {'; '.join(facts)}."


def short_table(table: Table, user_schemes: Collection[str]) -> RichTable:
    """A table for 80 columns: of schemes, sorted, with some rows highlighted; of something else, its first columns."""
    results = results_of(table)
    grid = titled_table(table.title, padding=(0, 1, 0, 0))
    if not results:
        visible = [column for column in table.columns if not column.hidden][:_MOST_COLUMNS]
        for column in visible:
            grid.add_column(column.heading)
        for entry in table.entries():
            texts = [cell(entry[column.key], column.form) for column in visible]
            grid.add_row(*texts, style=_style(texts[: table.keys], user_schemes))
        return grid
    for column in table.columns[: table.keys]:
        grid.add_column(column.heading)
    for heading in ("brought\nback, %", "it\nloses", "false alarms\nper hour", "late,\nback", "alarm\nafter"):
        grid.add_column(heading, justify="right", no_wrap=True)
    for result in results:
        cells = list(result.cells)
        if result.scheme in user_schemes:
            cells[table.keys - 1] = f"{_OWN_MARK}{result.scheme}"
        grid.add_row(*cells, style=_style(result.keys, user_schemes))
    return grid


def _style(keys: Sequence[str], user_schemes: Collection[str]) -> str:
    """Style of a row, given the cells that name it."""
    if keys[-1] in user_schemes:
        return _OWN_ROW
    return ""


def _counted(value: Any) -> CountedShare | None:
    """A rate with its count, also a published one; None for other cells."""
    if isinstance(value, Rate) and value.successes is not None:
        return CountedShare(value.successes, value.n, 100 * (value.low or 0.0), 100 * (value.high or 0.0))
    if value == ABSENT:
        return CountedShare(0, 0, 0.0, 0.0)
    if isinstance(value, str):
        match = _RATE.fullmatch(value)
        if match is not None:
            return CountedShare(int(match[4]), int(match[5]), float(match[2]), float(match[3]))
    return None


def _number(value: Any) -> int | None:
    """A count, also a published one."""
    if value is None or value in ("", ABSENT):
        return None
    return int(value)


def _per_hour(value: Any) -> tuple[float, float, float] | None:
    """Events per hour with their interval, also published ones."""
    if isinstance(value, EventRate) and value.per_hour is not None:
        return value.per_hour, value.low or 0.0, value.high or 0.0
    if isinstance(value, str):
        match = _PER_HOUR.fullmatch(value)
        if match is not None:
            return float(match[1]), float(match[2]), float(match[3])
    return None


def _text(table: Table, entry: dict[str, Any], key: str) -> str:
    """A cell as text; absent if the table has no such column."""
    for column in table.columns:
        if column.key == key:
            return cell(entry[key], column.form)
    return ABSENT
