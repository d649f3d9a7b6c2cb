"""The complete state of a flight at the instant before a control tick: saved, restored and compared."""

from dataclasses import dataclass
from typing import Any, cast

from mavfi.detectors.detector import Detector
from mavfi.faults.state import CounterWatch, StateInjector
from mavfi.flight_log import AlarmRecord
from mavfi.hosts.loop.scheduler import Loop, LoopMemory
from mavfi.pipeline.memory import Foreign, Remembers, Saved
from mavfi.states import Stage


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """State of plant, loop and kernels at an instant; never changed, and shared by flights."""

    plant: Any
    loop: LoopMemory
    kernels: dict[str, Saved]


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """An instant of a flight (None = its end) from which it, or another one, can continue.

    It has numbers of rows, events and publications (`shown`), alarms with the outcomes known then, counts (see
    `Record.counts`), a copy of the first tap, and the memory of the detector (see `Watched`).
    """

    instant: Instant | None
    rows: int
    events: int
    shown: int
    alarms: tuple[AlarmRecord, ...]
    counts: tuple[int, ...]
    injector: CounterWatch | StateInjector
    detector: Any

    @property
    def here(self) -> Instant:
        """The instant, where this is not the end."""
        assert self.instant is not None  # nothing continues from the end
        return self.instant


class Watched:
    """A detector (`content`) with explicit memory: `memory()` and `restore()`."""

    def __init__(self, detector: Any) -> None:  # noqa: ANN401
        self.content = detector

    def save(self) -> Any:  # noqa: ANN401
        """Its memory."""
        return self.content.memory()

    def restore(self, saved: Any) -> None:  # noqa: ANN401
        """Inverse of `save`."""
        self.content.restore(saved)

    def same(self, saved: Any) -> bool:  # noqa: ANN401
        """Whether `save` would give the same."""
        return bool(self.content.memory() == saved)


def keeper_of(detector: Detector | None) -> Watched | Foreign[Any]:
    """Saves the memory of a detector; one without such methods is copied whole."""
    explicit = all(callable(getattr(detector, name, None)) for name in ("memory", "restore"))
    return Watched(detector) if explicit else Foreign(detector)


def take(loop: Loop) -> Instant:
    """The present instant of a loop."""
    _settle(loop)
    kernels = {name: kernel.save() for name, kernel in _kernels(loop).items()}
    return Instant(loop.plant.snapshot(), loop.memory().copy(), kernels)


def put(loop: Loop, instant: Instant) -> None:
    """Put a loop back to an instant that was taken of it; record and taps stay."""
    loop.plant.restore(instant.plant)
    loop.restore(instant.loop)
    for name, kernel in _kernels(loop).items():
        kernel.restore(instant.kernels[name])


def is_at(loop: Loop, instant: Instant) -> bool:
    """Whether a loop is at an instant, bit for bit; taps are not compared."""
    if not loop.plant.is_at(instant.plant):
        return False
    _settle(loop)
    return loop.memory().same(instant.loop) and all(
        kernel.same(instant.kernels[name]) for name, kernel in _kernels(loop).items()
    )


def _kernels(loop: Loop) -> dict[str, Remembers]:
    return cast(dict[str, Remembers], loop.kernels)  # those of this process are


def _settle(loop: Loop) -> None:
    """Normalize what decides nothing, so that it is the same in all flights.

    Queue entries are numbered from 0: only their order matters.  Planning kernels that are not under way are marked:
    only a publication of such a kernel makes it go back, and its step marks it first; one requested to go back keeps
    its mark.
    """
    waiting = sorted(loop.queue, key=lambda entry: entry[:2])
    loop.queue = [(time, place, action, given) for place, (time, _, action, given) in enumerate(waiting)]
    loop.order = len(loop.queue)
    for kernel in loop.kernels.values():
        if kernel.stage is Stage.PLANNING and kernel.name not in (*loop.busy, *loop.requests):
            kernel.mark()
