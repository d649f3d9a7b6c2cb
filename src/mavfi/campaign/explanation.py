"""A stored run and its golden run, flown again side by side, with all that they published."""

from dataclasses import dataclass, replace
from pathlib import Path

from mavfi.campaign.divergence import Departure, Difference, Publication, departure, first_difference
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import fly_again, setup_again
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.flight_record import FlightRecord, record_of
from mavfi.hosts.host import Flight
from mavfi.hosts.local import fly
from mavfi.outcomes import Effect, effect_of
from mavfi.states import State


@dataclass(frozen=True, slots=True)
class Explanation:
    """A run and its golden run, both flown again.

    Attributes:
        flight: The new flight of the run.
        golden: The new flight of the golden run, with the same detector.
        same: Whether the digest is the stored one.
        first: First publication that differs; None = none does, or a fault in an instruction: its flight ends in a
            forked process, and the kernel effect in its log has the first difference.
    """

    spec: RunSpec
    flight: Flight
    golden: Flight
    same: bool
    first: Difference | None
    departure: Departure

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
        stored: FlightRecord | None = run.record
        if stored is None or not stored.flown:
            raise BadInputError(f"{directory}: run {run.spec.run_id}: left no flight to explain")
        golden, seen_golden = _recorded(store, replace(run.spec, fault=None))
        injected, seen = _recorded(store, run.spec)
    first = first_difference(seen_golden, seen) if seen else None
    same = injected.log.digest() == stored.digest
    return Explanation(run.spec, injected, golden, same, first, departure(golden.log, injected.log))


def _recorded(store: Store, spec: RunSpec) -> tuple[Flight, list[Publication]]:
    """A run and its publications in order; none for a run that ends in a forked process."""
    seen: list[Publication] = []
    if spec.fault is not None and spec.fault.level != "state":
        return fly_again(store, spec), seen
    _, setup = setup_again(store, spec)
    detector = None if setup.make_detector is None else setup.make_detector()

    def note(state: State, time_us: int) -> None:
        seen.append(Publication(time_us, state.copy()))

    flight = fly(setup.scenario, spec.fault, detector, coupling=setup.coupling, recorders=(note,))
    return flight, seen
