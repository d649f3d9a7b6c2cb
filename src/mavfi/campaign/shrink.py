"""The smallest fault that still loses a mission: delta debugging of one run (Zeller and Hildebrandt 2002).

A fault is made smaller in steps; each takes the smallest candidate with which the mission still fails, since failing is
not monotone in the size of a change.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import setup_of_run
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, InstructionFault, MemoryFault, StateFault
from mavfi.faults.strata import WORD_BITS
from mavfi.flight_log import Injection
from mavfi.hosts.host import Flight, MissionFlights
from mavfi.mission import MissionStatus
from mavfi.states import STATES

INSTANTS = 12
"""Instants of the same site that are tried."""
_SHORTER = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Numbers of wrong publications that are tried."""
_BATCH = 8
"""Candidates flown at once: instruction faults share a flight up to their calls."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A candidate, and what became of the mission."""

    fault: Fault
    status: str  # of the mission; "" = the flight could not be judged
    time_s: float  # at which it ended
    injection: Injection | None

    @property
    def lost(self) -> bool:
        """Whether the mission fails."""
        return self.status not in ("", MissionStatus.SUCCESS.label)


@dataclass(frozen=True, slots=True)
class Step:
    """One way in which the fault was made smaller."""

    what: str  # "publications", "width", "bit"
    tried: int  # candidates that were flown
    found: Trial | None  # the smallest that loses the mission; None = only the fault before


@dataclass(frozen=True, slots=True)
class Shrunk:
    """What is left of a fault."""

    directory: Path  # of its ledger
    spec: RunSpec
    original: Trial
    smallest: Trial
    steps: tuple[Step, ...]
    instants: tuple[Trial, ...]  # of the same site, with the smallest fault; in order of time
    golden: Flight


def shrink(
    directory: Path, run_id: str, *, instants: int = INSTANTS, report: Callable[[int], None] | None = None
) -> Shrunk:
    """Make the fault of a run smaller, as long as it loses the mission.

    Args:
        directory: Folder of the ledger.
        run_id: The run, or an unambiguous beginning of its id.
        instants: How many other instants of the site are tried in the end.
        report: Called with the number of flights so far.

    Raises:
        BadInputError: No such campaign or run; a run without a fault, or of a level that has no bits to choose from;
            a mission that succeeds with the fault, or fails without it.
    """
    with Store.open(directory) as store:
        spec = store.run(run_id).spec
        host, setup = setup_of_run(store, spec)
    fault = spec.fault
    if not isinstance(fault, (StateFault, MemoryFault, InstructionFault)):
        raise BadInputError(
            f"{directory}: run {spec.run_id}: no fault to make smaller; allowed: runs with a fault in a state, a "
            "memory or an instruction"
        )
    trials = _Trials(host.mission({spec.arm: setup}), spec.arm, report or (lambda _: None))
    golden = trials.flights.golden(spec.arm, profile=True)
    assert isinstance(golden, Flight)  # as every deterministic host gives it
    original = next(trials.of([fault]))
    if golden.log.status is not MissionStatus.SUCCESS or not original.lost:
        how = "fails without its fault, too" if original.lost else f"ends in {original.status or 'an error'}"
        raise BadInputError(
            f"{directory}: run {spec.run_id}: {how}; allowed: runs whose fault loses the mission (mavfi runs "
            f"{directory} --failed)"
        )
    smallest, steps = original, []
    for what, candidates in (("publications", _fewer), ("width", _narrower), ("bit", _lower)):
        smaller = list(candidates(smallest))
        if smaller:
            found = next((trial for trial in trials.of(smaller) if trial.lost), None)
            steps.append(Step(what, trials.count, found))
            smallest = found or smallest
    others = tuple(trials.of(_elsewhere(smallest.fault, golden, instants)))
    return Shrunk(directory, spec, original, smallest, tuple(steps), others, golden)


@dataclass(slots=True)
class _Trials:
    """Flies candidates of one mission and arm."""

    flights: MissionFlights
    arm: str
    report: Callable[[int], None]
    flown: int = 0
    count: int = 0  # of the last list, as far as it was asked for

    def of(self, faults: Sequence[Fault]) -> Iterator[Trial]:
        """Fly candidates in their order, as far as the caller wants."""
        self.count = 0
        for first in range(0, len(faults), _BATCH):
            batch = faults[first : first + _BATCH]
            ends = dict(self.flights.injected([(self.arm, fault) for fault in batch]))
            self.flown += len(batch)
            self.report(self.flown)
            for place, fault in enumerate(batch):
                self.count += 1
                yield _trial(fault, ends[place])


def _trial(fault: Fault, end: object) -> Trial:
    if not isinstance(end, Flight):
        return Trial(fault, "", 0.0, None)
    injection = next(iter(end.log.injections), None)
    return Trial(fault, end.log.status.label, float(end.log.column("time")[-1]), injection)


# ---- candidates, smallest first ----------------------------------------------------------------------------------
def _fewer(trial: Trial) -> Iterator[Fault]:
    """Of a fault that lasts: once, then in more and more publications, then for shorter times."""
    fault = trial.fault
    if not isinstance(fault, StateFault) or not fault.lasting:
        return
    once = replace(fault, lasts_s=0.0, share=1.0, times=1)
    yield from (replace(once, times=times) for times in _SHORTER if fault.lasts_s > 0 or times < fault.times)
    if 0 < fault.lasts_s < float("inf"):
        yield from (replace(fault, lasts_s=round(fault.lasts_s * part, 3)) for part in (0.125, 0.25, 0.5))


def _narrower(trial: Trial) -> Iterator[Fault]:
    """Of a fault in several bits: each of them alone."""
    fault = trial.fault
    if isinstance(fault, StateFault) and fault.bit is not None and fault.width > 1:
        yield from (replace(fault, bit=fault.bit + place, width=1) for place in range(fault.width))
    if isinstance(fault, InstructionFault) and len(fault.bits) > 1:
        yield from (replace(fault, bits=(bit,)) for bit in sorted(fault.bits))


def _lower(trial: Trial) -> Iterator[Fault]:
    """Other bits of the same word that change its value less; of instructions, lower ones."""
    fault = trial.fault
    if isinstance(fault, InstructionFault):
        yield from (replace(fault, bits=(bit,), stratum="") for bit in range(fault.bit or 0))
    elif isinstance(fault, (StateFault, MemoryFault)) and fault.bit is not None:
        dtype = fault.dtype if isinstance(fault, MemoryFault) else _dtype(fault)
        before = None if trial.injection is None else trial.injection.before
        sizes = {bit: change_of(before, dtype, bit) for bit in range(WORD_BITS[dtype])}
        smaller = [bit for bit, size in sizes.items() if size < sizes[fault.bit]]
        yield from (
            replace(fault, bit=bit, stratum="", weight=1.0) for bit in sorted(smaller, key=lambda bit: sizes[bit])
        )


def _dtype(fault: StateFault) -> str:
    return STATES[fault.where.state].find(fault.where.field).dtype


def change_of(before: object, dtype: str, bit: int) -> float:
    """By how much flipping a bit changes a value; infinite where that is no number, the bit if the value is unknown."""
    if not isinstance(before, (int, float)):
        return float(bit)
    size = np.dtype("u1" if dtype == "?" else dtype).itemsize
    word = np.array([before]).astype("u1" if dtype == "?" else dtype)
    flipped = (word.view(f"u{size}") ^ np.array(1 << bit, f"u{size}")).view(word.dtype)
    change = abs(float(flipped[0]) - float(word[0]))
    return change if np.isfinite(change) else float("inf")


def _elsewhere(fault: Fault, golden: Flight, count: int) -> list[Fault]:
    """The fault at evenly spaced instants of its site in the golden flight; none for instructions."""
    if isinstance(fault, StateFault) and golden.profile is not None:
        every = golden.profile.times_us.get(fault.where.state, np.zeros(0, np.int64))
    elif isinstance(fault, MemoryFault):
        every = np.round(1e6 * golden.log.column("time")).astype(np.int64)
    else:
        return []
    chosen = every[np.unique(np.linspace(0, len(every) - 1, min(count, len(every))).round().astype(int))]
    assert isinstance(fault, (StateFault, MemoryFault))
    return [replace(fault, time_us=int(time_us)) for time_us in chosen if time_us != fault.time_us]
