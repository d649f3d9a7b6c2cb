"""Everything that decides how a flight goes on: taken, put back, and compared, at the instant before a control tick."""

from dataclasses import dataclass
from typing import Any

from mavfi.flight_log import AlarmRecord
from mavfi.hosts import memory
from mavfi.hosts.loop.scheduler import Loop
from mavfi.states import Stage


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """State of plant, kernels and queue of a loop at an instant; never changed, and shared by flights.

    Attributes:
        plant: Its snapshot.
        memory: All the loop's attributes but those of `Loop.not_memory`.
    """

    plant: Any
    memory: Any


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """An instant of a flight that it, or another one, can go on from.

    Attributes:
        instant: What can be compared with other flights, and gone back to; None = the end.
        rows: How many rows the record had.
        events: How many events.
        shown: How many publications.
        alarms: The alarms until then, with the outcomes that were known.
        counts: See `Record.counts`.
        spent: Whether the tap in the injector's place leaves what comes untouched.
        injector: Its memory.
        detector: Memory of the detector.
    """

    instant: Instant | None
    rows: int
    events: int
    shown: int
    alarms: tuple[AlarmRecord, ...]
    counts: tuple[int, ...]
    spent: bool
    injector: Any
    detector: Any

    @property
    def here(self) -> Instant:
        """The instant, where this is not the end."""
        assert self.instant is not None  # nobody goes on from the end
        return self.instant


def take(loop: Loop) -> Instant:
    """The present instant of a loop."""
    _settle(loop)
    return Instant(loop.plant.snapshot(), memory.save(loop))


def put(loop: Loop, instant: Instant) -> None:
    """Put a loop back to an instant that was taken of it; record and taps are left alone."""
    loop.plant.restore(instant.plant)
    memory.restored(instant.memory)


def is_at(loop: Loop, instant: Instant) -> bool:
    """Whether a loop is at an instant: all bits of all that decides how it goes on, taps left aside."""
    if loop.plant.odometry.tobytes() != instant.plant.odometry.tobytes():
        return False
    _settle(loop)
    return memory.same(loop.plant.snapshot(), instant.plant) and memory.same(loop, instant.memory)


def _settle(loop: Loop) -> None:
    """Make what does not decide anything the same in all flights.

    What waits is numbered from 0: only the order matters, not how much was waited for before.  Planning kernels that
    are not under way are marked: only what such a kernel publishes makes it go back, and its step marks it first.  One
    that is requested to go back keeps its mark.
    """
    waiting = sorted(loop.queue, key=lambda entry: entry[:2])
    loop.queue = [(time, place, action, given) for place, (time, _, action, given) in enumerate(waiting)]
    loop.order = len(loop.queue)
    for kernel in loop.kernels.values():
        if kernel.stage is Stage.PLANNING and kernel.name not in (*loop.busy, *loop.requests):
            kernel.mark()
