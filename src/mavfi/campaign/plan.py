"""Campaign -> `RunSpec`s: specification and ledger position of every run, fixed before it is flown.

Settings are the paper's, generalized to any number of arms: `golden`, `fi`, and for each arm `golden_<arm>` and
`dr_<arm>` (`fi_<arm>` if it has no detector).  `null` and `null_<arm>` fly through the injector with an empty mask.
Fault i of a target is injected in the same mission, at the same site, in `fi` and in every other arm.
"""

import hashlib
import itertools
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple

from mavfi.campaign.config import Campaign, label_of
from mavfi.campaign.resolve import Arm, ResolvedCampaign
from mavfi.config import checked
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, fault_from_json
from mavfi.levels.level import NULL, Draw, FaultBlock, draws_of
from mavfi.mission import MissionStatus
from mavfi.record import End, FlightRecord, canonical


@dataclass(frozen=True, slots=True)
class Shard:
    """Shard `number` (counted from 1) of `of`: every n-th mission.  Merging all gives the campaign's ledger."""

    number: int = 1
    of: int = 1

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @staticmethod
    def parse(text: str, source: str) -> "Shard":
        """Parse "i/n"; `source` names option or file in messages.

        Raises:
            BadInputError: The text is not a shard.
        """
        number, _, of = text.partition("/")
        if not (number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of)):
            raise BadInputError(f"{source}: {text}: allowed: I/N with 1 <= I <= N, e.g. 3/16")
        return Shard(int(number), int(of))

    def missions(self, campaign: Campaign) -> int:
        """Number of missions in this shard."""
        return len(range(self.number - 1, campaign.total_missions, self.of))

    def worlds(self, campaign: Campaign) -> Iterator[tuple[str, int]]:
        """Environment and seed of the missions in this shard."""
        worlds = itertools.product(campaign.environments, campaign.seeds)
        return itertools.islice(worlds, self.number - 1, None, self.of)


WHOLE = Shard()
"""All missions."""


# ---- the runs ------------------------------------------------------------------------------------------------------

GOLDEN = "golden"
FI = "fi"
RECOVERY = "dr"
Kind = Literal["golden", "injected", "null"]


class Row(NamedTuple):
    """A planned run as a ledger row; built by workers, since serialization takes longer than storing."""

    run_id: str
    position: int
    kind: str
    setting: str
    environment: str
    seed: int
    text: str  # of the `RunSpec`


@dataclass(frozen=True, slots=True)
class RunSpec:
    """Specification of one run; together with its scenario it determines every byte of its record."""

    kind: Kind
    setting: str  # see the module docstring
    environment: str  # name in the campaign
    seed: int
    scenario: str  # key of the scenario with the campaign's first seed
    arm: str = ""  # "" = the campaign's own mission, without a detector
    detector: str = ""  # "" = none
    detector_profile: str = ""
    model: str = ""  # sha256 of the detector's trained model
    target: str = ""  # stage, group, kernel or kind of registers of the fault; "" for golden runs
    index: int = 0  # number of the fault within target and environment
    fault: Fault | None = None
    position: int = field(default=0, compare=False)  # position in the ledger; does not affect the record
    run_id: str = field(default="", compare=False)  # readable, and unique by a hash of the fields above

    def __post_init__(self) -> None:
        content = json.dumps({**self.to_json(), "position": 0, "run_id": ""}, sort_keys=True)
        parts = [label_of(self.environment), str(self.seed), self.setting]
        if self.target:
            parts += [self.target, str(self.index)]
        readable = "-".join(re.sub(r"[^A-Za-z0-9_.]+", "_", part) for part in parts)
        object.__setattr__(self, "run_id", f"{readable}-{hashlib.sha256(content.encode()).hexdigest()[:8]}")

    @property
    def world(self) -> tuple[str, int]:
        """Environment and seed."""
        return self.environment, self.seed

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        data = {f.name: getattr(self, f.name) for f in fields(self)}
        if self.fault is not None:
            data["fault"] = self.fault.to_json()
        return data

    def row(self) -> Row:
        """The run as a ledger row."""
        text = canonical(self.to_json())
        return Row(self.run_id, self.position, self.kind, self.setting, self.environment, self.seed, text)

    @staticmethod
    def from_json(data: dict[str, Any]) -> "RunSpec":
        """Inverse of `to_json`; raises a BadInputError for invalid data."""
        if isinstance(data, dict) and data.get("fault") is not None:
            data = {**data, "fault": fault_from_json(data["fault"])}
        return checked(RunSpec, data, "run")


@dataclass(frozen=True, slots=True)
class Planned:
    """Runs of a mission before they are flown; `last`: the mission has no further runs."""

    rows: tuple[Row, ...]
    last: bool

    @staticmethod
    def of(specs: Iterable[RunSpec], *, last: bool) -> "Planned":
        """Build from run specifications."""
        return Planned(tuple(spec.row() for spec in specs), last)

    @property
    def specs(self) -> list[RunSpec]:
        """The runs."""
        return [RunSpec.from_json(json.loads(row.text)) for row in self.rows]


@dataclass(frozen=True, slots=True)
class CompletedRun:
    """A completed run; `note`: why there is none, see `reason_of`; the wall time is not part of the record."""

    run_id: str
    text: str  # record as in the ledger; serialized by workers, since this takes longer than storing
    success: bool
    unknown: bool = False  # no flight to evaluate, due to an error of mavfi
    note: str = ""
    wall_s: float = field(default=0.0, compare=False)

    @staticmethod
    def of(run_id: str, record: FlightRecord, note: str = "", wall_s: float = 0.0) -> "CompletedRun":
        """Build from a record."""
        success = record.status == MissionStatus.SUCCESS.label
        return CompletedRun(run_id, canonical(record.to_json()), success, record.end is End.UNKNOWN, note, wall_s)

    @property
    def record(self) -> FlightRecord:
        """Record of the flight."""
        return FlightRecord.from_json(json.loads(self.text))


def reason_of(note: str) -> str:
    """Why a run has status unknown: the last line of its note, after a traceback if there was an exception."""
    return note.strip().rpartition("\n")[2]


def _with_arm(setting: str, arm: str) -> str:
    if arm:
        return f"{setting}_{arm}"
    return setting


@dataclass(frozen=True, slots=True)
class Plan:
    """The runs of a campaign, before any is flown."""

    campaign: ResolvedCampaign

    @property
    def repeating_arms(self) -> tuple[Arm, ...]:
        """Arms in which every fault is repeated."""
        return tuple(arm for arm in self.campaign.arms if arm.name and not arm.is_variant)

    def golden(self, environment: str, seed: int) -> list[RunSpec]:
        """The golden runs of a mission, one per arm."""
        campaign = self.campaign.config
        mission = campaign.environments.index(environment) * campaign.missions + seed - campaign.first_seed
        first = mission * len(self.campaign.arms)
        return [
            self._run("golden", _with_arm(GOLDEN, arm.name), environment, seed, arm, position=first + number)
            for number, arm in enumerate(self.campaign.arms)
        ]

    def positioned_draws(self, environment: str, seed: int) -> Iterator[tuple[int, Draw]]:
        """The draws of a mission, each with the position of its first run among the injected and null runs.

        Positions go through the environments; in each, through its faults, with one position for every arm that could
        repeat the fault, and then through its null runs.
        """
        campaign = self.campaign.config
        runs_per_fault = 1 + len(self.repeating_arms)
        blocks = self.campaign.sampler.blocks(environment)
        mission = seed - campaign.first_seed
        draws = sum(block.count for block in blocks)
        per_environment = draws * runs_per_fault + campaign.nulls
        first = campaign.environments.index(environment) * per_environment
        for number, draw in draws_of(blocks, range(mission, mission + 1)):
            yield first + number * runs_per_fault, draw
        first_null = first + draws * runs_per_fault
        for index in range(mission, campaign.nulls, campaign.missions):
            yield first_null + index, Draw(NULL, index, seed)

    def injected(self, environment: str, draw: Draw, position: int, fault: Fault) -> list[RunSpec]:
        """The runs of one fault, in its variant and in every arm, or only in the arm of the injected detector.

        A null run is in one arm only, cyclically.  `position` is that of the first run, see `positioned_draws`.
        """
        first = self.golden_count() + position
        if draw.target == NULL:
            kind: Kind = "null"
            arms = [arm for arm in self.campaign.arms if not arm.is_variant]
            arm = arms[draw.index % len(arms)]
            settings = [(arm, _with_arm(NULL, arm.name))]
        else:
            kind = "injected"
            settings = self._settings_of_fault(draw)
        return [
            self._run(
                kind,
                setting,
                environment,
                draw.seed,
                arm,
                target=draw.target,
                index=draw.index,
                fault=fault,
                position=first + number,
            )
            for number, (arm, setting) in enumerate(settings)
        ]

    def _settings_of_fault(self, draw: Draw) -> list[tuple[Arm, str]]:
        """Arms and settings in which a fault is flown."""
        variant = next(arm for arm in self.campaign.arms if arm.name == draw.variant)
        if variant.detector:  # the fault is in this detector, which other arms lack
            return [(variant, _with_arm(RECOVERY, variant.name))]
        settings = [(variant, FI)]
        for arm in self.repeating_arms:
            setting = RECOVERY if arm.detector else FI
            settings.append((arm, _with_arm(setting, arm.name)))
        return settings

    def count(self, shard: Shard = WHOLE) -> int:
        """Maximum number of runs of the campaign or a shard; faults that cannot be drawn have no runs."""
        campaign = self.campaign.config
        total = self.golden_count(shard)
        for number, name in enumerate(campaign.environments):
            # the shard's first mission in this environment, since the missions of all environments are numbered through
            first = (shard.number - 1 - number * campaign.missions) % shard.of
            for block in self.campaign.sampler.blocks(name):
                if block.count:
                    runs_per_fault = len(self._settings_of_fault(block.draw(0)))
                    total += _of_shard(block, first, shard.of) * runs_per_fault
            nulls = FaultBlock(campaign.nulls, lambda _: Draw(NULL, 0, 0), 0, campaign.missions)
            total += _of_shard(nulls, first, shard.of)
        return total

    def golden_count(self, shard: Shard = WHOLE) -> int:
        """Number of golden runs of the campaign or a shard."""
        return shard.missions(self.campaign.config) * len(self.campaign.arms)

    def _run(self, kind: Kind, setting: str, environment: str, seed: int, arm: Arm, **more: Any) -> RunSpec:
        """A run of an arm, with what is planned for it."""
        return RunSpec(
            kind,
            setting,
            environment,
            seed,
            self.campaign.scenario_keys[environment, arm.name],
            arm.name,
            arm.detector,
            arm.profile,
            self.campaign.model(environment, arm.name),
            **more,
        )


def _of_shard(block: FaultBlock, first: int, step: int) -> int:
    """Count the faults of a block in a shard, which has the missions `first`, `first` + `step` and so on."""
    rounds, rest = divmod(block.count, block.missions)
    # The last round goes from the block's first mission on, and may go on from mission 0.
    end = block.mission + rest
    last_round = [range(block.mission, min(end, block.missions)), range(end - block.missions)]
    in_last_round = sum(len(range(first, part.stop, step)) - len(range(first, part.start, step)) for part in last_round)
    return rounds * len(range(first, block.missions, step)) + in_last_round
