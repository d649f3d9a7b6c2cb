"""The unit of work: all runs of one mission.  `fly_mission` is a pure function of a `MissionPlan`.

Missions of several campaigns that start from the same golden flights can be one job: `fly_missions`.

Sequence: golden runs, drawing of the faults from them, injected runs; planned runs are yielded before they are flown.
Exceptions of mavfi itself are recorded as `unknown`, never as an effect of a fault; machine failures are not recorded.
"""

import json
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from mavfi.campaign.alone import fly_alone
from mavfi.campaign.plan import CompletedRun, Plan, Planned, RunSpec
from mavfi.campaign.resolve import Arm, ResolvedCampaign
from mavfi.detectors.detector import Detector, is_custom
from mavfi.errors import MachineError, MavfiError, SpecMismatchError, machine_failure
from mavfi.faults.fault import Fault
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.host import ArmSetup, DetectorChoice, MissionFlights, Recorded
from mavfi.levels.level import NULL, Sampled
from mavfi.mission import Scenario
from mavfi.plugins import plugin_failure, reason
from mavfi.record import End, FlightRecord


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """A mission with all inputs that determine its runs."""

    campaign: ResolvedCampaign  # files that give other scenarios or models than its own are refused
    environment: str
    seed: int
    fast_forward: bool = True  # start flights at checkpoints of known ones; the records are the same either way
    done: frozenset[str] = frozenset()  # ids of the runs in the ledger
    alone: bool = False  # fly each injected run in a separate child process, after this mission has crashed a worker

    @property
    def world(self) -> tuple[str, int]:
        """Environment and seed."""
        return self.environment, self.seed


Job = tuple[tuple[int, MissionPlan], ...]
"""Missions that share golden flights, each with a number that distinguishes them."""
_RunsByFault = dict[tuple[str, Fault | None], CompletedRun]
"""Injected runs by arm and fault, which determine their records."""


def flights_of(campaign: ResolvedCampaign, environment: str) -> dict[str, str]:
    """What determines the golden flights of a campaign's missions in an environment but their seed, as text by arm."""
    return {
        arm.name: json.dumps(
            [
                campaign.config.host,
                str(campaign.config.under_test),
                arm.detector,
                arm.profile,
                dict(arm.options),
                campaign.model(environment, arm.name),
                campaign.scenario_keys[environment, arm.name],
                campaign.spec(environment, arm).model_dump_json(),
            ],
            sort_keys=True,
        )
        for arm in campaign.arms
    }


def share(flights: Mapping[str, str], others: Mapping[str, str]) -> bool:
    """Whether missions share golden flights (as by `flights_of`): that without a detector, and no arm differs."""
    return flights[""] == others[""] and all(others.get(arm, text) == text for arm, text in flights.items())


def setup_of(mission: MissionPlan, arm: Arm, scenario: Scenario | None = None) -> ArmSetup:
    """Setup of an arm; a model other than the planned one is refused when the detector is constructed.

    Without a scenario, the mission is resolved from the files that it names.
    """
    campaign = mission.campaign
    spec = campaign.config.spec(mission.environment, mission.seed, arm.overrides)
    scenario = scenario or campaign.host.resolve(spec)

    def make() -> Detector:
        """Load the detector; its model must be the planned one."""
        detector, model = campaign.detector(arm, scenario)
        planned = campaign.model(mission.environment, arm.name)
        if model != planned:
            raise SpecMismatchError(
                f"arm {arm.name}: planned with the model {planned[:12]}, but "
                f"{campaign.models_dir or 'the shipped folder'} holds {model[:12]}"
            )
        return detector

    recovery = RecoveryPolicy.of(spec)
    if not arm.detector:
        return ArmSetup(scenario, None, recovery)
    if campaign.host.trains:
        return ArmSetup(scenario, None, recovery, choice=DetectorChoice(arm.detector, arm.profile))
    return ArmSetup(scenario, make, recovery)


@dataclass(frozen=True, slots=True)
class _ResolvedMission:
    """A mission whose scenarios are resolved."""

    mission: MissionPlan
    plan: Plan
    setups: Mapping[str, ArmSetup]

    @staticmethod
    def of(mission: MissionPlan) -> "_ResolvedMission":
        """Resolve the scenarios; a SpecMismatchError if local files (environment, vehicle) differ from the planned."""
        campaign = mission.campaign
        here = campaign.with_scenarios([mission.environment])
        for (environment, arm), key in here.scenario_keys.items():
            if campaign.scenario_keys.get((environment, arm), key) != key:
                raise SpecMismatchError(
                    f"environment {environment}, arm {arm or 'golden'}: other files than planned with"
                )
        return _ResolvedMission(mission, Plan(here), {arm.name: setup_of(mission, arm) for arm in campaign.arms})

    def custom_arms(self) -> frozenset[str]:
        """The arms with a custom detector that is called in this process, which it may block or end."""
        if not self.mission.campaign.host.in_process:
            return frozenset()
        return frozenset(name for name, setup in self.setups.items() if is_custom(setup.detector()))


def has_custom_detectors(mission: MissionPlan) -> bool:
    """Whether an arm has a custom detector that is called in this process."""
    return bool(_ResolvedMission.of(mission).custom_arms())


def fly_mission(mission: MissionPlan) -> Iterator[Planned | CompletedRun]:
    """Fly all runs of a mission that are not in the ledger yet.

    Yields:
        The planned golden runs, then their records; the planned injected and null runs, then their records.

    Raises:
        BadInputError: The mission cannot be flown at all: a name is unknown, or a model does not match.
        MachineError: The machine failed.
    """
    return (item for _, item in fly_missions(((0, mission),)))


def fly_missions(job: Job) -> Iterator[tuple[int, Planned | CompletedRun]]:
    """As `fly_mission`, for missions that `share` golden flights; each item has the number of its mission."""
    current = job[0][1]  # named in messages
    try:
        resolved_missions = []
        for number, mission in job:
            current = mission
            resolved_missions.append((number, _ResolvedMission.of(mission)))

        # The arms of all missions share one set of flights, and with it the golden flights.
        setups: dict[str, ArmSetup] = {}
        for _, resolved in resolved_missions:
            setups |= resolved.setups
        flights = current.campaign.host.mission(setups, fast_forward=current.fast_forward)

        runs_by_fault: _RunsByFault = {}
        for number, resolved in resolved_missions:
            current = resolved.mission
            for item in _fly(resolved, flights, runs_by_fault):
                yield number, item
    except Exception as error:
        _check_recordable(error, f"mission {current.environment}-{current.seed}")
        raise


def _check_recordable(error: Exception, where: str) -> None:
    """Raise errors that stop a campaign: machine failures, and deviations from the plan (models, files)."""
    if isinstance(error, (MachineError, SpecMismatchError)):
        raise error
    failed = machine_failure(error)
    if failed:
        raise MachineError(f"{where}: {failed}") from error


def _fly(
    resolved: _ResolvedMission, flights: MissionFlights, runs_by_fault: _RunsByFault
) -> Iterator[Planned | CompletedRun]:
    """The items of `fly_mission`; the injected runs are added to `runs_by_fault`."""
    mission = resolved.mission
    plan = resolved.plan
    golden = plan.golden(*mission.world)
    yield Planned.of(golden, last=False)

    # Golden runs, also those in the ledger: the faults are drawn from them.
    sampled: dict[str, Sampled] = {}
    alone = _SeparateFlights(resolved, flights) if mission.alone else None
    for spec in golden:
        if alone is not None and spec.arm in alone.custom_arms:  # no fault is drawn from it
            run = alone.golden(spec)
        else:
            run = _golden(plan, spec, flights, resolved.setups[spec.arm], sampled)
        if spec.run_id not in mission.done:
            yield run

    # Without the golden run of the mission itself there is nothing to draw from, and no effect could be told.
    specs = []
    if "" in sampled:
        specs = _draw(plan, mission, sampled)
    yield Planned.of(specs, last=True)

    # Another campaign of the job may have flown the same fault in the same arm.
    left = []
    for spec in specs:
        if spec.run_id in mission.done:
            continue
        same = runs_by_fault.get((spec.arm, spec.fault))
        if same is None:
            left.append(spec)
        else:
            yield replace(same, run_id=spec.run_id, wall_s=0.0)

    faults = {spec.run_id: (spec.arm, spec.fault) for spec in left}
    if alone is None:
        runs = _injected(left, flights)
    else:
        runs = alone.injected(left)
    for run in runs:
        if not run.unknown:
            runs_by_fault[faults[run.run_id]] = run
        yield run


class _SeparateFlights:
    """Runs of a mission that has crashed a worker, or exceeded its time limit: each is flown in a child process.

    Args:
        resolved: The mission.
        flights: Its flights in this process.

    Attributes:
        custom_arms: Arms with a custom detector, whose golden runs are flown in a child process, too.
    """

    def __init__(self, resolved: _ResolvedMission, flights: MissionFlights) -> None:
        self._resolved = resolved
        self._flights = flights
        self.custom_arms = resolved.custom_arms()

    def golden(self, spec: RunSpec) -> CompletedRun:
        """A golden run of an arm with a custom detector."""

        def fly(spec: RunSpec) -> CompletedRun:
            return _guarded(spec.run_id, lambda: self._from_take_off(spec.arm).golden(spec.arm).record())

        return next(fly_alone([spec], fly, self._fly_golden))

    def injected(self, specs: Sequence[RunSpec]) -> Iterator[CompletedRun]:
        """Injected and null runs in order."""

        def fly(spec: RunSpec) -> CompletedRun:
            if spec.arm in self.custom_arms:
                flights = self._from_take_off(spec.arm)
            else:
                flights = self._flights
            return next(_injected([spec], flights))

        return fly_alone(specs, fly, self._fly_golden)

    def _fly_golden(self, arm: str) -> None:
        """Fly the golden flight of an arm."""
        self._from_take_off(arm).golden(arm)

    def _from_take_off(self, arm: str) -> MissionFlights:
        """Flights of an arm that share nothing with those of this process."""
        return self._resolved.mission.campaign.host.mission({arm: self._resolved.setups[arm]}, fast_forward=False)


def _golden(
    plan: Plan, spec: RunSpec, flights: MissionFlights, setup: ArmSetup, sampled: dict[str, Sampled]
) -> CompletedRun:
    """Fly a golden run; where faults are drawn from it, its sample is stored in `sampled`."""
    arm = next(arm for arm in plan.campaign.arms if arm.name == spec.arm)

    def fly() -> FlightRecord:
        draws = []
        for _, draw in plan.positioned_draws(*spec.world):
            if draw.variant == arm.name and draw.target != NULL:
                draws.append(draw)
        if arm.name and not arm.is_variant and not draws:
            return flights.golden(arm.name).record()
        sample = plan.campaign.sampler.golden(arm.name, draws, spec.environment, flights, setup)
        sampled[arm.name] = sample
        profile = sample.flight.profile
        acted_on = {}
        if profile is not None:
            acted_on = {state: len(times) for state, times in profile.times_us.items()}
        return replace(sample.flight.record(), counts=sample.counts, acted_on=acted_on)

    return _guarded(spec.run_id, fly)


def _draw(plan: Plan, mission: MissionPlan, sampled: Mapping[str, Sampled]) -> list[RunSpec]:
    """All injected and null runs of a mission, in plan order."""
    sampler = plan.campaign.sampler
    environment = mission.environment
    positioned_draws = list(plan.positioned_draws(*mission.world))
    draws = [draw for _, draw in positioned_draws if draw.target != NULL]
    faults = iter(sampler.draw(draws, environment, sampled))  # in the same order
    specs = []
    for position, draw in positioned_draws:
        if draw.target == NULL:
            fault: Fault | None = sampler.null(draw.index, draw.seed, environment, sampled)
        else:
            fault = next(faults)
        if fault is not None:  # None = there is nothing to draw from
            specs += plan.injected(environment, draw, position, fault)
    return specs


def _injected(specs: Sequence[RunSpec], flights: MissionFlights) -> Iterator[CompletedRun]:
    """Injected and null runs in the order of the host; missing ones are `unknown`."""
    left = dict(enumerate(specs))
    note = "the host gave no such flight"
    started = time.perf_counter()
    try:
        for index, flight in flights.injected([(spec.arm, spec.fault) for spec in specs if spec.fault is not None]):
            wall_s = time.perf_counter() - started
            started = time.perf_counter()
            yield replace(_guarded(left.pop(index).run_id, partial(_record_of, flight)), wall_s=wall_s)
    except Exception as error:  # as in `_guarded`
        _check_recordable(error, specs[0].run_id)
        note = _note(error)
    for spec in left.values():
        yield CompletedRun.of(spec.run_id, FlightRecord(End.UNKNOWN, error="no flight"), note)


def _record_of(flight: Recorded | Exception) -> FlightRecord:
    """The record of a flight; an exception that a host yields in its place is raised."""
    if isinstance(flight, Exception):
        raise flight
    return flight.record()


def _guarded(run_id: str, work: Callable[[], FlightRecord]) -> CompletedRun:
    """Record a run; exceptions of mavfi are `unknown`, except those that stop a campaign, which are raised."""
    started = time.perf_counter()
    try:
        return CompletedRun.of(run_id, work(), wall_s=time.perf_counter() - started)
    except Exception as error:  # recorded as `unknown`, which reports count and show
        _check_recordable(error, run_id)
        record = FlightRecord(End.UNKNOWN, error=type(error).__name__)
        return CompletedRun.of(run_id, record, _note(error), time.perf_counter() - started)


def _note(error: Exception) -> str:
    """Traceback of the exception being handled, and then, as the note's last line, the exception on one line."""
    line = plugin_failure(error)
    if not line:
        line = str(error) if isinstance(error, MavfiError) else reason(error)
    return f"{traceback.format_exc()}{' '.join(line.split())}"
