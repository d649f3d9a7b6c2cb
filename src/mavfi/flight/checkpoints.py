"""Checkpoints: complete state of a flight just before a control period; saved, restored and compared."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, cast

from mavfi.detectors.detector import Detector
from mavfi.faults.acted_on import CounterWatch
from mavfi.faults.injector import RewindableInjector
from mavfi.flight.loop import Loop
from mavfi.flight.state import FlightState
from mavfi.pipeline.memory import OpaqueKeeper, Remembers, Saved, Scratch
from mavfi.record import AlarmRecord
from mavfi.states import Stage


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """State of plant, loop and kernels at an instant; never modified, shared by flights.

    `scratch` has what determines the contents of the kernels' work arrays, by kernel; None = it was not saved.
    """

    plant: Any
    flight: FlightState
    kernels: dict[str, Saved]
    scratch: dict[str, tuple[Any, ...]] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """An instant of a flight (None = its end) from which this or another flight can continue.

    It holds the numbers of rows, events and publications, the alarms with their outcomes so far, counts (see
    `LoopRecord.counts`), a copy of the injector tap, and the memory of detector and recovery.
    """

    instant: Instant | None
    rows: int
    events: int
    publications: int
    alarms: tuple[AlarmRecord, ...]
    counts: tuple[int, ...]
    injector: CounterWatch | RewindableInjector
    detector: Any

    @property
    def here(self) -> Instant:
        """The instant; requires that this is not the end of the flight."""
        assert self.instant is not None  # precondition
        return self.instant


def can_save_detector(detector: Detector | None) -> bool:
    """Whether checkpoints can contain a detector: not if it has attributes that cannot be copied."""
    if detector is None:
        return True
    detector.start()
    return _succeeds(detector.memory)


def can_save_kernels(loop: Loop) -> bool:
    """Whether checkpoints can contain all kernels: a user's own planner and map are copied whole."""
    keepers = [keeper for kernel in _kernels(loop).values() for keeper in kernel.keepers]
    return all(_succeeds(keeper.save) for keeper in keepers if isinstance(keeper, OpaqueKeeper))


def _succeeds(save: Callable[[], object]) -> bool:
    """Whether an object can be saved."""
    try:
        save()
    except Exception:  # noqa: BLE001 - any exception of a user's object
        return False
    return True


def take(loop: Loop, *, scratch: bool = False) -> Instant:
    """The current instant of a loop; `scratch`: with the work arrays of all kernels, which must be known."""
    _normalize(loop)
    kernels = {name: kernel.save() for name, kernel in _kernels(loop).items()}
    saved_arrays = None
    if scratch:
        saved_arrays = {name: tuple(array.save() for array in arrays) for name, arrays in _scratch(loop).items()}
    return Instant(loop.plant.snapshot(), loop.state.copy(), kernels, saved_arrays)


def put(loop: Loop, instant: Instant) -> None:
    """Restore a loop to one of its own instants; record and taps are unchanged."""
    loop.plant.restore(instant.plant)
    loop.state = instant.flight.copy()  # which remains valid for further flights
    for name, kernel in _kernels(loop).items():
        kernel.restore(instant.kernels[name])
    for name, saved in (instant.scratch or {}).items():
        for array, content in zip(_scratch(loop)[name], saved, strict=True):
            array.restore(content)


def has_scratch(loop: Loop) -> bool:
    """Whether the work arrays of all kernels can be saved."""
    return all(kernel.scratch is not None for kernel in _kernels(loop).values())


def fill(loop: Loop, kernels: Collection[str]) -> None:
    """After `put`: write the contents of the work arrays of some kernels, as well: those that faults will be in."""
    scratch = _scratch(loop)
    for name in kernels:
        for array in scratch.get(name, ()):
            array.fill()


def is_at(loop: Loop, instant: Instant) -> bool:
    """Whether a loop is bit-identical to an instant; taps are not compared."""
    if not loop.plant.is_at(instant.plant):
        return False
    _normalize(loop)
    return loop.state.same(instant.flight) and all(
        kernel.same(instant.kernels[name]) for name, kernel in _kernels(loop).items()
    )


def _kernels(loop: Loop) -> dict[str, Remembers]:
    return cast(dict[str, Remembers], loop.kernels)  # true of all in-process kernels


def _scratch(loop: Loop) -> dict[str, tuple[Scratch, ...]]:
    return {name: kernel.scratch or () for name, kernel in _kernels(loop).items()}


def _normalize(loop: Loop) -> None:
    """Bring what has no effect on the flight into one form, so that equivalent states compare equal.

    Idle planning kernels are marked: they are rolled back only on one of their own publications, whose step marks them
    first.  A kernel with a pending recomputation request keeps its mark.
    """
    loop.state.normalize()
    for kernel in loop.kernels.values():
        if kernel.stage is Stage.PLANNING and kernel.name not in (*loop.state.busy, *loop.state.requests):
            kernel.mark()
