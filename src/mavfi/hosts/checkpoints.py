"""Everything that decides how a flight goes on: taken, put back, and compared, at the instant before a control tick."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from mavfi.hosts import memory
from mavfi.hosts.inprocess import Host
from mavfi.sim.simulator import Snapshot
from mavfi.states import Stage


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """State of vehicle, kernels and queue of a host at an instant; never changed, and shared by flights.

    Attributes:
        sim: The simulator's.
        memory: All the host's attributes but those of `Host.not_memory`.
    """

    sim: Snapshot
    memory: Any


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """An instant of a flight that it, or another one, can go on from.

    Attributes:
        moment: What can be compared with other flights, and gone back to; None = the end.
        rows: How many rows the record had.
        events: How many events.
        shown: How many publications.
        alarms: The alarms until then, with the outcomes that were known.
        counts: See `counts_of`.
        spent: Whether the tap in the injector's place leaves what comes untouched.
        injector: Its memory.
        detector: Memory of the detector.
    """

    moment: Moment | None
    rows: int
    events: int
    shown: int
    alarms: tuple[dict[str, Any], ...]
    counts: tuple[int, ...]
    spent: bool
    injector: Any
    detector: Any

    @property
    def here(self) -> Moment:
        """The moment, where this is not the end."""
        assert self.moment is not None  # nobody goes on from the end
        return self.moment


def take(host: Host) -> Moment:
    """The present moment of a host."""
    _settle(host)
    return Moment(host.sim.snapshot(), memory.save(host))


def put(host: Host, moment: Moment) -> None:
    """Put a host back to a moment that was taken of it; record and taps are left alone."""
    host.sim.restore(moment.sim)
    memory.restored(moment.memory)


def is_at(host: Host, moment: Moment) -> bool:
    """Whether a host is at a moment: all bits of all that decides how it goes on, taps left aside."""
    if host.sim.odometry.tobytes() != moment.sim.odometry.tobytes():
        return False
    _settle(host)
    return memory.same(host.sim.snapshot(), moment.sim) and memory.same(host, moment.memory)


def _settle(host: Host) -> None:
    """Make what does not decide anything the same in all flights.

    What waits is numbered from 0: only the order matters, not how much was waited for before.  Planning kernels that
    are not under way are marked: only what such a kernel publishes makes it go back, and its step marks it first.
    """
    waiting = sorted(host.queue, key=lambda entry: entry[:2])
    host.queue = [(time, place, action, given) for place, (time, _, action, given) in enumerate(waiting)]
    host.order = len(host.queue)
    for kernel in host.kernels.values():
        if kernel.stage is Stage.PLANNING and kernel.name not in host.busy:
            kernel.mark()


def counts_of(host: Host) -> tuple[int, ...]:
    """What a flight counts: modelled compute and recompute time of each kernel and stage, publications."""
    return (*host.compute_us.values(), *host.recompute_us.values(), *host.publications.count.values())


def set_counts(host: Host, counts: Iterable[int]) -> None:
    """Inverse of `counts_of`; what was handed out before does not change."""
    rest = iter(counts)
    host.compute_us = {name: next(rest) for name in host.compute_us}
    host.recompute_us = {name: next(rest) for name in host.recompute_us}
    host.publications.count = {name: next(rest) for name in host.publications.count}
