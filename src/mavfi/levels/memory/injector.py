"""Injection of faults into persistent memory, as the first action of the loop at the fault's instant.

A fault that lasts changes the word again before the steps of every control period, also in a node that has restarted.
Targets are kernels and, in flights with a detector, the detector.  A kernel or detector that subsequently
raises an exception terminates its node, under the mission's policy for dead nodes.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast
from weakref import proxy

import numpy as np

from mavfi.detectors.detector import Detector, custom_parts, part_of
from mavfi.errors import BadInputError, machine_failure
from mavfi.faults.changes import MessageSchedule, ValueChange, When
from mavfi.faults.fault import RESTART_S
from mavfi.faults.injector import Injector
from mavfi.faults.operations import Operation
from mavfi.flight.loop import CONTROL_PERIOD_US, Loop
from mavfi.flight.restarts import Restarts
from mavfi.levels.memory.fault import MemoryFault
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.pipeline.memory import Memory, OpaqueKeeper, Remembers
from mavfi.pipeline.words import change, words_of
from mavfi.record import Injection, KernelEffect
from mavfi.states import PLUG_INS, REPLACEABLE, WATCHING

if TYPE_CHECKING:
    from mavfi.sim.simulator import Simulator

_RESTART_US = round(1e6 * RESTART_S)
_ANSWERS: dict[str, Callable[[], Any]] = {
    "receive": bool,
    "step": list,
    "rollback": lambda: None,
    "again": lambda: None,
    "stop": list,
    "abandon": list,
}
"""Return value of each method of a kernel that has crashed."""
_CHECKS: dict[str, Callable[[], Any]] = {"check": lambda: None, "accept": lambda: None}
"""Return value of each method of a detector that has crashed."""
_THRUSTS: dict[str, Callable[[], Any]] = {"rotors": lambda: np.zeros(4)}
"""Return value of each method of a flight controller that has crashed."""


class ArrayMemory(Remembers):
    """The memory of a detector or plug-in, as that of a kernel: all of it is in arrays."""

    def __init__(self, *holders: Any) -> None:  # noqa: ANN401 - each with a method `arrays`
        self.memory = Memory()
        self.keepers = holders


def memory_of(loop: Loop, target: str, detector: Detector | None = None, role: str = "") -> Remembers | None:
    """What holds the memory of a target at this instant; None = the mission has no such target, or its node is dead.

    Args:
        loop: The flight.
        target: A kernel, one of `states.WATCHING`, or the name of a plug-in.
        detector: The detector of the flight.
        role: Kind of the plug-in, as in `states.PLUG_INS`; "" = it is none.
    """
    if role:
        return _memory_of_plug_in(loop, role, detector)
    if target not in WATCHING:
        if target in loop.state.down:
            return None
        return cast("Remembers | None", loop.kernels.get(target))
    if loop.taps.detector is None:
        return None  # the detector is down
    part = part_of(detector, target)
    if part is None:
        return None
    return ArrayMemory(part)


def _memory_of_plug_in(loop: Loop, role: str, detector: Detector | None) -> Remembers | None:
    """The arrays that a plug-in declares, see `memory_of`."""
    if role == "detector":
        if loop.taps.detector is None:
            return None  # it is down
        return ArrayMemory(*map(OpaqueKeeper, custom_parts(detector)))
    if role == "flight_controller":
        return ArrayMemory(OpaqueKeeper(cast("Simulator", loop.plant).controller))
    kernel = PLUG_INS[role].kernel
    if kernel in loop.state.down:
        return None
    holder = cast(Remembers, loop.kernels[kernel])
    if role in REPLACEABLE:
        return holder  # the kernel itself
    return ArrayMemory(*(keeper for keeper in holder.keepers if not isinstance(keeper, ClearanceMap)))


class MemoryInjector(Injector):
    """Injector tap of a flight that has not started; publications pass unchanged.

    Args:
        loop: The flight.
        fault: The fault.
        detector: The detector of the flight.
    """

    def __init__(self, loop: Loop, fault: MemoryFault, detector: Detector | None = None) -> None:
        self._loop = proxy(loop)  # the loop owns this object
        self._fault = fault
        self._detector = detector
        self._restarts = Restarts(loop, loop.scenario.dead_node)
        self._injection: Injection | None = None
        if fault.change is None:
            self._value = ValueChange(Operation("flip", bit=fault.bit), is_stuck=True)
        else:
            self._value = ValueChange(replace(fault.change.operation, bit=fault.bit))
        self._schedule = MessageSchedule(When())
        self._guarded_parts: list[Any] = []
        if fault.has_site:
            self.begin(fault.time_us)

    def begin(self, time_us: int) -> None:
        """Inject from an instant on (us), which is not over; a lasting fault in each control period."""
        fault = self._fault
        instants: Sequence[int] = (time_us,)
        latest_us = self._loop.judge.limit_us
        if 0.0 < fault.lasts_s < float("inf"):
            latest_us = min(latest_us, time_us + round(1e6 * fault.lasts_s))
        if fault.is_lasting:
            instants = range(time_us, latest_us + 1, CONTROL_PERIOD_US)
        when = When(times=0)
        if fault.change is not None:
            when = fault.change.when
        self._schedule = MessageSchedule(when.starting_at(time_us), fault.seed)
        for instant in instants:
            self._loop.call_at(instant, self._inject)

    def _inject(self, now: int) -> None:
        """Change the word, if it exists, and guard the kernel or detector from now on."""
        fault = self._fault
        loop = self._loop
        if not self._schedule.due(now / 1e6, lambda _: float("nan")):
            return
        holder = memory_of(loop, fault.kernel, self._detector, fault.role)
        if holder is None:
            self._schedule.take_back()
            return  # the memory does not exist at this instant
        types = {words.dtype for words in words_of(holder) if words.name == fault.field}
        if types - {fault.dtype}:
            raise BadInputError(f"fault in {fault.site}: dtype {fault.dtype!r}; allowed: {', '.join(sorted(types))}")
        values = change(holder, fault.field, fault.index or 0, self._value)
        if values is None:
            self._schedule.take_back()
            return
        if self._injection is None:
            details = {}
            if fault.change is not None:
                details["operation"] = str(replace(fault.change.operation, bit=fault.bit))
            self._injection = Injection(
                fault.level, fault.site, now / 1e6, fault.bit, *values, activated=True, details=details
            )
        self._guard()

    def _guard(self) -> None:
        """Make exceptions of a kernel or detector terminate its node instead of the flight."""
        fault = self._fault
        parts: list[Any]
        if fault.in_detector:
            parts = self._parts_of_detector()
            answers = _CHECKS
        elif fault.role == "flight_controller":
            parts = [cast("Simulator", self._loop.plant).controller]
            answers = _THRUSTS
        else:
            parts = [self._loop.kernels[self._kernel]]
            answers = _ANSWERS
        if parts == self._guarded_parts:
            return
        self._guarded_parts = parts  # a restarted node has others
        for part in parts:
            for name, answer in answers.items():
                if hasattr(part, name):
                    setattr(part, name, self._guarded(getattr(part, name), answer))

    @property
    def _kernel(self) -> str:
        """The kernel of the pipeline whose memory it is, or whose plug-in's."""
        if self._fault.role:
            return PLUG_INS[self._fault.role].kernel
        return self._fault.kernel

    def _parts_of_detector(self) -> list[Any]:
        """The detectors whose memory it is."""
        if self._fault.role:
            return custom_parts(self._detector)
        return [part_of(self._detector, self._fault.kernel)]

    def _guarded(self, method: Callable[..., Any], answer: Callable[[], Any]) -> Callable[..., Any]:
        """A method whose exceptions terminate the node; it then answers with a neutral value."""

        def call(*arguments: Any) -> Any:
            try:
                return method(*arguments)
            except Exception as error:  # any exception type: the memory is corrupted
                if machine_failure(error):
                    raise
                if memory_of(self._loop, self._fault.kernel, self._detector, self._fault.role) is not None:
                    self.effect = KernelEffect("exception", f"{type(error).__name__}: {error}", None)
                    self._die()
                return answer()

        return call

    def _die(self) -> None:
        """Terminate the node of the kernel, the detector, or the flight controller."""
        fault = self._fault
        now = self._loop.now
        if self._detector is not None and fault.in_detector:
            self._restarts.detector_dies(self._detector, now, _RESTART_US)
        elif fault.role == "flight_controller":
            self._restarts.controller_dies(now, _RESTART_US)
        else:
            self._restarts.die(self._kernel, now, _RESTART_US)

    def release(self) -> None:
        """Remove the guard of a detector, which outlives the flight."""
        if not self._fault.in_detector:
            return
        for part in self._parts_of_detector():
            if part is not None:
                for name in _CHECKS:
                    vars(part).pop(name, None)

    @property
    def injections(self) -> list[Injection]:
        """The injection so far."""
        if self._injection is None:
            return []
        return [self._injection]

    def finish(self) -> list[Injection]:
        """The injection; if the word did not exist, a record of the missed activation."""
        fault = self._fault
        if self._injection is not None:
            if fault.is_lasting:
                details = {**self._injection.details, "periods": self._schedule.changed}
                return [replace(self._injection, details=details)]
            return [self._injection]
        return [Injection(fault.level, fault.site, fault.start_s, fault.bit, None, None, activated=False)]
