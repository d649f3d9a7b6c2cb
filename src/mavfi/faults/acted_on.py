"""Which publications consumers act on, and a tap that watches them where no fault is injected."""

from copy import copy

from mavfi.record import Injection
from mavfi.states import STATES, State, StateSpec


class ActedOn:
    """Selects the publications of one state that consumers act on: the same rule for drawing and injecting.

    If `StateSpec.acted_on` names a counter, these are the publications in which it exceeds `last`, its value in the
    previous publication; otherwise all.
    """

    def __init__(self, spec: StateSpec) -> None:
        self._counter = spec.acted_on
        self.last = 0

    def __call__(self, state: State) -> bool:
        """Whether consumers act on this publication, given the previous calls."""
        if not self._counter:
            return True
        value = int(state.header[self._counter][0])
        grew = value > self.last
        self.last = value
        return grew


class CounterWatch:
    """A tap without effect, in place of the injector, that tracks the counters needed by a later injector.

    They are in `acted_on`, for the states of which consumers do not act on every publication.
    """

    spent = True

    def __init__(self) -> None:
        self.acted_on = {spec.name: ActedOn(spec) for spec in STATES.values() if spec.acted_on}

    def copy(self) -> "CounterWatch":
        """An independent copy with the same counters."""
        other = CounterWatch()
        other.acted_on = {name: copy(acted_on) for name, acted_on in self.acted_on.items()}
        return other

    def same(self, other: object) -> bool:
        """Whether both have the same latest counters."""
        return isinstance(other, CounterWatch) and all(
            acted_on.last == other.acted_on[name].last for name, acted_on in self.acted_on.items()
        )

    def __call__(self, state: State, time_us: int) -> State:
        """The publication itself."""
        del time_us
        acted_on = self.acted_on.get(state.spec.name)
        if acted_on is not None:
            acted_on(state)
        return state

    def finish(self) -> list[Injection]:
        """No injection."""
        return []
