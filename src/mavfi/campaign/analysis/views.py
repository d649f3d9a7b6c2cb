"""`View`: which rows, grouped by what, which measures -> `Table`.  A new table is a view; all are found by name."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from mavfi.campaign.analysis.measures import Measure, Spread
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import RATE, UNKNOWN, Cell, Column, Table
from mavfi.errors import BadInputError

DEVIATIONS = (
    "deviates from the published code: grace 1 s not 0, slow-down of the clock capped at 10, flight-controller limits, "
    "leg to the first point checked"
)
_PROFILES = {"published": DEVIATIONS, "hardened": "not the paper's: what a careful team would fly"}


class _Row(NamedTuple):
    """Cells of a row, and the ids of the runs behind each of them."""

    cells: tuple[Cell, ...]
    behind: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class View:
    """A question to a campaign."""

    name: str  # by which users ask for it
    title: str  # of its table
    by: tuple[str, ...]  # columns whose values make the rows of the table
    measures: tuple[Measure | Spread, ...]  # the other columns
    where: Callable[[Runs], Runs] = field(default=lambda runs: runs)  # selects rows of the frame; may add columns
    across: str = ""
    """Empty = measures are columns.  Else a column of the frame whose values become columns; each measure becomes a row
    with its heading in the second cell."""
    total: tuple[str, str] | None = None  # column of which a row over all values is added, and its label
    headings: tuple[str, ...] = ()  # instead of the names of `by`
    notes: Callable[[Runs], Iterable[str]] = field(default=lambda _: ())  # lines below the table
    most: str = ""  # key of the measure that orders rows within the first cell, largest first; "" = order of the plan
    largest: str = ""  # key of the measure that orders all rows, largest first, then by their first cell
    limit: int | None = None  # most rows
    least: int = 1  # rows of fewer runs are left out of the report
    leads: bool = False  # comes first in a report, and is its headline
    applies: Callable[[Runs], bool] = field(default=lambda _: True)  # whether the report of a campaign has the table
    of_model: bool = False  # its rows are computed by a model, whatever was flown

    def table(self, runs: Runs) -> Table:
        """Answer the question; a measure that raises gives `UNKNOWN` in its cell, and a note says why."""
        chosen = self.where(runs)
        if self.total is not None and len(chosen):
            chosen = chosen.with_total(*self.total)
        raised: dict[str, str] = {}
        columns, rows = (self._across if self.across else self._down)(chosen, raised)
        notes = [*(self.notes(runs) if rows else ()), *(f"{name}: unknown ({why})" for name, why in raised.items())]
        ordered = self._ordered(columns, rows)
        return Table(
            self.name, self.title, tuple(columns), [row.cells for row in ordered], max(1, len(self.by)),
            (*notes, *_flown_with(chosen)), [row.behind for row in ordered],
        )  # fmt: skip

    def _measures(self, chosen: Runs) -> list[Measure]:
        found: list[Measure] = []
        for measure in self.measures if len(chosen) else ():
            found += [measure] if isinstance(measure, Measure) else measure(chosen, self.by)
        return found

    def _keys(self) -> list[Column]:
        headings = self.headings or tuple(name.replace("_", " ") for name in self.by)
        return [Column(name, heading) for name, heading in zip(self.by, headings, strict=True)]

    def _down(self, chosen: Runs, raised: dict[str, str]) -> tuple[list[Column], list[_Row]]:
        """One row for each group."""
        measures = self._measures(chosen)
        groups = {key: own for key, own in chosen.groups(*self.by).items() if len(own) >= self.least}
        rows = [
            _Row(
                (*key, *(_cell(measure, own, raised) for measure in measures)),
                (*[_ids(own)] * len(key), *(_behind(measure, own) for measure in measures)),
            )
            for key, own in groups.items()
        ]
        return [*self._keys(), *(measure.column for measure in measures)], rows

    def _across(self, chosen: Runs, raised: dict[str, str]) -> tuple[list[Column], list[_Row]]:
        """One row for each group and measure, one column for each value of `across`; rows without a number left out."""
        values = chosen.values(self.across) if len(chosen) else []
        measures = self._measures(chosen)
        rows = []
        for key, own in chosen.groups(*self.by).items():
            parts = own.groups(self.across)
            for measure in measures:
                cells = [_cell(measure, parts[(value,)], raised) if (value,) in parts else None for value in values]
                if any(cell is not None for cell in cells):
                    behind = (_behind(measure, parts[(value,)]) if (value,) in parts else () for value in values)
                    rows.append(_Row((*key, measure.heading, *cells), (*[_ids(own)] * (len(key) + 1), *behind)))
        return [*self._keys(), Column("measure", ""), *(Column(str(value), str(value), RATE) for value in values)], rows

    def _ordered(self, columns: list[Column], rows: list[_Row]) -> list[_Row]:
        """Rows that begin with the same cell one below the other, in the order in which these cells first appear."""
        keys = [column.key for column in columns]
        if self.largest and rows:
            place = keys.index(self.largest)
            return sorted(rows, key=lambda row: (-row.cells[place], row.cells[0]))[: self.limit]
        first = list(dict.fromkeys(row.cells[0] for row in rows))
        if self.most and rows:
            place = keys.index(self.most)
            return sorted(rows, key=lambda row: (first.index(row.cells[0]), -row.cells[place]))[: self.limit]
        return sorted(rows, key=lambda row: first.index(row.cells[0]))[: self.limit]


def _cell(measure: Measure, own: Runs, raised: dict[str, str]) -> Cell:
    try:
        return measure.of(own)
    except Exception as error:  # one measure does not take the report with it; the cell and a note say so
        raised.setdefault(measure.heading or measure.key, f"{type(error).__name__}: {error}"[:100])
        return UNKNOWN


def _ids(own: Runs) -> tuple[str, ...]:
    """Ids of runs, each once; none where rows are not runs (models, estimates)."""
    return tuple(own.values("run_id")) if "run_id" in own.frame.columns else ()


def _behind(measure: Measure, own: Runs) -> tuple[str, ...]:
    """Ids of the rows from which a cell is computed."""
    return _ids(measure.counted(own))


def _flown_with(runs: Runs) -> tuple[str, ...]:
    """Which autopilot profile flew, and its deviations."""
    profile = runs.campaign.get("profile", "")
    more = f"; {_PROFILES[profile]}" if profile in _PROFILES else ""
    return (f"autopilot profile {profile}{more}",) if profile else ()


VIEWS: dict[str, View] = {}  # all views by name, in the order in which reports show them


def register(*views: View) -> None:
    """Add views; a later one of the same name replaces the earlier one."""
    VIEWS.update({view.name: view for view in views})


def table(runs: Runs, name: str) -> Table:
    """Table of a view.

    Raises:
        BadInputError: There is no such view.
    """
    if name not in VIEWS:
        raise BadInputError(f"view {name!r}: not known; allowed: {', '.join(VIEWS)}")
    return VIEWS[name].table(runs)


def views_for(runs: Runs) -> list[Table]:
    """Tables of a campaign's report: those of all views that apply to it and have rows; the first is its headline."""
    ordered = sorted(VIEWS.values(), key=lambda view: not view.leads)
    found = [view.table(runs) for view in ordered if view.applies(runs)]
    return [table for table in found if table.rows]


def has(runs: Runs, **values: Any) -> bool:
    """Whether some run has these values."""
    return len(runs.where(**values)) > 0
