"""Acceptance test: physics and protocol rules for every consumed field.  Nothing is trained.

Clouds and map updates have no rules: no mission depends on a single value of theirs, since neighbouring values and the
next scan repair it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors import estimates, rule_memory, rules
from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.gate import IMPLAUSIBLE
from mavfi.detectors.limits import MissionLimits
from mavfi.errors import BadInputError
from mavfi.numerics.jit import entry, kernel_jit
from mavfi.states import ODOMETRY, State, bytes_of, floats, new_state, rows

SOURCE = "acceptance"
Compiled = Callable[..., Any]
_VEHICLE_FLOATS = 6
_STATUS, _PATH, _TRAJECTORY = "perception.collision_status", "planning.path", "planning.trajectory"
_WAYPOINT, _COMMAND, _TRACKING = "planning.waypoint", "control.command", "control.tracking"
_ESTIMATE = ODOMETRY["estimator"]
_POSITIONS = tuple(ODOMETRY.values())
_CANDIDATES = (_WAYPOINT, _COMMAND, _TRACKING)
"""States whose check stores the header, which the next call commits if it was accepted."""
CHECKED = frozenset((_ESTIMATE, _STATUS, _PATH, _TRAJECTORY, *_CANDIDATES))
"""States with a rule."""

COUNTERS, EPOCHS, DYNAMICS, COPIES, NODES = RULES = range(1, 6)
"""Numbers of the rules of docs/engineers.md; the last is a restart policy of nodes, with no check of its own."""
_RULE_OF_FIELD = {
    "perception.collision_status.future_collision_seq": COUNTERS,
    "perception.collision_status.collision": COUNTERS,
    "perception.collision_status.trajectory_seq": EPOCHS,
    "planning.path.future_collision_seq": EPOCHS,
    "planning.path.junction": EPOCHS,
    "planning.trajectory.trajectory_seq": EPOCHS,
    "planning.trajectory.future_collision_seq": EPOCHS,
    "planning.waypoint.trajectory_seq": EPOCHS,
    "planning.waypoint.future_collision_seq": EPOCHS,
    "planning.waypoint.index": EPOCHS,
}
_RULE_OF_STATE = {_WAYPOINT: COPIES}
"""Rule of the other fields of a state; of those of all further states, `DYNAMICS`."""


def rule_of(field: str) -> int:
    """Number of the rule that a field ("<stage>.<state>.<field>") violates."""
    state, _, _ = field.rpartition(".")
    return _RULE_OF_FIELD.get(field, _RULE_OF_STATE.get(state, DYNAMICS))


@kernel_jit
def judge_status(header: np.ndarray, record: np.ndarray) -> int:
    """See `rules.status`."""
    before, trajectory = (
        record[0]["last_status"].view(rule_memory.STATUS),
        record[0]["last_trajectory"].view(rule_memory.TRAJECTORY),
    )
    return rules.status(header, before, trajectory, record)


@kernel_jit
def judge_path(
    header: np.ndarray, vertices: np.ndarray, now: int, odometry: np.ndarray, record: np.ndarray, blocks: np.ndarray
) -> int:
    """See `rules.path`; `now` in us, `odometry` starts with position and velocity."""
    epochs, vehicle = rule_memory.answerable(now, record), odometry.view(np.float64)
    return rules.path(header, vertices, epochs, vehicle, rule_memory.newest(record, blocks), record)


@kernel_jit
def judge_trajectory(header: np.ndarray, points: np.ndarray, odometry: np.ndarray, record: np.ndarray) -> int:
    """See `rules.trajectory`."""
    before, path = (
        record[0]["last_trajectory"].view(rule_memory.TRAJECTORY),
        record[0]["last_path"].view(rule_memory.PATH),
    )
    end = record[0]["end"][: 3 if record[0]["ended"] else 0]
    return rules.trajectory(header, points, before, path, end, odometry.view(np.float64), record)


@kernel_jit
def judge_waypoint(header: np.ndarray, odometry: np.ndarray, record: np.ndarray, blocks: np.ndarray) -> int:
    """See `rules.waypoint`; makes the way-point the candidate."""
    rule_memory.settle(record)
    rule_memory.propose(header, rule_memory.OF_WAYPOINT, record)
    before, newest = (
        record[0]["last_waypoint"].view(rule_memory.WAYPOINT),
        record[0]["last_trajectory"].view(rule_memory.TRAJECTORY),
    )
    points = rule_memory.points_of(int(header[0]["trajectory_seq"]), record, blocks)
    values = record[0]["candidate"][: 8 * rules.POINT_WIDTH].view(np.float64)
    return rules.waypoint(values, header, before, newest, points, odometry.view(np.float64), record)


@kernel_jit
def judge_command(header: np.ndarray, record: np.ndarray) -> int:
    """See `rules.command`; makes the command the candidate."""
    rule_memory.settle(record)
    rule_memory.propose(header, rule_memory.OF_COMMAND, record)
    return rules.command(header, record[0]["last_command"].view(rule_memory.COMMAND), record[0]["switched"], record)


@kernel_jit
def judge_tracking(header: np.ndarray, record: np.ndarray) -> int:
    """See `rules.tracking`; makes the report the candidate."""
    rule_memory.settle(record)
    rule_memory.propose(header, rule_memory.OF_TRACKING, record)
    duration = record[0]["last_waypoint"].view(rule_memory.WAYPOINT)[0]["duration"] if record[0]["fresh"] else 0.0
    return rules.tracking(header, record[0]["last_tracking"].view(rule_memory.TRACKING), duration, record)


COMPILED: Mapping[str, Compiled] = {
    "judge_status": judge_status,
    "judge_path": judge_path,
    "judge_trajectory": judge_trajectory,
    "judge_waypoint": judge_waypoint,
    "judge_command": judge_command,
    "judge_tracking": judge_tracking,
    "note_status": rule_memory.note_status,
    "note_path": rule_memory.note_path,
    "note_trajectory": rule_memory.note_trajectory,
    "judge_estimate": estimates.judge_estimate,
    "note_estimate": estimates.note_estimate,
    "note_fix": estimates.note_fix,
}
"""Entry points from Python into compiled code, by name."""


class AcceptanceTest(Detector):
    """Checks publications against rules: a violation is a hard alarm for the stage of the publishing kernel.

    Args:
        limits: Limits of the mission.
        rules: Numbers of the rules whose alarms count.  The test finds the first field of a publication that violates
            any rule; the publication passes if that field belongs to a rule that does not count.

    Attributes:
        limits: Limits of the mission.
        record: Limits and memory, see `rule_memory.RECORD`. Shape (1,).
        blocks: Points of trajectories, see `rule_memory`. Shape (KEPT, capacity, 11).
        odometry: Header of the latest odometry; zeros before the first.
        estimates: Rule of the estimated odometry and what it remembers.

    Raises:
        BadInputError: There is no such rule.
    """

    source = SOURCE

    def __init__(self, limits: MissionLimits, rules: Sequence[int] = tuple(RULES)) -> None:
        if not isinstance(rules, (list, tuple)) or not all(rule in RULES for rule in rules):
            raise BadInputError(f"rules: {rules!r}: allowed: a list of numbers from {COUNTERS} to {NODES}")
        self.limits, self.rules = limits, tuple(rules)
        self.record = rule_memory.new_record(limits)
        self.estimates = estimates.Estimates(limits)
        unread = () if limits.held else (_TRACKING,)
        self.states = frozenset((*CHECKED, *_POSITIONS, *self.estimates.states)).difference(unread)
        self._only_noted = frozenset(_POSITIONS).difference(self.estimates.states)
        self._accepted = self.record["accepted"]
        self.start()
        self.instrument({})

    @property
    def compiled(self) -> Mapping[str, Compiled]:
        """See `Detector`."""
        return COMPILED

    def instrument(self, made: Mapping[str, Compiled]) -> None:
        """See `Detector`."""
        functions = {**COMPILED, **made}
        header = {name: new_state(name).header for name in (_STATUS, *_CANDIDATES)}
        self._functions = functions
        self._judge_status = entry(functions["judge_status"], header[_STATUS], self.record)
        self._note_status = entry(functions["note_status"], header[_STATUS], 0, self.record)
        self._judge_waypoint = entry(
            functions["judge_waypoint"], header[_WAYPOINT], bytes_of(self.odometry), self.record, self.blocks
        )  # fmt: skip
        # the most frequent publications: `check` calls these itself
        self._judges_at_ticks = {_COMMAND: entry(functions["judge_command"], header[_COMMAND], self.record)}
        if self.limits.held:
            self._judges_at_ticks[_TRACKING] = entry(functions["judge_tracking"], header[_TRACKING], self.record)
        self.estimates.use(functions["judge_estimate"], functions["note_estimate"], functions["note_fix"])

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        rule_memory.forget(self.record)
        self.estimates.start()
        self.blocks = np.zeros((rule_memory.KEPT, rule_memory.CAPACITY, rules.POINT_WIDTH))
        self.odometry = new_state(ODOMETRY["truth"]).header
        self._candidate: State | None = None

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication; the alarm names the field that violates its rule."""
        name = state.spec.name
        judge = self._judges_at_ticks.get(name)
        if judge is not None:
            self._candidate = state
            place = judge(state.header, self.record)
        elif name in CHECKED:
            place = self._judge(state, time_us)
        else:
            return None
        if place < 0:
            return None
        field = _field_at(state, place)
        if rule_of(field) not in self.rules:
            return None
        return Alarm(SOURCE, state.spec.stage.value, score=IMPLAUSIBLE, fields=(field,), hard=True)

    def _judge(self, state: State, now: int) -> int:
        """Index of the field of a publication that violates a rule, among those of header and element, or -1."""
        name = state.spec.name
        if name == _WAYPOINT:
            self._candidate = state
            return int(self._judge_waypoint(state.header, bytes_of(self.odometry), self.record, self.blocks))
        if name == _STATUS:
            return int(self._judge_status(state.header, self.record))
        if name == _PATH:
            vertices, odometry = rows(state.elements, 3), bytes_of(self.odometry)
            return int(
                self._functions["judge_path"](state.header, vertices, now, odometry, self.record, self.blocks)
            )  # fmt: skip
        if name == _TRAJECTORY:
            points = rows(state.elements, rules.POINT_WIDTH)
            return int(self._functions["judge_trajectory"](state.header, points, bytes_of(self.odometry), self.record))
        if name == _ESTIMATE:
            return self.estimates.check(state, now)
        return rules.FINE

    def score(self, state: State, time_us: int) -> float | None:
        """2 for a violation, else 0; None for states without a rule."""
        if state.spec.name not in CHECKED:
            return None
        return 0.0 if self.check(state, time_us) is None else IMPLAUSIBLE

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""
        if state is self._candidate:
            self._accepted[0] = True
            return
        name = state.spec.name
        if name in self._only_noted:
            self.odometry = state.header
        elif name in _CANDIDATES:
            self.check(state, time_us)  # makes it the candidate, unless it is not read
            if state is self._candidate:
                self._accepted[0] = True
        else:
            self._note(state, time_us)

    def _note(self, state: State, now: int) -> None:
        """Record a published value of a state without a candidate."""
        name = state.spec.name
        if name in self.estimates.states:
            if name == _ESTIMATE:
                self.odometry = state.header
            self.estimates.accept(state, now)
        elif name == _STATUS:
            self._note_status(state.header, now, self.record)
        elif name == _PATH:
            self._functions["note_path"](state.header, rows(state.elements, 3), self.record)
        elif name == _TRAJECTORY:
            self._make_room(len(state.elements))
            points = rows(state.elements, rules.POINT_WIDTH)
            self._functions["note_trajectory"](state.header, points, self.record, self.blocks)

    def _make_room(self, count: int) -> None:
        """Grow the blocks to hold trajectories of `count` points."""
        capacity = self.blocks.shape[1]
        if count > capacity:
            blocks = np.zeros((rule_memory.KEPT, max(count, 2 * capacity), rules.POINT_WIDTH))
            blocks[:, :capacity] = self.blocks
            self.blocks = blocks

    def memory(self) -> tuple[Any, ...]:
        """Memory between publications, see `Detector`."""
        record = self._settled_record()
        vehicle = floats(self.odometry, _VEHICLE_FLOATS).tobytes()
        trajectories = tuple(points.tobytes() for points in self._trajectories())
        return record.view(np.uint8)[rule_memory.MEMORY].tobytes(), vehicle, trajectories, self.estimates.memory()

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        self.start()
        content, vehicle, trajectories, estimate = memory
        self.estimates.restore(estimate)
        self.record.view(np.uint8)[rule_memory.MEMORY] = np.frombuffer(content, np.uint8)
        floats(self.odometry, _VEHICLE_FLOATS)[:] = np.frombuffer(vehicle)
        for place, points in enumerate(trajectories):
            rows = np.frombuffer(points).reshape(-1, rules.POINT_WIDTH)
            self._make_room(len(rows))
            self.blocks[place, : len(rows)] = rows

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name, see `Detector`."""
        record = self._settled_record()
        self.odometry = self.odometry.copy()  # it belongs to the publication
        points = {f"trajectories[{index}]": points for index, points in enumerate(self._trajectories())}
        vehicle = {"vehicle": floats(self.odometry, _VEHICLE_FLOATS)}
        return {**rule_memory.named(record), **vehicle, **points, **self.estimates.arrays()}

    def _settled_record(self) -> np.ndarray:
        """The record after the candidate, if accepted, is committed."""
        rule_memory.settle(self.record)
        return self.record

    def _trajectories(self) -> list[np.ndarray]:
        """Points of the stored trajectories, oldest first."""
        record = self.record[0]
        stored = rule_memory.used(int(record["stored"]), 0, rule_memory.KEPT)
        places = zip(record["blocks"][:stored], record["counts"][:stored], strict=True)
        return [self.blocks[place, :count] for place, count in places]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without machine code, which is valid in one process only."""
        return AcceptanceTest, (self.limits, self.rules), self.memory()

    __setstate__ = restore


def _field_at(state: State, place: int) -> str:
    """Name of a field by its index among those of header and element."""
    spec = state.spec
    return f"{spec.name}.{(*spec.header, *spec.elements)[place].name}"
