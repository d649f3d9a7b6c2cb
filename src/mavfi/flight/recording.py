"""Record of a flight in progress: rows, events, alarms, publications, and modelled compute times of kernels."""

from collections.abc import Iterable

import numpy as np

from mavfi.faults.levels.state_injector import ActedOn
from mavfi.record import AlarmRecord, Event, Profile
from mavfi.states import STAGE_KERNELS, State, StateSpec


class Publications:
    """Counts publications by state; with a profile, also records their times, from which faults are sampled."""

    def __init__(self, wanted: bool, states: Iterable[StateSpec]) -> None:
        self.wanted = wanted
        self._acted_on = {spec.name: ActedOn(spec) for spec in states}
        self.count = dict.fromkeys(self._acted_on, 0)
        self._times: dict[str, list[int]] = {name: [] for name in self._acted_on}
        self._sizes: dict[str, list[int]] = {name: [] for name in self._acted_on}

    def note(self, state: State, time_us: int) -> None:
        """Count a publication."""
        name = state.spec.name
        self.count[name] += 1
        if self.wanted and self._acted_on[name](state):
            self._times[name].append(time_us)
            self._sizes[name].append(len(state.elements))

    def profile(self) -> Profile | None:
        """The profile; None unless requested."""
        if not self.wanted:
            return None
        return Profile(
            {name: np.array(times, np.int64) for name, times in self._times.items()},
            {name: np.array(sizes, np.int32) for name, sizes in self._sizes.items()},
        )


class Record:
    """Record of one flight: rows, events, alarms with the outcomes known so far, and modelled times (us).

    `calls` counts the calls of compiled functions, by name, in flights that address faults by them; else it is empty.
    """

    def __init__(self, kernels: Iterable[str], publications: Publications) -> None:
        self.rows: list[np.ndarray] = []
        self.events: list[Event] = []
        self.alarms: list[AlarmRecord] = []
        self.compute_us = dict.fromkeys(kernels, 0)
        self.recompute_us = {stage.value: 0 for stage in STAGE_KERNELS}
        self.publications = publications
        self.calls: dict[str, int] = {}

    def write_row(self, now: int, odometry: np.ndarray, command: np.ndarray, reference: np.ndarray) -> None:
        """Append the row of a control period, see `flight_log.COLUMNS`: shapes (13,), (4,) and (3,)."""
        self.rows.append(np.concatenate(([1e-6 * now], odometry, command, reference)))

    def note(self, now: int, kind: str, data: dict[str, object]) -> None:
        """Append an event."""
        self.events.append(Event(now, kind, data))

    def published(self, state: State, now: int) -> None:
        """Count a publication and record the corresponding event, if any."""
        self.publications.note(state, now)
        name, header = state.spec.name, state.header
        if name == "planning.path":
            kind = "plan" if len(state.elements) else "plan_failed"
            self.note(now, kind, {"vertices": len(state.elements)})
        elif name == "planning.trajectory":
            self.note(now, "trajectory", {"seq": int(header["trajectory_seq"][0]), "points": len(state.elements)})
        elif name == "perception.collision_status" and bool(header["collision"][0]):
            self.note(now, "collision_predicted", {"time_to_collision": float(header["time_to_collision"][0])})

    def counts(self) -> tuple[int, ...]:
        """Calls of functions, modelled compute times of kernels, recompute times of stages, and publication counts."""
        tables = self.calls, self.compute_us, self.recompute_us, self.publications.count
        return tuple(number for table in tables for number in table.values())

    def set_counts(self, counts: Iterable[int]) -> None:
        """Inverse of `counts`; tables returned earlier are not modified."""
        rest = iter(counts)
        self.calls = {name: next(rest) for name in self.calls}
        self.compute_us = {name: next(rest) for name in self.compute_us}
        self.recompute_us = {name: next(rest) for name in self.recompute_us}
        self.publications.count = {name: next(rest) for name in self.publications.count}
