"""Flies stored runs again from their specs: one alone, or one and its golden run with all that they published."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mavfi.campaign.divergence import Departure, Difference, Publication, departure, first_difference
from mavfi.campaign.mission import MissionPlan, host_of, setup_of
from mavfi.campaign.plan import RunSpec, arms_of
from mavfi.campaign.run import stored_campaign
from mavfi.campaign.store import Run, Store
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, MemoryFault, StateFault
from mavfi.flight_record import record_of
from mavfi.hosts.host import ArmSetup, Flight, Host, Recorded
from mavfi.hosts.local import fly
from mavfi.outcomes import Effect, effect_of
from mavfi.states import State


@dataclass(frozen=True, slots=True)
class Replay:
    """A run that was flown again."""

    run: Run  # as stored
    flight: Flight  # of now
    digest: str  # of the new flight

    @property
    def same(self) -> bool:
        """Whether the flight is bit for bit the stored one."""
        return self.run.record is not None and self.run.record.digest == self.digest


def replay(directory: Path, run_id: str) -> Replay:
    """Fly a run again, named by an unambiguous beginning of its id.

    Raises:
        BadInputError: No such campaign or run, it is not flown yet, or its host cannot fly it again.
        SpecMismatchError: The detector's model is no longer the one that the run flew with.
    """
    with Store.open(directory) as store:
        run = store.run(run_id)
        if run.record is None:
            raise BadInputError(f"{directory}: run {run.spec.run_id} is not flown yet")
        flight = fly_again(store, run.spec)
        return Replay(run, flight, flight.log.digest())


def fly_again(store: Store, spec: RunSpec) -> Flight:
    """Fly any run of a ledger, for its whole log; errors as of `replay`."""
    host, setup = _setup_of_run(store, spec)
    flights = host.mission({spec.arm: setup}, fast_forward=False)
    flown: Recorded | Exception
    if spec.fault is None:
        flown = flights.golden(spec.arm)
    else:
        _, flown = next(flights.injected([(spec.arm, spec.fault)]))
    if isinstance(flown, Exception):
        raise flown
    assert isinstance(flown, Flight)  # as every deterministic host gives it
    return flown


def _setup_of_run(store: Store, spec: RunSpec) -> tuple[Host, ArmSetup]:
    """The host of a run, and the setup of the run's arm; errors as of `replay`."""
    campaign = stored_campaign(store)
    host = host_of(campaign)
    if not host.deterministic:
        raise BadInputError(f"{store.directory}: host {host.name} is not deterministic: runs cannot be flown again")
    arms = {arm.name: arm for arm in arms_of(campaign)}
    if spec.arm not in arms:
        raise BadInputError(f"{store.directory}: run {spec.run_id}: arm {spec.arm!r}: allowed: {', '.join(arms)}")
    mission = MissionPlan(campaign, *spec.world, store.models_dir, store.meta("identity")["models"])
    return host, setup_of(mission, arms[spec.arm], host)


@dataclass(frozen=True, slots=True)
class Explanation:
    """A run and its golden run, both flown again."""

    spec: RunSpec
    flight: Flight  # of the run, now
    golden: Flight  # of the golden run with the same detector, now
    same: bool  # the digest is the stored one
    first: Difference | None
    """None = there is none, or a fault in an instruction: its flight ends in a forked process, and the kernel effect in
    its log has the first difference."""
    departure: Departure
    published: Sequence[Publication] = ()  # by the flight, in order; none of a flight that ends in a forked process
    golden_published: Sequence[Publication] = ()

    @property
    def effect(self) -> Effect:
        """What the fault did to the flight."""
        return effect_of(record_of(self.golden.log), record_of(self.flight.log))


def explain(directory: Path, run_id: str) -> Explanation:
    """Fly a run (named by a beginning of its id) and its golden run again, and compare all that was published.

    Raises:
        BadInputError: No such campaign or run, a run without a fault, or one that left no flight.
        SpecMismatchError: The detector's model is no longer the one that the run flew with.
    """
    with Store.open(directory) as store:
        run = store.run(run_id)
        if run.spec.fault is None:
            raise BadInputError(f"{directory}: run {run.spec.run_id}: has no fault to explain; allowed: runs with one")
        stored = run.record
        if stored is None or not stored.flown:
            raise BadInputError(f"{directory}: run {run.spec.run_id}: left no flight to explain")
        golden, seen_golden = _recorded(store, replace(run.spec, fault=None))
        injected, seen = _recorded(store, run.spec)
    first = first_difference(seen_golden, seen) if seen else None
    same = injected.log.digest() == stored.digest
    parted = departure(golden.log, injected.log)
    return Explanation(run.spec, injected, golden, same, first, parted, seen, seen_golden)


def _recorded(store: Store, spec: RunSpec) -> tuple[Flight, list[Publication]]:
    """A run and its publications in order; none for a run that ends in a forked process."""
    return fly_recorded(_setup_of_run(store, spec)[1], spec.fault) or (fly_again(store, spec), [])


def fly_recorded(setup: ArmSetup, fault: Fault | None) -> tuple[Flight, list[Publication]] | None:
    """Fly one mission on the deterministic host, and record what is published, in order.

    Returns:
        None for a fault whose flight ends in a forked process.
    """
    if not isinstance(fault, StateFault | MemoryFault | None):
        return None
    seen: list[Publication] = []

    def note(state: State, time_us: int) -> None:
        seen.append(Publication(time_us, state.copy()))

    detector = None if setup.make_detector is None else setup.make_detector()
    flight = fly(setup.scenario, fault, detector, recovery=setup.recovery, recorders=(note,))
    return flight, seen
