"""Replay of stored runs: a single one, one with its golden run and all publications, or a random sample of a ledger."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mavfi.campaign.divergence import (
    Departure,
    FirstDifference,
    StateSpread,
    TimedState,
    departure,
    first_difference,
    spread,
)
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.mission import MissionPlan, setup_of
from mavfi.campaign.plan import RunSpec, reason_of
from mavfi.campaign.resolve import ResolvedCampaign, resolve
from mavfi.campaign.store import Run, Store
from mavfi.config import parse
from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import Fault
from mavfi.flight import mission_flights
from mavfi.flight.host import ArmSetup, Flight, Host, Recorded
from mavfi.flight.mission_flights import LocalHost
from mavfi.mission import Scenario
from mavfi.outcomes import Effect, effect_of
from mavfi.record import FlightRecord, record_of
from mavfi.rewriting import rewriter

CONFIDENCE = 0.95
"""Of the bound on the share of wrong records."""


@dataclass(frozen=True, slots=True)
class Replay:
    """A replayed run."""

    run: Run  # as stored
    record: FlightRecord  # of the replay

    @property
    def same(self) -> bool:
        """Whether the replay is bit-identical to the stored flight, or ended for the same reason if none is left."""
        stored = self.run.record
        if stored is None:
            return False
        now = self.record
        return (stored.end, stored.digest, stored.error) == (now.end, now.digest, now.error)

    @property
    def is_replayable(self) -> bool:
        """Whether all injections of the stored run can be repeated bit for bit."""
        return self.run.record is None or _can_be_repeated(self.run.record)


def _can_be_repeated(record: FlightRecord) -> bool:
    """Whether no fault marks a record as not replayable."""
    return all(injection.details.get("replayable", True) for injection in record.injections)


def replay(directory: Path, run_id: str) -> Replay:
    """Replay a run, given by an unambiguous prefix of its id.

    Raises:
        BadInputError: The campaign or run does not exist, the run is not flown yet, or its host is not deterministic.
        SpecMismatchError: The detector's model has changed since the run.
    """
    with Store.open(directory) as store:
        run = store.run(run_id)
        if run.record is None:
            raise BadInputError(f"{directory}: run {run.spec.run_id} is not flown yet")
        return Replay(run, fly_again(resolve_stored(store), store, run.spec).record())


def flight_again(store: Store, spec: RunSpec) -> Flight:
    """Replay a run of a ledger that is a flight.

    Raises:
        BadInputError, SpecMismatchError: See `replay`; or the host's runs are no flights.
    """
    campaign = resolve_stored(store)
    if not campaign.host.flies:  # before it is run
        raise BadInputError(f"{store.directory}: host {campaign.host.name}: its runs leave no flight log")
    flown = fly_again(campaign, store, spec)
    assert isinstance(flown, Flight)  # by `Host.flies`
    return flown


def resolve_stored(store: Store) -> ResolvedCampaign:
    """The campaign of a ledger, with the models that were flown."""
    return resolve(stored_campaign(store), store.models_dir, store.meta("identity")["models"])


def fly_again(campaign: ResolvedCampaign, store: Store, spec: RunSpec) -> Recorded:
    """Replay a run of a ledger in full, without fast-forward; raises the errors of `replay`."""
    setup = setup_of_run(campaign, store, spec)
    flights = campaign.host.mission({spec.arm: setup}, fast_forward=False)
    flown: Recorded | Exception
    if spec.fault is None:
        flown = flights.golden(spec.arm)
    else:
        _, flown = next(flights.injected([(spec.arm, spec.fault)]))
    if isinstance(flown, Exception):
        raise flown
    return flown


def setup_of_run(campaign: ResolvedCampaign, store: Store, spec: RunSpec) -> ArmSetup:
    """Arm setup of a run of a ledger; raises the errors of `replay`."""
    host = campaign.host
    if not host.deterministic:
        raise BadInputError(
            f"{store.directory}: host {host.name} is not deterministic: runs cannot be flown again; fault, values and "
            f"effect of each, as stored: mavfi runs {store.directory} --csv"
        )
    arms = {arm.name: arm for arm in campaign.arms}
    if spec.arm not in arms:
        raise BadInputError(f"{store.directory}: run {spec.run_id}: arm {not_known(spec.arm, arms)}")
    stored = store.meta("identity")["scenarios"][f"{spec.environment}/{spec.arm}"]
    scenario = None
    if host.flies:
        # as flown, with the content of the files that its mission named, e.g. of its protection plan
        scenario = parse(Scenario, {**stored, "seed": spec.seed}, str(store.directory), stored=True)
        if scenario.protection is not None:
            rewriter().check(scenario.protection, f"of {store.directory}")
    else:
        host.check_stored(stored)
    return setup_of(MissionPlan(campaign, *spec.world), arms[spec.arm], scenario)


@dataclass(frozen=True, slots=True)
class Explanation:
    """Replays of a run and of its golden run."""

    spec: RunSpec
    flight: Flight  # replay of the run
    golden: Flight  # replay of the golden run with the same detector
    same: bool  # the digest equals the stored one
    first: FirstDifference | None  # None = no difference
    departure: Departure
    spread: tuple[StateSpread, ...] = ()  # states that differed, in the order of their first difference
    published: Sequence[TimedState] = ()  # of the flight, in order
    golden_published: Sequence[TimedState] = ()

    @property
    def effect(self) -> Effect:
        """Effect of the fault on the flight."""
        return effect_of(record_of(self.golden.log), record_of(self.flight.log))


def explained_levels(host: Host) -> frozenset[str]:
    """Levels of a host's faults whose publications can be recorded: those that the host `local` flies, too."""
    if host.flies and host.deterministic:
        return host.levels & LocalHost().levels
    return frozenset()


def explain(directory: Path, run_id: str) -> Explanation:
    """Replay a run (given by a prefix of its id) and its golden run, and compare all publications.

    Raises:
        BadInputError: The campaign or run does not exist, the run has no fault or no flight, or its publications
            cannot be recorded.
        SpecMismatchError: The detector's model has changed since the run.
    """
    # Refuse runs without a fault or a flight.
    with Store.open(directory) as store:
        run = store.run(run_id)
        if run.spec.fault is None:
            raise BadInputError(
                f"{directory}: run {run.spec.run_id}: is a golden run; explain needs a run with a fault, "
                "mavfi replay flies this one"
            )
        stored = run.record
        if stored is None or not stored.flown:
            why = ""
            if stored is not None and reason_of(run.note):
                why = f" ({reason_of(run.note)})"
            raise BadInputError(f"{directory}: run {run.spec.run_id}: left no flight to explain{why}")
        setup = _setup_to_record(store, run.spec)

    # Fly both again, and record their publications.
    golden, golden_published = fly_recorded(setup, None)
    injected, published = fly_recorded(setup, run.spec.fault)
    return Explanation(
        spec=run.spec,
        flight=injected,
        golden=golden,
        same=injected.log.digest() == stored.digest,
        first=first_difference(golden_published, published),
        departure=departure(golden.log, injected.log),
        spread=tuple(spread(golden_published, published)),
        published=published,
        golden_published=golden_published,
    )


def recorded_again(directory: Path, run_id: str) -> tuple[Flight, list[TimedState], Flight | None]:
    """Replay a run, given by a prefix of its id, with its publications; also returns its golden run, if it has a fault.

    Raises:
        BadInputError, SpecMismatchError: See `replay`.
    """
    with Store.open(directory) as store:
        run = store.run(run_id)
        if run.record is None:
            raise BadInputError(f"{directory}: run {run.spec.run_id} is not flown yet")
        setup = _setup_to_record(store, run.spec)
    flight, published = fly_recorded(setup, run.spec.fault)
    if run.spec.fault is None:
        return flight, published, None
    golden, _ = fly_recorded(setup, None)
    return flight, published, golden


def _setup_to_record(store: Store, spec: RunSpec) -> ArmSetup:
    """Arm setup of a run whose publications can be recorded; raises the errors of `explain`."""
    campaign = resolve_stored(store)
    setup = setup_of_run(campaign, store, spec)
    levels = explained_levels(campaign.host)
    if not levels or (spec.fault is not None and spec.fault.level not in levels):
        raise BadInputError(
            f"{store.directory}: run {spec.run_id}: its publications cannot be recorded; allowed: faults of level "
            f"{', '.join(sorted(LocalHost().levels))} at hosts that fly missions; see mavfi replay and mavfi runs"
        )
    return setup


def fly_recorded(setup: ArmSetup, fault: Fault | None) -> tuple[Flight, list[TimedState]]:
    """Fly one mission on the deterministic host and record its publications, in order."""
    flight, published = mission_flights.fly_recorded(setup.scenario, fault, setup.detector(), setup.recovery)
    return flight, [TimedState(time_us, state) for state, time_us in published]


@dataclass(frozen=True, slots=True)
class Verification:
    """Outcome of a verification.

    Attributes:
        runs: Replayable runs of the ledger.
        flown: Size of the sample.
        differing: Runs whose replayed record differs from the stored one.
    """

    runs: int
    flown: int
    differing: tuple[str, ...]

    @property
    def upper_bound(self) -> float:
        """One-sided upper confidence bound on the share of wrong records (Clopper and Pearson 1934)."""
        from scipy.stats import beta  # in the extra `report`

        wrong = len(self.differing)
        equal = self.flown - wrong
        if equal:
            return float(beta.ppf(CONFIDENCE, wrong + 1, equal))
        return 1.0


def verify(
    directory: Path, share: float, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> Verification:
    """Replay a random sample of the runs, at least one, and compare every field of their records.

    Runs without a flight, and runs marked as not replayable, are excluded.

    Args:
        directory: Folder of the ledger.
        share: Sample size / replayable runs, in (0, 1].
        seed: Seed of the sample.
        progress: Called with the number of replayed runs and the sample size.

    Raises:
        BadInputError: The ledger is absent or has no replayable run, or the share is out of range.
    """
    if not 0.0 < share <= 1.0:
        raise BadInputError(f"--share: {share}: allowed: above 0, 1 at most")
    with Store.open(directory) as store:
        runs = []
        for run in store.runs(done=True):
            if run.record is not None and run.record.flown and _can_be_repeated(run.record):
                runs.append(run)
        if not runs:
            raise BadInputError(f"{directory}: holds no replayable run")
        number = max(1, round(share * len(runs)))
        campaign = resolve_stored(store)
        chosen = np.sort(np.random.default_rng(seed).choice(len(runs), number, replace=False))
        differing = []
        for done, index in enumerate(chosen):
            if progress is not None:
                progress(done, number)
            run = runs[index]
            if _record_again(campaign, store, run) != run.record:
                differing.append(run.spec.run_id)
    return Verification(len(runs), number, tuple(differing))


def _record_again(campaign: ResolvedCampaign, store: Store, run: Run) -> FlightRecord:
    """Record of the replayed run, with the counts of a golden run, used only for drawing faults, copied."""
    stored = run.record
    assert stored is not None
    now = FlightRecord.from_json(fly_again(campaign, store, run.spec).record().to_json())
    return replace(now, counts=stored.counts, acted_on=stored.acted_on)
