"""`Runs`: a campaign as a frame with one row per run, with the complete records."""

import html
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from mavfi.analysis.likeness import differences
from mavfi.analysis.rows import GOLDEN, INJECTED, NULL, SCHEMA, row_of
from mavfi.analysis.statistics import CONFIDENCE
from mavfi.campaign.config import ArmConfig, Campaign, label_of
from mavfi.campaign.ledger import status, stored_campaign
from mavfi.campaign.plan import FI
from mavfi.campaign.store import Run, Store
from mavfi.mission import MissionSpec
from mavfi.plugins import extensions
from mavfi.record import FlightRecord
from mavfi.states import MONITORED_SETS

if TYPE_CHECKING:
    from mavfi.flight.host import Flight

DEFAULT_MONITORED = "paper-13"
_TELLING = ("run_id", "setting", "environment", "seed", "site", "bit", "time_s", "effect", "status", "flight_time_s")
"""Columns that a notebook shows."""
ALL = "all"  # label of total rows, e.g. over all environments


def condition(test: pl.Expr | str) -> pl.Expr:
    """A test as an expression; a name is that of a flag column."""
    if isinstance(test, str):
        return pl.col(test)
    return test


@dataclass(frozen=True, repr=False)
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

        `campaign` is a description by `describe`; its `monitored_set` names the monitored fields.
        """
        description = campaign or {}
        done = [(run, run.record) for run in runs if run.record is not None]
        # golden runs with which each run is compared: of its arm, and of its mission without a detector, from any arm
        golden = [(run.spec, record) for run, record in done if run.spec.kind == GOLDEN]
        of_arm = {(spec.arm, *spec.world): record for spec, record in golden}
        of_mission = {(spec.scenario, *spec.world): record for spec, record in reversed(golden) if not spec.detector}
        monitored = MONITORED_SETS[description.get("monitored_set", DEFAULT_MONITORED)]
        rows = []
        for run, record in done:
            spec = run.spec
            arm_golden = of_arm.get((spec.arm, *spec.world))
            reference = of_mission.get((spec.scenario, *spec.world), arm_golden)
            rows.append(row_of(run, record, arm_golden, reference, monitored))
        frame = pl.DataFrame(rows, schema=SCHEMA).with_columns(pl.col(pl.String).fill_null(""))
        return Runs(frame, {run.spec.run_id: record for run, record in done}, description)

    def __repr__(self) -> str:
        return f"<Runs: {self.campaign.get('title', 'no campaign')}, {len(self)} rows>"

    def _repr_html_(self) -> str:
        """The rows in a notebook, without the columns that few readers need."""
        columns = [name for name in _TELLING if name in self.frame.columns]
        return f"<p>{html.escape(repr(self)[1:-1])}</p>{self.frame.select(columns)._repr_html_()}"

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
        if "run_id" in self.frame.columns:
            return tuple(self.values("run_id"))
        return ()

    def recorded(self) -> list[FlightRecord]:
        """Records of the runs, in row order."""
        return [self.records[run_id] for run_id in self["run_id"]]

    def where(self, *tests: pl.Expr | str, **values: Any) -> "Runs":
        """Rows that pass all tests: expressions, names of flag columns, and column=value."""
        conditions = [condition(test) for test in tests]
        conditions += [pl.col(column) == value for column, value in values.items()]
        if not conditions:
            return self
        return replace(self, frame=self.frame.filter(*conditions))

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
        if not rows:
            return replace(self, frame=self.frame.clear())
        return replace(self, frame=pl.DataFrame(rows, infer_schema_length=None))

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

    @property
    def per_mission(self) -> str:
        """Number of faults in each mission, in words."""
        return str(self.campaign.get("per_mission", "one fault"))

    def settings(self) -> list[str]:
        """Settings with injected runs, `fi` first."""
        return sorted(self.injected.values("setting"), key=lambda setting: setting != FI)


# ---- description of a campaign as plain data, for the headers and notes of tables ----------------------------------

_LISTED_KEYS = (
    "vehicle",
    "map",
    "trajectory",
    "waypoint",
    "pid",
    "flight_controller",
    "arrival_radius",
    "time_limit_factor",
    "latency_jitter",
    "grain",
    "same_twice",
    "answer_s",
    "degraded",
    "detector_place",
    "dead_node",
    "alarm",
    "epoch_liveness",
    "protection",
)
"""Keys of a mission that are listed when they differ from their defaults."""


def describe(store: Store) -> dict[str, Any]:
    """Describe the campaign of a ledger, and its progress.

    Returns:
        `title` and `lines` are text; views need `profile` (of the autopilot), `monitored_set`, `each` (unit to which
        the number of faults applies), `kernels` and `which`, `parts`, `unlike_the_paper` (of flights, see
        `likeness.differences`), and what extras add, e.g. measured `overheads`.
    """
    campaign = stored_campaign(store)
    progress = status(store.directory)
    return {
        "name": campaign.name,
        "host": campaign.host,
        "environments": [label_of(name) for name in campaign.environments],
        "seeds": [campaign.seeds.start, campaign.seeds.stop - 1],
        "on_design_seeds": campaign.on_design_seeds,
        "missions": campaign.missions,
        "faults": campaign.faults,
        "monitored_set": campaign.monitored_set,
        "mission": dict(campaign.mission),
        "sampling": campaign.sampling.to_json(),
        "parts": {name: part.model_dump(exclude_none=True) for name, part in campaign.parts.items()},
        "arms": {name: arm.model_dump(mode="json") for name, arm in campaign.arms.items()},
        "models": store.meta("identity")["models"],
        "confidence": CONFIDENCE,
        "versions": store.meta("versions") or {},
        **{name: read(store.directory) for name, read in extensions("mavfi.descriptions").items()},
        "digest": store.digest(),
        "done": progress.done,
        "total": progress.total,
        "custom_detectors": [plug_in.name for plug_in in campaign.custom_detectors.values()],
        **drawn(campaign),
    }


def drawn(campaign: Campaign) -> dict[str, Any]:
    """Describe the sampling of a campaign's faults and the flights or processes that they are injected into."""
    about: dict[str, Any] = campaign.level.about(campaign)
    if "title" in about:  # of processes, not of flights
        return about
    how = about.pop("how")
    return about | {"unlike_the_paper": differences(campaign, about)} | _flights(campaign, about["each"], how)


def _flights(campaign: Campaign, each: str, how: str) -> dict[str, Any]:
    """Describe the flights of a campaign.

    Args:
        campaign: The campaign.
        each: Unit to which the number of faults applies, e.g. "stage".
        how: How a fault is drawn, in words.
    """
    # missions, faults and arms
    missions_flown = [campaign.spec(name, campaign.first_seed) for name in campaign.environments]
    mission = missions_flown[0]
    seeds = f"seeds {campaign.seeds.start} to {campaign.seeds.stop - 1}"
    missions = f"{campaign.missions} mission{'s' * (campaign.missions != 1)} per environment ({seeds})"
    lines = [f"{missions}, {campaign.faults} fault{'s' * (campaign.faults != 1)} per {each}, {how}"]
    if campaign.arms:
        arms = ", ".join(_arm(name, arm) for name, arm in sorted(campaign.arms.items()))
        lines.append(f"arms: {arms}; coupling {mission.coupling}; monitored set {campaign.monitored_set}")
    if campaign.parts:
        parts = (f"{name} = {part.environment}" for name, part in campaign.parts.items())
        lines.append(f"parts: {', '.join(parts)}")
    # keys of the mission that are not at their defaults
    changed = [
        f"{key} {getattr(mission, key)}"
        for key in _LISTED_KEYS
        if getattr(mission, key) != MissionSpec.model_fields[key].default
    ]
    if changed:
        lines.append(f"mission: {', '.join(changed)}")
    platforms = ", ".join(dict.fromkeys(spec.platform for spec in missions_flown))
    title = f"campaign {campaign.name} · autopilot profile {mission.autopilot} · {platforms} · {mission.planner}"
    if mission.v_max is not None:
        title = f"{title} · {mission.v_max:g} m/s"
    return {"profile": mission.autopilot, "title": title, "lines": lines}


_PAPERS_DETECTORS = ("gaussian", "autoencoder")
"""Detectors whose profile is always named."""


def _arm(name: str, arm: ArmConfig) -> str:
    """An arm in words: its name, its detector unless it has the same name, and its keys of the mission."""
    text = name
    if arm.detector and arm.detector != name:
        text = f"{name} = {arm.detector}"
    # Most others have no profile: the default is only a word.
    if arm.detector in _PAPERS_DETECTORS or (arm.detector and arm.profile != ArmConfig.model_fields["profile"].default):
        text = f"{text} ({arm.profile})"
    changed = ", ".join(f"{key} {value}" for key, value in arm.mission.items())
    if changed:
        return f"{text} with {changed}"
    return text
