"""Search for the smallest fault that still loses a mission: delta debugging of one run (Zeller and Hildebrandt 2002).

The fault is reduced in steps; each tries candidates in order of size and keeps the first that loses the mission, since
failure is not monotone in the size of the change.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import resolve_stored, setup_of_run
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, find_level
from mavfi.flight.host import Flight, MissionFlights
from mavfi.mission import MissionStatus
from mavfi.record import Injection

_BATCH = 8
"""Candidates per batch: instruction faults share a flight up to their calls."""


@dataclass(frozen=True, slots=True)
class CandidateFlight:
    """A candidate fault and the result of its flight."""

    fault: Fault
    status: str  # label of the mission's status; "" = the flight could not be judged
    time_s: float  # end of the flight
    injection: Injection | None

    @property
    def lost(self) -> bool:
        """Whether the mission fails."""
        return self.status not in ("", MissionStatus.SUCCESS.label)


@dataclass(frozen=True, slots=True)
class ReductionStep:
    """One reduction step."""

    what: str  # "publications", "width", "bit"
    tried: int  # candidates evaluated
    smaller: CandidateFlight | None  # the smallest candidate that loses the mission; None = none does


@dataclass(frozen=True, slots=True)
class Shrunk:
    """Result of a search."""

    directory: Path  # of its ledger
    spec: RunSpec
    original: CandidateFlight
    smallest: CandidateFlight
    steps: tuple[ReductionStep, ...]
    golden: Flight


def shrink(directory: Path, run_id: str, report: Callable[[int], None] | None = None) -> Shrunk:
    """Reduce the fault of a run to the smallest one found that loses the mission.

    Args:
        directory: Folder of the ledger.
        run_id: Id of the run, or an unambiguous prefix of it.
        report: Called with the number of flights so far.

    Raises:
        BadInputError: The campaign or run does not exist; the run has no fault that can be reduced; or the mission
            succeeds with the fault or fails without it.
    """
    with Store.open(directory) as store:
        spec = store.run(run_id).spec
        campaign = resolve_stored(store)
        setup = setup_of_run(campaign, store, spec)
    # A fault that can be made smaller ...
    fault = spec.fault
    if fault is None or not find_level(fault.level).reductions:
        raise BadInputError(
            f"{directory}: run {spec.run_id}: no fault to make smaller; allowed: runs with a fault in a state, a "
            "memory or an instruction"
        )
    candidates = _CandidateFlights(campaign.host.mission({spec.arm: setup}), spec.arm, report or (lambda _: None))
    golden = candidates.flights.golden(spec.arm)
    assert isinstance(golden, Flight)  # as hosts of faults that can be smaller do
    original = next(candidates.fly([fault]))
    # ... and without which the mission succeeds.
    if golden.log.status is not MissionStatus.SUCCESS or not original.lost:
        reason = f"ends in {original.status or 'an error'}"
        if original.lost:
            reason = "fails without its fault, too"
        raise BadInputError(
            f"{directory}: run {spec.run_id}: {reason}; allowed: runs whose fault loses the mission (mavfi runs "
            f"{directory} --failed)"
        )
    # Each step starts from the smallest fault of the steps before.
    smallest = original
    steps = []
    for what, reduce in find_level(fault.level).reductions.items():
        faults = list(reduce(smallest.fault, smallest.injection))
        if not faults:
            continue
        smaller = next((candidate for candidate in candidates.fly(faults) if candidate.lost), None)
        steps.append(ReductionStep(what, candidates.count, smaller))
        if smaller is not None:
            smallest = smaller
    return Shrunk(directory, spec, original, smallest, tuple(steps), golden)


@dataclass(slots=True)
class _CandidateFlights:
    """Flies candidates of one mission and arm."""

    flights: MissionFlights
    arm: str
    report: Callable[[int], None]
    flown: int = 0  # flights so far, in all lists of candidates
    count: int = 0  # candidates of the last list that were yielded so far

    def fly(self, faults: Sequence[Fault]) -> Iterator[CandidateFlight]:
        """Fly candidates in order, batch by batch, until the caller stops iterating."""
        self.count = 0
        for first in range(0, len(faults), _BATCH):
            batch = faults[first : first + _BATCH]
            ends = dict(self.flights.injected([(self.arm, fault) for fault in batch]))
            self.flown += len(batch)
            self.report(self.flown)
            for index, fault in enumerate(batch):
                self.count += 1
                yield _judge(fault, ends[index])


def _judge(fault: Fault, end: object) -> CandidateFlight:
    """The result of a candidate; `end` is its flight, or the exception in its place."""
    if not isinstance(end, Flight):
        return CandidateFlight(fault, "", 0.0, None)
    injection = next(iter(end.log.injections), None)
    return CandidateFlight(fault, end.log.status.label, float(end.log.column("time")[-1]), injection)
