"""Injected runs of a mission that has crashed a worker, each in a child process."""

import pickle
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial

from mavfi.campaign.plan import Flown, RunSpec
from mavfi.detectors.bounded import LONGEST_S
from mavfi.errors import MachineError
from mavfi.flight_record import End, FlightRecord
from mavfi.hosts.isolated import run_again
from mavfi.ir.forked import WALL_CLOCK

ATTEMPTS_ALONE = 3
"""Attempts in separate child processes before an injected run that crashes its process counts as `due`."""
LONGEST_ALONE = 180.0
"""Wall-time limit of such a child (s); the attempts of a run sum to less than the time-out of executors."""


def fly_alone(
    specs: Sequence[RunSpec], fly: Callable[[RunSpec], Flown], fly_golden: Callable[[str], None],
    isolated: Collection[str],
) -> Iterator[Flown]:  # fmt: skip
    """Runs, each in a separate child process: `due` if every attempt dies, `unknown` if one exceeds the time limit.

    A process that dies without its fault, too, dies of the machine: before a `due`, `fly_golden` flies the golden run
    of the arm in a child.  The limit is longer for `isolated` arms, whose detectors may not return.

    Raises:
        MachineError: A child was killed from outside, or the golden run died, too.
    """
    for spec in specs:
        late, limit = False, LONGEST_ALONE + (LONGEST_S if spec.arm in isolated else 0.0)
        for _ in range(ATTEMPTS_ALONE):
            ended = run_again(partial(_pickled, spec, fly), limit)
            if ended.how == "done":
                yield _unpickled(ended.payload)
                break
            late |= ended.detail == WALL_CLOCK
        else:
            if not late:
                _check_machine(spec, fly_golden, limit)
            end, error = (End.UNKNOWN, "took too long") if late else (End.DUE, "the process died each time")
            yield Flown.of(spec.run_id, FlightRecord(end, error=error), f"{ended.how} {ended.detail}".strip())


def _check_machine(spec: RunSpec, fly_golden: Callable[[str], None], limit: float) -> None:
    def fly() -> bytes:
        fly_golden(spec.arm)
        return b""

    ended = run_again(fly, limit)
    if ended.how != "done":
        raise MachineError(f"{spec.run_id}: the process died, and that of its golden run, too ({ended.detail})")


def _pickled(spec: RunSpec, fly: Callable[[RunSpec], Flown]) -> bytes:
    try:
        return pickle.dumps(fly(spec))
    except MachineError as error:
        return pickle.dumps(error)


def _unpickled(payload: bytes) -> Flown:
    flown: Flown | MachineError = pickle.loads(payload)
    if isinstance(flown, MachineError):
        raise flown
    return flown
