"""Several faults in one flight: each has the injector of its level; one that waits for an event gets it then."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import ref

from mavfi.detectors.detector import Detector
from mavfi.faults.combined import Start
from mavfi.faults.fault import NO_SITE, Fault, MemoryFault, StateFault, find_level
from mavfi.faults.injector import Injector
from mavfi.faults.levels.state_injector import CounterWatch, injector_of
from mavfi.flight.loop import Loop
from mavfi.flight.memory_faults import MemoryInjector
from mavfi.record import Injection, KernelEffect
from mavfi.states import State


@dataclass(slots=True)
class _ArmedFault:
    """One of the faults.

    Attributes:
        fault: The fault.
        start: What it waits for; None = nothing.
        injector: Its injector; None = it waits.
        waiting: The injector of a fault in a memory, which waits.
    """

    fault: Fault
    start: Start | None
    injector: Injector | None = None
    waiting: MemoryInjector | None = None

    @property
    def injections(self) -> list[Injection]:
        """Its injections so far."""
        return list(getattr(self.injector, "injections", ()))


class CombinedInjector(Injector):
    """Injector tap of a flight that has not started.

    Args:
        loop: The flight.
        faults: The faults, each with what it waits for; without those in instructions, see `flight.combined_forks`.
        detector: The detector of the flight.
    """

    def __init__(
        self, loop: Loop, faults: Sequence[tuple[Fault, Start | None]], detector: Detector | None = None
    ) -> None:
        self._loop_of = ref(loop)  # the loop owns this object
        self._detector = detector
        self._counters = CounterWatch()  # what a fault in a state needs to know that is armed late
        self._injected_elsewhere_us: list[int] = []
        self._members = [_ArmedFault(fault, start) for fault, start in faults]
        for member in self._members:
            if member.start is None:
                member.injector = _injector_of_level(loop, member.fault, detector)
            elif isinstance(member.fault, MemoryFault):  # its node may be restarted with messages from before the event
                member.waiting = MemoryInjector(loop, replace(member.fault, time_us=NO_SITE), detector)
            else:
                loop.watch_losses()
        loop.taps.injector = self

    @property
    def _loop(self) -> Loop:
        """The flight."""
        loop = self._loop_of()
        assert loop is not None  # it calls this object
        return loop

    # ---- the tap ----------------------------------------------------------------------------------------------------
    @property
    def spent(self) -> bool:  # type: ignore[override] # known at any time
        """See `Injector.spent`."""
        return all(member.injector is not None and member.injector.spent for member in self._members)

    def __call__(self, state: State, time_us: int) -> State | None:
        """See `Injector`: each fault receives what those before it leave."""
        for member in self._members:
            if member.injector is None:
                self._start_if_due(member, time_us)
        self._counters(state, time_us)
        seen: State | None = state
        for member in self._members:
            if seen is None:
                break
            if member.injector is not None:
                seen = member.injector(seen, time_us)
        return seen

    # ---- events -----------------------------------------------------------------------------------------------------
    def note_injection(self, time_us: int) -> None:
        """Note that another injector has injected a fault of this mission at an instant (us)."""
        self._injected_elsewhere_us.append(time_us)

    def _start_if_due(self, member: _ArmedFault, now: int) -> None:
        """Arm a fault if its event has happened; its instant is that of the event plus the delay."""
        start = member.start
        assert start is not None  # it waits for something
        event_us = self._event_us(start)
        if event_us is None:
            return
        time_us = max(now, event_us + round(1e6 * start.delay_s))
        loop = self._loop
        fault: Any = replace(member.fault, time_us=time_us)  # type: ignore[call-arg] # levels that can wait have it
        if member.waiting is not None:
            member.waiting.begin(time_us)
            member.injector = member.waiting
        elif isinstance(fault, StateFault) and fault.change is None:
            member.injector = injector_of(fault, self._counters)
        else:
            member.injector = _injector_of_level(loop, fault, self._detector)
            loop.taps.injector = self

    def _event_us(self, start: Start) -> int | None:
        """Instant of an event (us); None = it has not happened."""
        injected_us = [_microseconds(injection.time_s) for injection in self.injections if injection.activated]
        injected_us += self._injected_elsewhere_us
        if not injected_us:
            return None
        first_us = min(injected_us)
        if start.event == "injection":
            return first_us
        alarms_us = [_microseconds(alarm.time_s) for alarm in self._loop.record.alarms]
        return min((alarm_us for alarm_us in alarms_us if alarm_us >= first_us), default=None)

    # ---- results ----------------------------------------------------------------------------------------------------
    @property
    def injections(self) -> list[Injection]:
        """The injections so far, in the order of the faults."""
        return [injection for member in self._members for injection in member.injections]

    @property
    def effect(self) -> KernelEffect | None:  # type: ignore[override] # known at any time
        """See `Injector.effect`: that of the first fault after which a node crashed."""
        effects = [member.injector.effect for member in self._members if member.injector is not None]
        return next((effect for effect in effects if effect is not None), None)

    def finish(self) -> list[Injection]:
        """See `Injector.finish`; a fault whose event did not happen has an injection that is not activated."""
        injections: list[Injection] = []
        for member in self._members:
            if member.injector is not None:
                injections += member.injector.finish()
            else:
                fault = member.fault
                details = {"start": str(member.start)}
                injections.append(
                    Injection(fault.level, fault.site, 0.0, None, None, None, activated=False, details=details)
                )
        return injections

    def release(self) -> None:
        """See `Injector.release`: in reverse, as the last guard of a method encloses the others."""
        for member in reversed(self._members):
            if member.injector is not None:
                member.injector.release()


def _microseconds(time_s: float) -> int:
    """An instant (s) of a record, in us."""
    return round(1e6 * time_s)


def _injector_of_level(loop: Loop, fault: Fault, detector: Detector | None) -> Injector:
    """The injector of a fault, without the place in the loop that its level gives it."""
    loop.taps.injector = None
    inject: Callable[..., Injector] = find_level(fault.level).inject
    return inject(loop, fault, detector)
