"""A stored run and its golden run, flown again side by side, with all that they published."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mavfi.campaign.divergence import Departure, Difference, Publication, departure, first_difference
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import fly_again, golden_run
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.flight_record import FlightRecord, record_of
from mavfi.outcomes import Effect, effect_of

if TYPE_CHECKING:
    from mavfi.hosts.host import Flight
    from mavfi.states import State


@dataclass(frozen=True, slots=True)
class Explanation:
    """A run and its golden run, both flown again.

    Attributes:
        spec: The run.
        flight: Its flight of now.
        golden: The golden run of now, with the same detector.
        same: Whether the digest is the stored one.
        first: First publication that differs; None = none does, or a fault in an instruction: its flight ends in a
            forked process, and the kernel effect in its log has the first difference.
        departure: How the paths part.
    """

    spec: RunSpec
    flight: "Flight"
    golden: "Flight"
    same: bool
    first: Difference | None
    departure: Departure

    @property
    def effect(self) -> Effect:
        """What the fault did to the flight."""
        return effect_of(record_of(self.golden.log), record_of(self.flight.log))


def explain(directory: Path, run_id: str) -> Explanation:
    """Fly a run and its golden run again, and compare all that was published.

    Args:
        directory: Where the ledger is.
        run_id: The run, or an unambiguous beginning of its id.

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
        golden, injected = Recorder(), Recorder()
        golden_flight = fly_again(store, golden_run(store, run.spec).spec, taps=(golden,))
        flight = fly_again(store, run.spec, taps=(injected,))
    recorded = golden.publications and injected.publications
    return Explanation(
        run.spec, flight, golden_flight, flight.log.digest() == stored.digest,
        first_difference(golden.publications, injected.publications) if recorded else None,
        departure(golden_flight.log, flight.log),
    )  # fmt: skip


class Recorder:
    """A tap that keeps a copy of all that is published."""

    def __init__(self) -> None:
        self.publications: list[Publication] = []

    def __call__(self, state: "State", time_us: int) -> None:
        """Keep a publication.

        Args:
            state: What consumers see.
            time_us: When (us).
        """
        self.publications.append(Publication(time_us, state.copy()))
