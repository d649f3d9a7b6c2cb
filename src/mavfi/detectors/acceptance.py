"""Acceptance test: what physics and protocol allow of every consumed field.  Nothing is trained.

Clouds and map updates have no rules: no mission depends on one of their values, since neighbours and the next scan
repair them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors import following, rules
from mavfi.detectors.detector import Alarm
from mavfi.detectors.gate import IMPLAUSIBLE
from mavfi.detectors.limits import MissionLimits
from mavfi.states import ODOMETRY, State, floats, new_state

SOURCE = "acceptance"
_WAYPOINT_FLOATS, _VEHICLE_FLOATS = 11, 6
_KEPT = 3
"""Trajectories that a way-point may name: the one in force, the one that waits, and one to spare."""
_COUNTERS = 4
_SHARE_OF_LATENCY = 0.7
"""Of the planner's latency: it has begun before that."""
_JITTER_US = 300_000
"""How much longer it can have taken."""
_NO_POINTS = np.zeros((0, rules.POINT_WIDTH))
_STATUS, _PATH, _TRAJECTORY = "perception.collision_status", "planning.path", "planning.trajectory"
_WAYPOINT, _COMMAND, _TRACKING = "planning.waypoint", "control.command", "control.tracking"


class Published:
    """What was published last, as far as rules need it; it is replaced, never changed.

    Attributes:
        limits: Of the mission, see `MissionLimits.numbers`.
        headers: Header published last, by state; zeros before the first.
        vehicle: Record whose first six numbers are position (m) and velocity (m/s).
        end: Last vertex of the path (m). Shape (3,), or (0,).
        counters: Instants (us) at which the collision counter took its last values, and the values.
        trajectories: Points of the last trajectories that have any, by number, and the same as bytes.
        switched: Whether a way-point was published since the last command.
        fresh: Whether a way-point was published since the last report of the tracker.
    """

    def __init__(self, limits: MissionLimits) -> None:
        self.limits = limits.numbers()
        self.held = limits.held
        self._planning_us = int(_SHARE_OF_LATENCY * 1e6 * limits.planner_latency)
        self.start()

    def start(self) -> None:
        """Forget the last flight."""
        self.headers = {name: new_state(name).header for name in RULES}
        self.vehicle: np.ndarray = np.zeros(_VEHICLE_FLOATS)
        self.end = np.zeros(0)
        self.counters: tuple[tuple[int, int], ...] = ((-(1 << 62), 0),)
        self.trajectories: dict[int, tuple[np.ndarray, bytes]] = {}
        self.switched = self.fresh = True

    def motion(self) -> np.ndarray:
        """Position (m) and velocity (m/s) of the vehicle. Shape (6,)."""
        return np.ndarray(_VEHICLE_FLOATS, np.float64, self.vehicle)

    def newest(self) -> np.ndarray:
        """Points of the trajectory published last that has any. Shape (n, 11)."""
        return next(reversed(self.trajectories.values()))[0] if self.trajectories else _NO_POINTS

    def points_of(self, number: int) -> np.ndarray:
        """Points of a trajectory by number. Shape (n, 11); (0, 11) if it is not known."""
        found = self.trajectories.get(number)
        return _NO_POINTS if found is None else found[0]

    def answerable(self, now: int) -> np.ndarray:
        """Collision counters that a path of now can answer: the one known when the planner began, and later ones."""
        began = now - self._planning_us
        known = [value for time, value in self.counters if time <= began][-1:]
        return np.array(known + [value for time, value in self.counters if time > began - _JITTER_US], np.int64)

    def memory(self) -> tuple[Any, ...]:
        """All of it as plain data."""
        return (
            tuple(header.tobytes() for header in self.headers.values()), self.motion().tobytes(), self.end.tobytes(),
            self.counters, tuple((number, content) for number, (_, content) in self.trajectories.items()),
            self.switched, self.fresh,
        )  # fmt: skip

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        headers, vehicle, end, self.counters, trajectories, self.switched, self.fresh = memory
        for (name, header), content in zip(self.headers.items(), headers, strict=True):
            self.headers[name] = np.frombuffer(content, header.dtype).copy()
        self.vehicle, self.end = np.frombuffer(vehicle).copy(), np.frombuffer(end).copy()
        self.trajectories = {number: (_points(content), content) for number, content in trajectories}


def _points(content: bytes) -> np.ndarray:
    return np.frombuffer(content).reshape(-1, rules.POINT_WIDTH).copy()


class Rule(NamedTuple):
    """What a state must be, given what was published before.

    Attributes:
        broken_by: Place of the field that breaks it among those of header and element, or -1; changes nothing.
        note: Take note of a value that was published.
    """

    broken_by: Callable[[Published, State, int], int]
    note: Callable[[Published, State, int], None]


def _judge_status(known: Published, state: State, now: int) -> int:
    return rules.status(state.header, known.headers[_STATUS], known.headers[_TRAJECTORY], known.limits)


def _note_status(known: Published, state: State, now: int) -> None:
    counter = int(state.header["future_collision_seq"][0])
    if counter != known.counters[-1][1]:
        known.counters = (*known.counters[1 - _COUNTERS :], (now, counter))
    known.headers[_STATUS] = state.header


def _judge_path(known: Published, state: State, now: int) -> int:
    vertices = floats(state.elements, 3).reshape(-1, 3)
    return rules.path(
        state.header, vertices, known.answerable(now), known.motion(), known.newest(), known.limits
    )  # fmt: skip


def _note_path(known: Published, state: State, now: int) -> None:
    known.end = floats(state.elements[-1:], 3).copy() if len(state.elements) else np.zeros(0)
    known.headers[_PATH] = state.header


def _judge_trajectory(known: Published, state: State, now: int) -> int:
    points = floats(state.elements, rules.POINT_WIDTH).reshape(-1, rules.POINT_WIDTH)
    before, path = known.headers[_TRAJECTORY], known.headers[_PATH]
    return rules.trajectory(state.header, points, before, path, known.end, known.motion(), known.limits)


def _note_trajectory(known: Published, state: State, now: int) -> None:
    known.headers[_TRAJECTORY] = state.header
    if len(state.elements):
        content = state.elements.tobytes()
        number = int(state.header["trajectory_seq"][0])
        kept = [item for item in known.trajectories.items() if item[0] != number][1 - _KEPT :]
        known.trajectories = dict([*kept, (number, (_points(content), content))])


def _judge_waypoint(known: Published, state: State, now: int) -> int:
    header = state.header
    before, newest = known.headers[_WAYPOINT], known.headers[_TRAJECTORY]
    points = known.points_of(int(header["trajectory_seq"][0]))
    values = floats(header, _WAYPOINT_FLOATS)
    return following.waypoint(values, header, before, newest, points, known.motion(), known.limits)


def _note_waypoint(known: Published, state: State, now: int) -> None:
    known.headers[_WAYPOINT] = state.header
    known.switched = known.fresh = True


def _judge_command(known: Published, state: State, now: int) -> int:
    return following.command(state.header, known.headers[_COMMAND], known.switched, known.limits)


def _note_command(known: Published, state: State, now: int) -> None:
    known.headers[_COMMAND] = state.header
    known.switched = False


def _judge_tracking(known: Published, state: State, now: int) -> int:
    if not known.held:
        return rules.FINE  # nobody reads it
    duration = float(known.headers[_WAYPOINT]["duration"][0]) if known.fresh else 0.0
    return following.tracking(state.header, known.headers[_TRACKING], duration, known.limits)


def _note_tracking(known: Published, state: State, now: int) -> None:
    known.headers[_TRACKING] = state.header
    known.fresh = False


RULES: dict[str, Rule] = {
    _STATUS: Rule(_judge_status, _note_status),
    _PATH: Rule(_judge_path, _note_path),
    _TRAJECTORY: Rule(_judge_trajectory, _note_trajectory),
    _WAYPOINT: Rule(_judge_waypoint, _note_waypoint),
    _COMMAND: Rule(_judge_command, _note_command),
    _TRACKING: Rule(_judge_tracking, _note_tracking),
}
"""The rule of each state, by its name in `STATES`; a state without one is not judged."""


class AcceptanceTest:
    """Judges publications by `RULES`: what breaks one is a hard alarm for the stage of its writer.

    Args:
        limits: Of the mission.
    """

    needs_limits = True

    def __init__(self, limits: MissionLimits) -> None:
        self.known = Published(limits)

    def start(self) -> None:
        """Forget the last flight."""
        self.known.start()

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Judge a publication."""
        rule = RULES.get(state.spec.name)
        if rule is None:
            return None
        place = rule.broken_by(self.known, state, time_us)
        if place < 0:
            return None
        spec = state.spec
        field = (*spec.header, *spec.elements)[place].name
        return Alarm(SOURCE, spec.stage.value, score=IMPLAUSIBLE, fields=(f"{spec.name}.{field}",), hard=True)

    def score(self, state: State, time_us: int) -> float | None:
        """2 of what breaks a rule, else 0; None if there is no rule."""
        if state.spec.name not in RULES:
            return None
        return 0.0 if self.check(state, time_us) is None else IMPLAUSIBLE

    def accept(self, state: State, time_us: int) -> None:
        """Take note of a value that was published."""
        rule = RULES.get(state.spec.name)
        if rule is not None:
            rule.note(self.known, state, time_us)
        elif state.spec.name in _POSITIONS:
            self.known.vehicle = state.header

    def memory(self) -> tuple[Any, ...]:
        """What is remembered, see `Detector`."""
        return self.known.memory()

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        self.known.restore(memory)


_POSITIONS = tuple(ODOMETRY.values())
