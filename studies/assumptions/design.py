"""Model of the study of assumptions (`assumptions.yaml`): axes, their values, anchors, readings.

A reading chooses one value of each axis.  It is flown as a campaign; values that only change how flights are counted
share the flights of the readings that differ in nothing else.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

from pydantic import Field, model_validator

from mavfi.campaign.config import Campaign
from mavfi.config import Config, Name, parse
from mavfi.levels.level import check_known

STATE = "state"
INSTRUCTION = "instruction"
DETECTORS = ("gaussian", "autoencoder")
"""The paper's detectors: GAD and AAD."""


class AxisValue(Config):
    """A value of an axis: what it changes in a campaign, or how its flights are counted."""

    text: str = Field(description="in words, for tables")
    source: str = Field(description="where paper or published code say so")
    sampling: dict[str, Any] = Field(default_factory=dict, description="keys of a campaign's sampling, at any level")
    state: dict[str, Any] = Field(default_factory=dict, description="keys of the sampling at state level")
    instruction: dict[str, Any] = Field(default_factory=dict, description="keys of the sampling at instruction level")
    levels: tuple[str, ...] = Field((STATE, INSTRUCTION), description="levels of faults to which it applies")
    mission: dict[str, Any] = Field(default_factory=dict, description="keys of a mission")
    environments: dict[str, str] = Field(default_factory=dict, description="other worlds in place of the paper's")
    deaths: Literal["restart", "end", "not_counted"] = Field("restart", description="how a dead kernel is counted")
    losses: Literal["flown", "background", "time_limit"] = Field(
        "flown",
        description="what loses golden runs: what is flown; besides, a background that is independent of the fault, or "
        "a time limit; either is fitted for each environment",
    )

    kind: str = Field("", description="values of a kind compete: the best reading of each kind is frozen")

    @property
    def only_counts(self) -> bool:
        """Whether it changes no flight."""
        return not (self.sampling or self.state or self.instruction or self.mission or self.environments)


class Axis(Config):
    """An assumption that paper and code leave open, with its possible values."""

    title: str
    values: dict[Name, AxisValue] = Field(min_length=2)


class Anchor(Config):
    """A reading from which others differ in one axis."""

    values: dict[str, str] = Field(description="a value of each axis")
    vary: tuple[str, ...] = Field((), description="axes that are changed; default: all")


class DetectorReading(Config):
    """How the detectors are placed, what their alarms do, and on what they were trained."""

    text: str
    source: str
    gaussian: dict[str, Any] = Field(description="keys of the arm of the Gaussian detector")
    autoencoder: dict[str, Any] = Field(description="keys of the arm of the autoencoder")
    training: tuple[str, ...] = Field((), description="environments of the training flights; default: generated worlds")

    def keys_of(self, kind: str) -> dict[str, Any]:
        """Keys of the arm of a detector, a name of `DETECTORS`."""
        keys: dict[str, Any] = getattr(self, kind)
        return keys


class Rounds(Config):
    """Sizes: each round flies fresh missions, until a reading is rejected or all rounds are flown."""

    missions: int = Field(25, ge=2, description="per environment and round; one fault per stage in each")
    number: int = Field(4, ge=1)
    reject_below: float = Field(1e-4, gt=0, lt=1, description="p below which a reading is flown no further")
    behind: float = Field(6.0, gt=0, description="or once its criterion exceeds the best one by this")
    best: int = Field(3, ge=2, description="changes per anchor, the best, that are combined in pairs")
    first_seed: int = Field(30_000, ge=10_000)
    judged_first_seed: int = Field(40_000, ge=10_000)
    judged_missions: int = Field(40, ge=2)
    frozen: int = Field(2, ge=1, description="readings that are frozen: the best of as many kinds of place")


class AssumptionStudy(Config):
    """Axes, anchors, and the readings of the detectors."""

    name: Name
    environments: tuple[str, ...] = ("factory", "farm", "sparse", "dense")
    rounds: Rounds = Rounds()
    axes: dict[Name, Axis]
    anchors: dict[Name, Anchor]
    detectors: dict[Name, DetectorReading]
    training_flights: int = Field(100, ge=1)

    @model_validator(mode="after")
    def _consistent(self) -> "AssumptionStudy":
        for name, anchor in self.anchors.items():
            check_known(f"anchors.{name}", [*anchor.values, *anchor.vary], self.axes)
            for axis in self.axes:
                if axis not in anchor.values:
                    raise ValueError(f"anchors.{name}: no value of {axis!r}; needed: a value of each axis")
                check_known(f"anchors.{name}.{axis}", [anchor.values[axis]], self.axes[axis].values)
        return self

    def value(self, axis: str, name: str) -> AxisValue:
        """A value of an axis."""
        return self.axes[axis].values[name]

    def kind_of(self, reading: "PaperReading") -> str:
        """Kinds of a reading's values, of those axes that have kinds."""
        kinds = [self.value(axis, name).kind for axis, name in reading.values]
        return " ".join(kind for kind in kinds if kind)

    def anchor(self, name: str) -> "PaperReading":
        """The reading of an anchor."""
        return PaperReading(tuple((axis, self.anchors[name].values[axis]) for axis in self.axes))

    def single_changes(self) -> "dict[PaperReading, list[AxisChange]]":
        """Readings that differ from an anchor in one axis, with the changes that lead to each; the anchors first.

        A reading whose changed value does not apply to its level of faults is left out.
        """
        readings: dict[PaperReading, list[AxisChange]] = {self.anchor(name): [] for name in self.anchors}
        for name in self.anchors:
            for axis, value in self._changes(name):
                changed = self.anchor(name).with_value(axis, value)
                if self.applies(changed):
                    readings.setdefault(changed, []).append(AxisChange(name, axis, value))
        return readings

    def _changes(self, anchor: str) -> Iterator[tuple[str, str]]:
        """Axes that an anchor varies, with their other values."""
        for axis in self.anchors[anchor].vary or self.axes:
            for value in self.axes[axis].values:
                if value != self.anchor(anchor)[axis]:
                    yield axis, value

    def applies(self, reading: "PaperReading") -> bool:
        """Whether all values apply to the level of faults that the reading chooses."""
        level = self.sampling_of(reading).get("level", STATE)
        return all(level in self.value(axis, name).levels for axis, name in reading.values)

    def sampling_of(self, reading: "PaperReading") -> dict[str, Any]:
        """Keys of the sampling: those for any level, then those of the level that they choose."""
        values = [self.value(axis, name) for axis, name in reading.values]
        sampling: dict[str, Any] = {}
        for value in values:
            sampling |= value.sampling
        for value in values:
            if sampling.get("level", STATE) == INSTRUCTION:
                sampling |= value.instruction
            else:
                sampling |= value.state
        return sampling

    def flights_of(self, reading: "PaperReading") -> "PaperReading":
        """The reading whose flights it counts: values that only count are replaced by the first of their axis."""
        flown = reading
        for axis, name in reading.values:
            first = next(iter(self.axes[axis].values))
            if self.value(axis, name).only_counts and self.value(axis, first).only_counts:
                flown = flown.with_value(axis, first)
        return flown

    def counted_alike(self, flown: "PaperReading") -> "list[PaperReading]":
        """All readings that count the flights of one in another way, itself first."""
        readings = [flown]
        for axis, definition in self.axes.items():
            for value in definition.values:
                if value != flown[axis]:
                    readings += [
                        other
                        for other in (reading.with_value(axis, value) for reading in list(readings))
                        if self.flights_of(other) == flown and self.applies(other)
                    ]
        return list(dict.fromkeys(readings))

    def pairs(self, changes: "Mapping[str, list[AxisChange]]") -> "dict[PaperReading, str]":
        """Readings with two changes of different axes of the same anchor, with the anchor's name."""
        pairs = {}
        for name, best in changes.items():
            for first, second in combinations(best[: self.rounds.best], 2):
                reading = self.anchor(name).with_value(first.axis, first.value).with_value(second.axis, second.value)
                if first.axis != second.axis and self.applies(reading):
                    pairs[reading] = name
        return pairs

    def campaign(self, reading: "PaperReading", round_number: int) -> Campaign:
        """The campaign of a round: faults without a detector."""
        first_seed = self.rounds.first_seed + round_number * self.rounds.missions
        return self._campaign(reading, first_seed, self.rounds.missions, {})

    def judged_campaign(self, reading: "PaperReading", training: tuple[str, ...]) -> Campaign:
        """The campaign on fresh seeds with the arms of all readings of the detectors that share their training."""
        arms = {}
        for name, detectors in self.detectors.items():
            if detectors.training == training:
                for kind in DETECTORS:
                    arms[self.arm_of(name, kind)] = {"detector": kind, **detectors.keys_of(kind)}
        return self._campaign(reading, self.rounds.judged_first_seed, self.rounds.judged_missions, arms)

    def arm_of(self, name: str, kind: str) -> str:
        """Arm of a detector in a reading of the detectors: that of the first reading with the same keys."""
        wanted = self.detectors[name]
        for other, detectors in self.detectors.items():
            if detectors.training == wanted.training and detectors.keys_of(kind) == wanted.keys_of(kind):
                return f"{other}_{kind}"
        raise KeyError(name)

    def _campaign(self, reading: "PaperReading", first_seed: int, missions: int, arms: Mapping[str, Any]) -> Campaign:
        environments = list(self.environments)
        mission: dict[str, Any] = {}
        for axis, name in reading.values:
            value = self.value(axis, name)
            mission |= value.mission
            environments = [value.environments.get(environment, environment) for environment in environments]
        data = {
            "name": self.name,
            "environments": environments,
            "first_seed": first_seed,
            "missions": missions,
            "faults": missions,
            "null_runs": 0,
            "sampling": self.sampling_of(reading),
            "mission": mission,
            "arms": dict(arms),
        }
        return parse(Campaign, data, f"study {self.name}: {reading.text}")


@dataclass(frozen=True, slots=True)
class PaperReading:
    """A value of each axis, in the order of the axes."""

    values: tuple[tuple[str, str], ...]

    def __getitem__(self, axis: str) -> str:
        return dict(self.values)[axis]

    def with_value(self, axis: str, value: str) -> "PaperReading":
        """The reading with another value of an axis."""
        return PaperReading(tuple((name, value if name == axis else old) for name, old in self.values))

    @property
    def text(self) -> str:
        """Names of the values, e.g. "monitored, classes, uniform, restart, flown"."""
        return ", ".join(value for _, value in self.values)

    @property
    def folder(self) -> str:
        """Name of the folder of its ledgers."""
        return "-".join(value for _, value in self.values)


@dataclass(frozen=True, slots=True)
class AxisChange:
    """A change of one axis of an anchor."""

    anchor: str
    axis: str
    value: str
