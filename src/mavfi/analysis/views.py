"""`View`: selection of rows, grouping and measures -> `Table`.  Every table is a view."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from mavfi.analysis.measures import Measure, MeasureFactory, rate_of
from mavfi.analysis.rows import GOLDEN
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import RATE, UNKNOWN, Cell, Column, Table
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, allowed, not_known
from mavfi.plugins import Catalogue

DEVIATIONS = (
    "deviates from the published code: grace 1 s not 0, slow-down of the clock capped at 10, flight-controller limits, "
    "leg to the first point checked"
)
_PROFILES = {"published": DEVIATIONS, "hardened": "not the paper's: what a careful team would fly"}


class _Row(NamedTuple):
    """Cells of a row, with the ids of the runs behind each cell."""

    cells: tuple[Cell, ...]
    behind: tuple[tuple[str, ...], ...]


class _Grid(NamedTuple):
    """Columns and rows of a table, before sorting."""

    columns: list[Column]
    rows: list[_Row]


@dataclass(frozen=True)
class View:
    """Definition of a table over the runs of a campaign."""

    name: str  # for `mavfi report --view`
    title: str | Callable[[Runs], str]  # of its table; called where it depends on what was flown
    by: tuple[str, ...]  # columns of the frame to group by: one row per group
    measures: tuple[Measure | MeasureFactory, ...]  # the other columns
    where: Callable[[Runs], Runs] = field(default=lambda runs: runs)  # selects rows of the frame; may add columns
    across: str = ""
    """"" = measures are columns.  Otherwise the values of this column of the frame become columns, and each measure
    becomes a row with its heading in the cell after those of `by`."""
    total: tuple[str, str] | None = None  # column for which a total row is added, and the label of that row
    headings: tuple[str, ...] = ()  # headings of the columns in `by`; () = their names
    notes: Callable[[Runs], Iterable[str]] = field(default=lambda _: ())  # lines below the table
    largest: str = ""  # measure that sorts all rows, in descending order; ties by the first cell
    limit: int | None = None  # maximum number of rows
    least: int = 1  # minimum number of runs per row
    leads: bool = False  # placed first in reports, as the headline
    applies: Callable[[Runs], bool] = field(default=lambda _: True)  # whether these runs have what it shows
    by_name: bool = False  # not in reports on a campaign: only in studies, benches, and by its name

    def title_of(self, runs: Runs) -> str:
        """The title for these runs."""
        if isinstance(self.title, str):
            return self.title
        return self.title(runs)

    def table(self, runs: Runs) -> Table:
        """Compute the table; if a measure raises an exception, its cell is `UNKNOWN` and a note gives the reason."""
        chosen = self.where(runs)
        if self.total is not None and len(chosen):
            chosen = chosen.with_total(*self.total)
        errors: dict[str, str] = {}  # of measures, by heading
        if self.across:
            grid = self._across(chosen, errors)
        else:
            grid = self._down(chosen, errors)
        notes: list[str] = []
        if grid.rows:
            notes += self.notes(runs)
        notes += [f"{heading}: unknown ({error})" for heading, error in errors.items()]
        rows = self._ordered(grid)
        return Table(
            self.name,
            self.title_of(runs),
            tuple(grid.columns),
            [row.cells for row in rows],
            max(1, len(self.by)),
            (*notes, *_without_a_fault(runs, chosen, grid.columns), *_flown_with(chosen)),
            [row.behind for row in rows],
        )

    def _measures(self, chosen: Runs) -> list[Measure]:
        """The measures, with those that depend on the data; none without runs."""
        measures: list[Measure] = []
        if not len(chosen):
            return measures
        for entry in self.measures:
            if isinstance(entry, Measure):
                measures.append(entry)
            else:
                measures += entry(chosen, self.by)
        return measures

    def _keys(self) -> list[Column]:
        headings = self.headings or tuple(name.replace("_", " ") for name in self.by)
        return [Column(name, heading) for name, heading in zip(self.by, headings, strict=True)]

    def _down(self, chosen: Runs, errors: dict[str, str]) -> _Grid:
        """One row per group, one column per measure."""
        measures = self._measures(chosen)
        rows = []
        for key, group in chosen.groups(*self.by).items():
            if len(group) < self.least:
                continue
            cells = (_cell(measure, group, errors) for measure in measures)
            behind = (_behind(measure, group) for measure in measures)
            rows.append(_Row((*key, *cells), (*[group.ids] * len(key), *behind)))
        return _Grid([*self._keys(), *(measure.column for measure in measures)], rows)

    def _across(self, chosen: Runs, errors: dict[str, str]) -> _Grid:
        """One row per group and measure, one column per value of `across`; empty rows are omitted."""
        if not len(chosen):
            return _Grid([*self._keys(), Column("measure", "")], [])
        values = chosen.values(self.across)
        measures = self._measures(chosen)
        rows = []
        for key, group in chosen.groups(*self.by).items():
            parts = group.groups(self.across)
            for measure in measures:
                cells: list[Cell] = [None] * len(values)
                behind: list[tuple[str, ...]] = [()] * len(values)
                for index, value in enumerate(values):
                    if (value,) in parts:
                        cells[index] = _cell(measure, parts[(value,)], errors)
                        behind[index] = _behind(measure, parts[(value,)])
                if any(cell is not None for cell in cells):
                    rows.append(_Row((*key, measure.heading, *cells), (*[group.ids] * len(key), (), *behind)))
        columns = [Column(str(value), str(value), RATE) for value in values]
        is_named = any(measure.heading for measure in measures)
        return _Grid([*self._keys(), Column("measure", "", hidden=not is_named), *columns], rows)

    def _ordered(self, grid: _Grid) -> list[_Row]:
        """Sort rows by `largest`, or group rows with equal first cells; apply `limit`."""
        rows = grid.rows
        if self.largest and rows:
            largest = [column.key for column in grid.columns].index(self.largest)
            return sorted(rows, key=lambda row: (-row.cells[largest], row.cells[0]))[: self.limit]
        first_cells = list(dict.fromkeys(row.cells[0] for row in rows))
        return sorted(rows, key=lambda row: first_cells.index(row.cells[0]))[: self.limit]


def _cell(measure: Measure, group: Runs, errors: dict[str, str]) -> Cell:
    try:
        return measure.of(group)
    except Exception as error:  # a failing measure must not abort the report
        errors.setdefault(measure.heading or measure.key, f"{type(error).__name__}: {error}"[:100])
        return UNKNOWN


def _behind(measure: Measure, group: Runs) -> tuple[str, ...]:
    """Ids of the runs counted in a cell; none for the paper's values, whose keys begin with "paper"."""
    if measure.key.startswith("paper"):
        return ()
    return measure.counted(group).ids


def _without_a_fault(runs: Runs, chosen: Runs, columns: Iterable[Column]) -> tuple[str, ...]:
    """Note on the success without a fault, for a table that shows only that with one."""
    shows_success = any(column.form == RATE and column.key.startswith(_OF_MISSIONS) for column in columns)
    if not shows_success or "kind" not in chosen.frame or not runs.has_missions or len(chosen.golden):
        return ()
    golden = runs.golden.where("judged", setting=GOLDEN)
    rates = {
        environment: rate_of(flights, "success") for (environment,), flights in golden.groups("environment").items()
    }
    parts = [f"{environment} {rate.percent}, n = {rate.n}" for environment, rate in rates.items()]
    if not parts:
        return ()
    return (f"success without a fault: {'; '.join(parts)}",)


_OF_MISSIONS = ("success", "hurt")
"""Beginnings of the keys of rates of missions."""


def _flown_with(runs: Runs) -> tuple[str, ...]:
    """Note on the autopilot profile and its deviations from the published code."""
    profile = runs.campaign.get("profile", "")
    if not profile:
        return ()
    if profile in _PROFILES:
        return (f"autopilot profile {profile}; {_PROFILES[profile]}",)
    return (f"autopilot profile {profile}",)


VIEWS: Mapping[str, View] = Catalogue("mavfi.views")
"""By name, in the order of reports."""


def table(runs: Runs, name: str) -> Table:
    """Compute the table of a view.

    Raises:
        BadInputError: The view does not exist.
    """
    if name not in VIEWS:
        raise BadInputError(dropped_name("views", name) or f"view {not_known(name, VIEWS)}")
    return VIEWS[name].table(runs)


def table_asked_for(runs: Runs, name: str) -> Table:
    """Compute the table of a view for a user.

    Raises:
        BadInputError: The view does not exist, or these runs do not have what it shows.
    """
    if dropped_name("views", name):
        raise BadInputError(dropped_name("views", name))
    names = [view.name for view in applicable(runs)]
    if name not in VIEWS:
        raise BadInputError(f"view {not_known(name, names)}")
    if VIEWS[name].applies(runs):
        requested = table(runs, name)
        if requested.rows:
            return requested
    raise BadInputError(f"view {name!r}: these runs have nothing to show in it; allowed: {allowed(names, name)}")


def applicable(runs: Runs) -> list[View]:
    """Views of which these runs have something to show."""
    return [view for view in VIEWS.values() if view.applies(runs)]


def views_for(runs: Runs) -> list[Table]:
    """Tables of a campaign's report: non-empty tables of all applicable views, the headline first."""
    ordered = sorted(applicable(runs), key=lambda view: not view.leads)
    tables = [view.table(runs) for view in ordered if not view.by_name]
    return [table for table in tables if table.rows]


def has(runs: Runs, **values: Any) -> bool:
    """Whether any run has these values."""
    return len(runs.where(**values)) > 0
