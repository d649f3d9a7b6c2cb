"""Counts what is published in a flight, and notes when: what faults are drawn from."""

from dataclasses import InitVar, dataclass, field

import numpy as np

from mavfi.faults.state import ActedOn
from mavfi.flight_log import Profile
from mavfi.states import State, StateSpec


@dataclass(slots=True)
class Publications:
    """Counts what was published, and when, if a profile is wanted."""

    wanted: bool
    states: InitVar[dict[str, StateSpec]]
    count: dict[str, int] = field(init=False)
    times: dict[str, list[int]] = field(init=False)
    sizes: dict[str, list[int]] = field(init=False)
    acted_on: dict[str, ActedOn] = field(init=False)

    def __post_init__(self, states: dict[str, StateSpec]) -> None:
        self.count = dict.fromkeys(states, 0)
        self.times, self.sizes = {name: [] for name in states}, {name: [] for name in states}
        self.acted_on = {name: ActedOn(spec) for name, spec in states.items()}

    def note(self, state: State, time_us: int) -> None:
        """Count a publication."""
        name = state.spec.name
        self.count[name] += 1
        if not self.wanted:
            return
        if not self.acted_on[name](state):
            return
        self.times[name].append(time_us)
        self.sizes[name].append(len(state.elements))

    def profile(self) -> Profile | None:
        """What faults are drawn from, if it is wanted."""
        if not self.wanted:
            return None
        return Profile(
            {name: np.array(times, np.int64) for name, times in self.times.items()},
            {name: np.array(sizes, np.int32) for name, sizes in self.sizes.items()},
        )
