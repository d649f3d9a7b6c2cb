"""`Runs`: a campaign as a frame with one row per run, and the records for what does not fit into a row."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import polars as pl

from mavfi.campaign.analysis.rows import GOLDEN, INJECTED, NULL, SCHEMA, row_of
from mavfi.campaign.plan import FI
from mavfi.campaign.store import Run, Store
from mavfi.flight_record import FlightRecord
from mavfi.hosts.host import Flight
from mavfi.states import MONITORED_SETS

DEFAULT_MONITORED = "paper-13"
ALL = "all"  # value of the environment in rows that are counted over all of them


@dataclass(frozen=True)
class Runs:
    """Runs that are done, in the order of the plan.

    Attributes:
        frame: One row per run; columns as in `rows.SCHEMA`, and those that a view has added.
        records: Record of each run by its id.
        campaign: Description of the campaign as plain data, for headers and notes.
        flights: Some of the runs, flown again as a whole, by their ids: for figures that draw paths.
        memo: Results of measures on these rows.
    """

    frame: pl.DataFrame
    records: Mapping[str, FlightRecord] = field(default_factory=dict)
    campaign: Mapping[str, Any] = field(default_factory=dict)
    flights: Mapping[str, Flight] = field(default_factory=dict)
    memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @staticmethod
    def read(directory: Path) -> "Runs":
        """The runs of a ledger that are done.

        Raises:
            BadInputError: There is no ledger.
        """
        from mavfi.campaign.analysis.about import describe

        with Store.open(directory) as store:
            return Runs.of(store.runs(done=True), describe(store))

    @staticmethod
    def of(runs: Iterable[Run], campaign: Mapping[str, Any] | None = None) -> "Runs":
        """Judge runs, in the order of the plan; those without a record are left out.

        In the campaign, as of `about.describe`, `monitored_set` names the fields that detectors watch.
        """
        about = campaign or {}
        done = [(run, run.record) for run in runs if run.record is not None]
        golden = [(run.spec, record) for run, record in done if run.spec.kind == GOLDEN]
        own = {(spec.arm, *spec.world): record for spec, record in golden}
        # the golden run of the same mission without a detector, whichever arm flew it
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
        """Value of the first row; an IndexError where there is none."""
        return self[column][0]

    def values(self, column: str) -> list[Any]:
        """Distinct values of a column, in the order in which they first appear."""
        return self.frame[column].unique(maintain_order=True).to_list()

    def recorded(self) -> list[FlightRecord]:
        """Records of the rows, in their order."""
        return [self.records[run_id] for run_id in self["run_id"]]

    def where(self, *tests: pl.Expr | str, **values: Any) -> "Runs":
        """Rows that pass all tests: expressions, names of columns that must be true, and column = value."""
        asked = [pl.col(test) if isinstance(test, str) else test for test in tests]
        asked += [pl.col(column) == value for column, value in values.items()]
        return replace(self, frame=self.frame.filter(*asked)) if asked else self

    def adding(self, **columns: pl.Expr) -> "Runs":
        """With further columns."""
        return replace(self, frame=self.frame.with_columns(**columns))

    def groups(self, *by: str) -> dict[tuple[Any, ...], "Runs"]:
        """Rows by the values of columns, in the order in which they first appear."""
        if not by:
            return {(): self}
        parts = self.frame.partition_by(by, maintain_order=True, as_dict=True)
        return {key: replace(self, frame=part) for key, part in parts.items()}

    def with_total(self, column: str, label: str) -> "Runs":
        """The rows; where the column has several values, all of them once more with this label."""
        if self.frame[column].n_unique() < 2:
            return self
        return replace(self, frame=pl.concat([self.frame, self.frame.with_columns(pl.lit(label).alias(column))]))

    def exploded(self, parts: Callable[[FlightRecord], Sequence[Mapping[str, Any]]]) -> "Runs":
        """Several rows for each run, or none: the run's columns and those that a function finds in its record."""
        rows = [{**row, **part} for row, record in zip(self, self.recorded(), strict=True) for part in parts(record)]
        return replace(self, frame=pl.DataFrame(rows, infer_schema_length=None) if rows else self.frame.clear())

    @property
    def golden(self) -> "Runs":
        """Runs without a fault."""
        return self.where(kind=GOLDEN)

    @property
    def injected(self) -> "Runs":
        """Runs with a fault that changes something."""
        return self.where(kind=INJECTED)

    @property
    def null(self) -> "Runs":
        """Runs with an empty mask."""
        return self.where(kind=NULL)

    @property
    def has_missions(self) -> bool:
        """Whether something flew; trials of a foreign node have outputs, no flights."""
        return len(self.where(pl.col("flight_time_s") > 0)) > 0

    def settings(self) -> list[str]:
        """Settings that fly faults, `fi` first."""
        return sorted(self.injected.values("setting"), key=lambda setting: setting != FI)
