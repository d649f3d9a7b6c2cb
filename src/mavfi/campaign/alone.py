"""Runs of a mission that has crashed a worker, or exceeded its time limit: each is flown in a child process."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from mavfi.campaign.plan import CompletedRun, RunSpec
from mavfi.detectors.detector import CustomCallError, split_noting_calls
from mavfi.errors import MachineError
from mavfi.ir.forked import WALL_CLOCK, ChildEnd, ForkPoint
from mavfi.record import End, FlightRecord

ATTEMPTS_ALONE = 3
"""Attempts in separate child processes before an injected run that crashes its process counts as `due`."""
LONGEST_ALONE = 180.0
"""Wall-time limit of such a child (s); the attempts of a run sum to less than the time-out of executors."""


def fly_alone(
    specs: Sequence[RunSpec], fly: Callable[[RunSpec], CompletedRun], fly_golden: Callable[[str], None]
) -> Iterator[CompletedRun]:
    """Runs, each in a separate child process: `due` if every attempt dies, `unknown` if one exceeds the time limit.

    A process that dies without its fault, too, dies of the machine: before a `due`, `fly_golden` flies the golden run
    of the arm in a child.  A run in which a call of a custom detector does not return, or ends the process, is
    `unknown` at once, and its note names class and call.

    Raises:
        MachineError: A child was killed from outside, or the golden run died, too.
    """
    for spec in specs:
        try:
            yield _fly_one(spec, fly, fly_golden)
        except CustomCallError as error:
            yield CompletedRun.of(spec.run_id, FlightRecord(End.UNKNOWN, error=type(error).__name__), str(error))


def _fly_one(spec: RunSpec, fly: Callable[[RunSpec], CompletedRun], fly_golden: Callable[[str], None]) -> CompletedRun:
    """A run, after several attempts if necessary; raises a `CustomCallError` if one ends in a custom detector."""
    is_late = False
    for _ in range(ATTEMPTS_ALONE):
        ended = _run_in_child(partial(_pickled, spec, fly))
        if ended.how == "done":
            flown: CompletedRun | MachineError = pickle.loads(ended.payload)
            if isinstance(flown, MachineError):
                raise flown
            return flown
        is_late = is_late or ended.detail == WALL_CLOCK
    note = f"{ended.how} {ended.detail}".strip()
    if is_late:
        return CompletedRun.of(spec.run_id, FlightRecord(End.UNKNOWN, error="took too long"), note)

    # If the golden run dies, too, the machine is at fault, not the run.
    def golden() -> bytes:
        fly_golden(spec.arm)
        return b""

    ended = _run_in_child(golden)
    if ended.how != "done":
        raise MachineError(f"{spec.run_id}: the process died, and that of its golden run, too ({ended.detail})")
    return CompletedRun.of(spec.run_id, FlightRecord(End.DUE, error="the process died each time"), note)


def _run_in_child(work: Callable[[], bytes]) -> ChildEnd:
    """Run `work`, which returns the report, in a forked child with the wall-time limit."""
    point = ForkPoint()
    with point.guard():
        ended = split_noting_calls(point, LONGEST_ALONE)
        if ended is None:
            point.finish(work())
    return ended


def _pickled(spec: RunSpec, fly: Callable[[RunSpec], CompletedRun]) -> bytes:
    """The result of a run, or the failure of the machine, for the parent process."""
    try:
        return pickle.dumps(fly(spec))
    except MachineError as error:
        return pickle.dumps(error)
