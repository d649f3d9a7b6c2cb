"""`Runs`: a campaign as a frame with one row per run, with the complete records."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from mavfi.analysis.about import describe
from mavfi.analysis.rows import GOLDEN, INJECTED, NULL, SCHEMA, row_of
from mavfi.campaign.plan import FI
from mavfi.campaign.store import Run, Store
from mavfi.record import FlightRecord
from mavfi.states import MONITORED_SETS

if TYPE_CHECKING:
    from mavfi.flight.host import Flight

DEFAULT_MONITORED = "paper-13"
ALL = "all"  # label of total rows, e.g. over all environments


@dataclass(frozen=True)
class Runs:
    """Completed runs, in plan order.

    Attributes:
        frame: One row per run; columns as in `rows.SCHEMA`, and those added by views.
        records: Record of each run by its id.
        campaign: Description of the campaign as plain data, for headers and notes.
        flights: Replayed flights of some runs by id, for figures of paths.
        memo: Cached results of measures on these rows.
    """

    frame: pl.DataFrame
    records: Mapping[str, FlightRecord] = field(default_factory=dict)
    campaign: Mapping[str, Any] = field(default_factory=dict)
    flights: Mapping[str, "Flight"] = field(default_factory=dict)
    memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @staticmethod
    def read(directory: Path) -> "Runs":
        """Read the completed runs of a ledger.

        Raises:
            BadInputError: The folder has no ledger.
        """
        with Store.open(directory) as store:
            return Runs.of(store.runs(done=True), describe(store))

    @staticmethod
    def of(runs: Iterable[Run], campaign: Mapping[str, Any] | None = None) -> "Runs":
        """Evaluate runs in plan order; those without a record are excluded.

        `campaign` is a description by `about.describe`; its `monitored_set` names the monitored fields.
        """
        about = campaign or {}
        done = [(run, run.record) for run in runs if run.record is not None]
        golden = [(run.spec, record) for run, record in done if run.spec.kind == GOLDEN]
        own = {(spec.arm, *spec.world): record for spec, record in golden}
        # golden run of the same mission without a detector, from any arm
        bare = {(spec.scenario, *spec.world): record for spec, record in reversed(golden) if not spec.detector}
        monitored = MONITORED_SETS[about.get("monitored_set", DEFAULT_MONITORED)]
        rows = []
        for run, record in done:
            spec = run.spec
            same_arm = own.get((spec.arm, *spec.world))
            reference = bare.get((spec.scenario, *spec.world), same_arm)
            rows.append(row_of(run, record, same_arm, reference, monitored))
        frame = pl.DataFrame(rows, schema=SCHEMA).with_columns(pl.col(pl.String).fill_null(""))
        return Runs(frame, {run.spec.run_id: record for run, record in done}, about)

    def __len__(self) -> int:
        return self.frame.height

    def __getitem__(self, column: str) -> list[Any]:
        return self.frame[column].to_list()

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return self.frame.iter_rows(named=True)

    def first(self, column: str) -> Any:
        """Value of the first row; raises IndexError if there are no rows."""
        return self[column][0]

    def values(self, column: str) -> list[Any]:
        """Distinct values of a column, in order of first appearance."""
        return self.frame[column].unique(maintain_order=True).to_list()

    @property
    def ids(self) -> tuple[str, ...]:
        """Distinct ids of the runs; empty if rows are not runs (models, estimates)."""
        return tuple(self.values("run_id")) if "run_id" in self.frame.columns else ()

    def recorded(self) -> list[FlightRecord]:
        """Records of the runs, in row order."""
        return [self.records[run_id] for run_id in self["run_id"]]

    def where(self, *tests: pl.Expr | str, **values: Any) -> "Runs":
        """Rows that pass all tests: expressions, names of flag columns, and column=value."""
        asked = [pl.col(test) if isinstance(test, str) else test for test in tests]
        asked += [pl.col(column) == value for column, value in values.items()]
        return replace(self, frame=self.frame.filter(*asked)) if asked else self

    def adding(self, **columns: pl.Expr) -> "Runs":
        """The runs with columns added or replaced."""
        return replace(self, frame=self.frame.with_columns(**columns))

    def groups(self, *by: str) -> dict[tuple[Any, ...], "Runs"]:
        """Group rows by the values of columns, in order of first appearance."""
        if not by:
            return {(): self}
        parts = self.frame.partition_by(by, maintain_order=True, as_dict=True)
        return {key: replace(self, frame=part) for key, part in parts.items()}

    def with_total(self, column: str, label: str) -> "Runs":
        """The rows and, if the column has several values, a copy of all rows with this label in the column."""
        if self.frame[column].n_unique() < 2:
            return self
        return replace(self, frame=pl.concat([self.frame, self.frame.with_columns(pl.lit(label).alias(column))]))

    def exploded(self, parts: Callable[[FlightRecord], Sequence[Mapping[str, Any]]]) -> "Runs":
        """Expand each run to zero or more rows: the run's columns and those that `parts` extracts from its record."""
        rows = [{**row, **part} for row, record in zip(self, self.recorded(), strict=True) for part in parts(record)]
        return replace(self, frame=pl.DataFrame(rows, infer_schema_length=None) if rows else self.frame.clear())

    @property
    def golden(self) -> "Runs":
        """Runs without a fault."""
        return self.where(kind=GOLDEN)

    @property
    def injected(self) -> "Runs":
        """Runs with a fault, null runs excluded."""
        return self.where(kind=INJECTED)

    @property
    def null(self) -> "Runs":
        """Null runs: injection with an empty bit mask."""
        return self.where(kind=NULL)

    @property
    def has_missions(self) -> bool:
        """Whether there are flights; trials of external nodes have only outputs."""
        return len(self.where(pl.col("flight_time_s") > 0)) > 0

    def settings(self) -> list[str]:
        """Settings with injected runs, `fi` first."""
        return sorted(self.injected.values("setting"), key=lambda setting: setting != FI)
