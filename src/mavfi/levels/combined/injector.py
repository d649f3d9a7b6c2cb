"""Several faults in one flight: each has the injector of its level; one that waits for an event gets it then."""

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import ref

from mavfi.detectors.detector import Detector
from mavfi.faults.acted_on import CounterWatch
from mavfi.faults.combined import Start
from mavfi.faults.fault import Fault, find_level
from mavfi.faults.injector import Injector
from mavfi.flight.loop import Loop
from mavfi.levels.level import Begin
from mavfi.record import Injection, KernelEffect
from mavfi.states import State


@dataclass(slots=True)
class _ArmedFault:
    """One of the faults.

    Attributes:
        fault: The fault.
        start: What it waits for; None = nothing.
        injector: Its injector; None = it waits.
        begin: Injects it when its event has happened; None = it waits for nothing.
    """

    fault: Fault
    start: Start | None
    injector: Injector | None = None
    begin: Begin | None = None

    @property
    def injections(self) -> list[Injection]:
        """Its injections so far."""
        return list(getattr(self.injector, "injections", ()))


class CombinedInjector(Injector):
    """Injector tap of a flight that has not started.

    Args:
        loop: The flight.
        faults: The faults, each with what it waits for; without those in instructions, see `levels.combined.forks`.
        detector: The detector of the flight.
    """

    def __init__(
        self, loop: Loop, faults: Sequence[tuple[Fault, Start | None]], detector: Detector | None = None
    ) -> None:
        self._loop_of = ref(loop)  # the loop owns this object
        self._counters = CounterWatch()  # what a fault in a state needs to know that is armed late
        self._injected_elsewhere_us: list[int] = []
        self._members = [_ArmedFault(fault, start) for fault, start in faults]
        for member in self._members:
            level = find_level(member.fault.level)
            if member.start is None:
                loop.taps.injector = None
                member.injector = level.inject(loop, member.fault, detector)
            else:
                member.begin = level.wait(loop, member.fault, detector)
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
        assert member.start is not None and member.begin is not None  # it waits
        event_us = self._event_us(member.start)
        if event_us is None:
            return
        loop = self._loop
        loop.taps.injector = self._counters  # they have watched all publications so far
        member.injector = member.begin(loop, max(now, event_us + round(1e6 * member.start.delay_s)))
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
