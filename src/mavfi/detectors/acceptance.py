"""Acceptance test: physics and protocol rules for every consumed field.  Nothing is trained.

Clouds and map updates have no rules: no mission depends on a single value of theirs, since neighbouring values and the
next scan repair it.

Its memory is one record of earlier publications, updated by compiled functions.  The record starts with the numbers of
`MissionLimits`, so that rules receive limits and memory in one argument: each argument costs some 60 ns per call from
Python.  A checked header is stored as the candidate; after acceptance the next call commits it as the last publication,
so that each publication costs one call.

Trajectory points are stored in blocks, shape (KEPT, capacity, 11); the record holds their numbers and lengths.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors import estimates, rules
from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.gate import IMPLAUSIBLE
from mavfi.detectors.limits import NUMBERS, MissionLimits
from mavfi.errors import BadInputError
from mavfi.numerics.jit import entry, kernel_jit
from mavfi.states import ODOMETRY, STATES, State, bytes_of, floats, new_state, rows

SOURCE = "acceptance"
"""Name in its alarms."""
Compiled = Callable[..., Any]
"""A compiled function."""
_VEHICLE_FLOATS = 6
"""Leading numbers of the odometry that rules read: position (m) and velocity (m/s)."""
_STATUS = "perception.collision_status"
"""State with the rule `rules.status`."""
_PATH = "planning.path"
"""State with the rule `rules.path`."""
_TRAJECTORY = "planning.trajectory"
"""State with the rule `rules.trajectory`."""
_WAYPOINT = "planning.waypoint"
"""State with the rule `rules.waypoint`."""
_COMMAND = "control.command"
"""State with the rule `rules.command`."""
_TRACKING = "control.tracking"
"""State with the rule `rules.tracking`."""
_TRUTH = ODOMETRY["truth"]
"""Odometry in flights without an estimator, which has no rule."""
_ESTIMATE = ODOMETRY["estimator"]
"""Odometry in flights with an estimator, see `estimates.judge_estimate`."""
_CANDIDATES = (_WAYPOINT, _COMMAND, _TRACKING)
"""States whose check stores the header, which the next call commits if it was accepted."""
CHECKED = frozenset((_ESTIMATE, _STATUS, _PATH, _TRAJECTORY, *_CANDIDATES))
"""States with a rule."""

COUNTERS, EPOCHS, DYNAMICS, COPIES, NODES = RULES = range(1, 6)
"""Numbers of the rules of docs/concepts/engineers.md; the last restarts nodes and checks nothing."""
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
"""Rule of a field, "<stage>.<state>.<field>"."""
_RULE_OF_STATE = {_WAYPOINT: COPIES}
"""Rule of a state's fields that are not in `_RULE_OF_FIELD`; of those of all further states, `DYNAMICS`."""


def rule_of(field: str) -> int:
    """Number of the rule that a field ("<stage>.<state>.<field>") violates."""
    state, _, _ = field.rpartition(".")
    return _RULE_OF_FIELD.get(field, _RULE_OF_STATE.get(state, DYNAMICS))


# ---- memory ----------------------------------------------------------------------------------------------------------
KEPT = 3
"""Trajectories that a way-point may refer to: the one in force, the pending one, and one spare."""
KEPT_COUNTERS = 4
"""Latest values of the collision counter that are remembered: a path answers one of them."""
CAPACITY = 2048
"""Initial capacity of a block, in trajectory points; grows if needed."""
# Types of headers as constants: compiled functions cannot look them up in `STATES`.
STATUS_TYPE, PATH_TYPE, TRAJECTORY_TYPE, WAYPOINT_TYPE, COMMAND_TYPE, TRACKING_TYPE = (
    STATES[name].header_dtype for name in (_STATUS, _PATH, _TRAJECTORY, *_CANDIDATES)
)
OF_WAYPOINT, OF_COMMAND, OF_TRACKING = range(1, 4)
"""Number of the candidate's state, in the record."""
_WAYPOINT_SIZE = WAYPOINT_TYPE.itemsize
_COMMAND_SIZE = COMMAND_TYPE.itemsize
_TRACKING_SIZE = TRACKING_TYPE.itemsize
_SHARE_OF_LATENCY = 0.7
"""Least planning time before a path is published / the planner's latency."""
_JITTER_US = 300_000
"""Largest planning time in excess of that."""
_LONG_AGO = -(1 << 62)
"""Instant of the first collision counter, 0: before any flight (us)."""

# The record, see `RECORD`: headers published last, further memory, and work that is not part of the memory.
_HEADERS = {
    "last_status": STATUS_TYPE,
    "last_path": PATH_TYPE,
    "last_trajectory": TRAJECTORY_TYPE,
    "last_waypoint": WAYPOINT_TYPE,
    "last_command": COMMAND_TYPE,
    "last_tracking": TRACKING_TYPE,
}
_REMEMBERED: list[tuple[Any, ...]] = [
    *((name, "u1", (dtype.itemsize,)) for name, dtype in _HEADERS.items()),
    ("end", "f8", (3,)),
    ("ended", "?"),
    ("changes", "i8"),
    ("times", "i8", (KEPT_COUNTERS,)),
    ("counters", "i8", (KEPT_COUNTERS,)),
    ("stored", "i8"),
    ("numbers", "i8", (KEPT,)),
    ("counts", "i8", (KEPT,)),
    ("switched", "?"),
    ("fresh", "?"),
]
"""Fields of the record that form the memory, see `RECORD`."""
_WORK = [
    ("planning_us", "i8"),
    ("blocks", "i8", (KEPT,)),
    ("candidate", "u1", (_WAYPOINT_SIZE,)),
    ("candidate_of", "i8"),
    ("accepted", "?"),
]
"""Fields of the record that a memory need not restore, see `RECORD`."""
RECORD = np.dtype([*NUMBERS.descr, *_REMEMBERED, *_WORK])
"""The record.

- Limits: see `MissionLimits.numbers`.
- Last published headers, as bytes: `last_status` and so on; 0 before the first.
- `end`: last vertex of the path (m), if it has one (`ended`).
- `counters`, `times`: the latest values of the collision counter, oldest first, and the times of the changes (us);
  `changes` is their number.
- `numbers`, `counts`: number and length of the latest trajectories with points, oldest first; `stored` is how many.
- `switched`, `fresh`: whether a way-point has been published since the last command, and since the last tracking
  report.
- Work: `planning_us`, the least time from the planner's start to its path (us); block index of each stored trajectory;
  the candidate, its state, and whether it was accepted.
"""
MEMORY = slice(NUMBERS.itemsize, RECORD.fields["planning_us"][1])  # type: ignore[index]
"""Bytes of the record that form the memory."""


def new_record(limits: MissionLimits) -> np.ndarray:
    """The record at the start of a flight. Shape (1,)."""
    record = np.zeros(1, RECORD)
    numbers = limits.numbers()
    for name in NUMBERS.names or ():
        record[name] = numbers[name]
    record["planning_us"] = int(_SHARE_OF_LATENCY * 1e6 * limits.planner_latency)
    forget(record)
    return record


def named_memory(record: np.ndarray) -> dict[str, np.ndarray]:
    """The memory by name, headers by field: the arrays themselves, not copies."""
    arrays: dict[str, np.ndarray] = {}
    for name, *_ in _REMEMBERED:
        array = record[name].reshape(-1)
        if name in _HEADERS:
            header = array.view(_HEADERS[name])
            arrays |= {f"{name}.{field}": header[field] for field in header.dtype.names or ()}
        else:
            arrays[name] = array
    return arrays


def forget(record: np.ndarray) -> None:
    """Reset the memory at the start of a flight."""
    record.view(np.uint8)[MEMORY] = 0
    record["switched"] = record["fresh"] = True
    record["changes"] = 1
    record["times"][0, 0] = _LONG_AGO
    record["blocks"] = range(KEPT)
    record["accepted"] = False


@kernel_jit
def settle(record: np.ndarray) -> None:
    """Commit the candidate, if the host has accepted it, as the last publication of its state."""
    memory = record[0]
    if not memory["accepted"]:
        return
    memory["accepted"] = False
    if memory["candidate_of"] == OF_WAYPOINT:
        memory["last_waypoint"][:] = memory["candidate"][:_WAYPOINT_SIZE]
        memory["switched"] = memory["fresh"] = True
    elif memory["candidate_of"] == OF_COMMAND:
        memory["last_command"][:] = memory["candidate"][:_COMMAND_SIZE]
        memory["switched"] = False
    else:
        memory["last_tracking"][:] = memory["candidate"][:_TRACKING_SIZE]
        memory["fresh"] = False


@kernel_jit
def propose(header: np.ndarray, of: int, record: np.ndarray) -> None:
    """Store a header as the candidate; `of` is the number of its state, e.g. `OF_WAYPOINT`."""
    memory = record[0]
    content = header.view(np.uint8)
    memory["candidate"][: len(content)] = content
    memory["candidate_of"] = of


@kernel_jit
def used(count: int, least: int, most: int) -> int:
    """Clamp a number of entries: one corrupted by a memory fault must not become an index."""
    return min(max(count, least), most)


@kernel_jit
def note_status(header: np.ndarray, now: int, record: np.ndarray) -> None:
    """Record a collision status published at `now` (us)."""
    memory = record[0]
    counter = int(header[0]["future_collision_seq"])
    count = used(memory["changes"], 1, KEPT_COUNTERS)
    times = memory["times"]
    counters = memory["counters"]
    if counter != counters[count - 1]:
        if count == KEPT_COUNTERS:  # drop the oldest
            times[:-1], counters[:-1] = times[1:].copy(), counters[1:].copy()
            count -= 1
        times[count], counters[count] = now, counter
        memory["changes"] = count + 1
    memory["last_status"][:] = header.view(np.uint8)


@kernel_jit
def answerable(now: int, record: np.ndarray) -> np.ndarray:
    """Collision counters that a path at `now` (us) can answer: the one known when the planner started, and later."""
    memory = record[0]
    began = now - memory["planning_us"]
    answers = np.zeros(KEPT_COUNTERS + 1, np.int64)
    count = 0
    changes = used(memory["changes"], 1, KEPT_COUNTERS)
    # The latest counter when the planner started, at the latest possible instant.
    for index in range(changes):
        if memory["times"][index] <= began:
            answers[0] = memory["counters"][index]
            count = 1
    # All counters since the earliest instant at which it may have started.
    for index in range(changes):
        if memory["times"][index] > began - _JITTER_US:
            answers[count] = memory["counters"][index]
            count += 1
    return answers[:count]


@kernel_jit
def note_path(header: np.ndarray, vertices: np.ndarray, record: np.ndarray) -> None:
    """Record a published path; vertices (m) have shape (n, 3)."""
    memory = record[0]
    memory["ended"] = len(vertices) > 0
    memory["end"][:] = 0.0
    if len(vertices) > 0:
        memory["end"][:] = vertices[len(vertices) - 1]
    memory["last_path"][:] = header.view(np.uint8)


@kernel_jit
def note_trajectory(header: np.ndarray, points: np.ndarray, record: np.ndarray, blocks: np.ndarray) -> None:
    """Record a published trajectory; points have shape (n, 11) and fit into a block."""
    memory = record[0]
    memory["last_trajectory"][:] = header.view(np.uint8)
    if len(points) == 0:
        return
    number = int(header[0]["trajectory_seq"])
    stored = used(memory["stored"], 0, KEPT)
    block_indices = memory["blocks"]
    # Entry to drop: that with the same number, or the oldest if all are in use; `stored` = none.
    drop = 0 if stored == KEPT else stored
    for index in range(stored):
        if memory["numbers"][index] == number:
            drop = index
    # The new trajectory takes the block of the dropped one, and the last entry.
    block = block_indices[drop]
    last = stored - 1 if drop < stored else stored
    for index in range(drop, last):
        memory["numbers"][index], memory["counts"][index] = memory["numbers"][index + 1], memory["counts"][index + 1]
        block_indices[index] = block_indices[index + 1]
    memory["numbers"][last], memory["counts"][last], block_indices[last] = number, len(points), block
    memory["stored"] = last + 1
    for row in range(len(points)):  # an assigned slice would call functions with memory of their own
        for column in range(points.shape[1]):
            blocks[block, row, column] = points[row, column]


@kernel_jit
def points_of(number: int, record: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Points of a stored trajectory. Shape (n, 11); (0, 11) if unknown."""
    memory = record[0]
    for index in range(used(memory["stored"], 0, KEPT)):
        if memory["numbers"][index] == number:
            return blocks[memory["blocks"][index], : memory["counts"][index]]
    return blocks[0, :0]


@kernel_jit
def newest(record: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Points of the latest stored trajectory. Shape (n, 11); (0, 11) if there is none."""
    memory = record[0]
    last = used(memory["stored"], 0, KEPT) - 1
    return blocks[0, :0] if last < 0 else blocks[memory["blocks"][last], : memory["counts"][last]]


# ---- rules -----------------------------------------------------------------------------------------------------------
@kernel_jit
def judge_status(header: np.ndarray, record: np.ndarray) -> int:
    """See `rules.status`."""
    before = record[0]["last_status"].view(STATUS_TYPE)
    trajectory = record[0]["last_trajectory"].view(TRAJECTORY_TYPE)
    return rules.status(header, before, trajectory, record)


@kernel_jit
def judge_path(
    header: np.ndarray, vertices: np.ndarray, now: int, odometry: np.ndarray, record: np.ndarray, blocks: np.ndarray
) -> int:
    """See `rules.path`; `now` in us, `odometry` starts with position and velocity."""
    epochs = answerable(now, record)
    vehicle = odometry.view(np.float64)
    return rules.path(header, vertices, epochs, vehicle, newest(record, blocks), record)


@kernel_jit
def judge_trajectory(header: np.ndarray, points: np.ndarray, odometry: np.ndarray, record: np.ndarray) -> int:
    """See `rules.trajectory`."""
    before = record[0]["last_trajectory"].view(TRAJECTORY_TYPE)
    path = record[0]["last_path"].view(PATH_TYPE)
    end = record[0]["end"][: 3 if record[0]["ended"] else 0]
    return rules.trajectory(header, points, before, path, end, odometry.view(np.float64), record)


@kernel_jit
def judge_waypoint(header: np.ndarray, odometry: np.ndarray, record: np.ndarray, blocks: np.ndarray) -> int:
    """See `rules.waypoint`; makes the way-point the candidate."""
    settle(record)
    propose(header, OF_WAYPOINT, record)
    before = record[0]["last_waypoint"].view(WAYPOINT_TYPE)
    newest_header = record[0]["last_trajectory"].view(TRAJECTORY_TYPE)
    points = points_of(int(header[0]["trajectory_seq"]), record, blocks)
    values = record[0]["candidate"][: 8 * rules.POINT_WIDTH].view(np.float64)
    return rules.waypoint(values, header, before, newest_header, points, odometry.view(np.float64), record)


@kernel_jit
def judge_command(header: np.ndarray, record: np.ndarray) -> int:
    """See `rules.command`; makes the command the candidate."""
    settle(record)
    propose(header, OF_COMMAND, record)
    return rules.command(header, record[0]["last_command"].view(COMMAND_TYPE), record[0]["switched"], record)


@kernel_jit
def judge_tracking(header: np.ndarray, record: np.ndarray) -> int:
    """See `rules.tracking`; makes the report the candidate."""
    settle(record)
    propose(header, OF_TRACKING, record)
    duration = record[0]["last_waypoint"].view(WAYPOINT_TYPE)[0]["duration"] if record[0]["fresh"] else 0.0
    return rules.tracking(header, record[0]["last_tracking"].view(TRACKING_TYPE), duration, record)


_ENTRIES: tuple[Compiled, ...] = (
    judge_status,
    judge_path,
    judge_trajectory,
    judge_waypoint,
    judge_command,
    judge_tracking,
    note_status,
    note_path,
    note_trajectory,
    estimates.judge_estimate,
    estimates.note_estimate,
    estimates.note_fix,
)
COMPILED: Mapping[str, Compiled] = {function.__name__: function for function in _ENTRIES}
"""Entry points from Python into compiled code, by name."""


class AcceptanceTest(Detector):
    """Checks publications against rules: a violation is a hard alarm for the stage of the publishing kernel.

    Args:
        limits: Limits of the mission.
        rules: Numbers of the rules whose alarms count.  The test finds the first field of a publication that violates
            any rule; the publication passes if that field belongs to a rule that does not count.

    Attributes:
        limits: Limits of the mission.
        record: Limits and memory, see `RECORD`. Shape (1,).
        blocks: Points of trajectories, see the module. Shape (KEPT, capacity, 11).
        odometry: Header of the latest odometry; zeros before the first.
        estimate: Limits and memory of the rule of the estimated odometry, see `estimates.RECORD`. Shape (1,).

    Raises:
        BadInputError: There is no such rule.
    """

    source = SOURCE

    def __init__(self, limits: MissionLimits, rules: Sequence[int] = tuple(RULES)) -> None:
        if not isinstance(rules, (list, tuple)) or not all(rule in RULES for rule in rules):
            raise BadInputError(f"rules: {rules!r}: allowed: a list of numbers from {COUNTERS} to {NODES}")
        self.limits = limits
        self.rules = tuple(rules)
        self.record = new_record(limits)
        self.estimate = estimates.new_record(limits)
        self._accepted = self.record["accepted"]  # a view: setting it costs no call
        self.start()
        self.instrument({})
        self.states = CHECKED.union(self._record_functions)
        if not limits.held:  # the tracking report is not checked
            self.states -= {_TRACKING}

    @property
    def compiled(self) -> Mapping[str, Compiled]:
        """See `Detector`."""
        return COMPILED

    def instrument(self, instrumented: Mapping[str, Compiled]) -> None:
        """See `Detector`."""
        functions = {**COMPILED, **instrumented}
        record = self.record

        def judge_of_header(name: str, header: np.ndarray) -> Callable[[State, int], int]:
            function = entry(functions[name], header, record)
            return lambda state, now: function(state.header, record)

        # Machine code of the most frequent calls, by examples of their arguments.  `blocks` and `odometry` are read at
        # each call, since both are replaced during a flight.
        status, waypoint, command, tracking = (new_state(name).header for name in (_STATUS, *_CANDIDATES))
        judge_waypoint = entry(functions["judge_waypoint"], waypoint, bytes_of(self.odometry), record, self.blocks)
        note_status = entry(functions["note_status"], status, 0, record)

        # What checks a publication, and what records a published value, by state.
        self._check_functions: dict[str, Callable[[State, int], int]] = {
            _STATUS: judge_of_header("judge_status", status),
            _PATH: lambda state, now: functions["judge_path"](
                state.header, rows(state.elements, 3), now, bytes_of(self.odometry), record, self.blocks
            ),
            _TRAJECTORY: lambda state, now: functions["judge_trajectory"](
                state.header, rows(state.elements, rules.POINT_WIDTH), bytes_of(self.odometry), record
            ),
            _WAYPOINT: lambda state, now: judge_waypoint(state.header, bytes_of(self.odometry), record, self.blocks),
            _COMMAND: judge_of_header("judge_command", command),
        }
        self._record_functions: dict[str, Callable[[State, int], None]] = {
            _STATUS: lambda state, now: note_status(state.header, now, record),
            _PATH: lambda state, now: functions["note_path"](state.header, rows(state.elements, 3), record),
            _TRAJECTORY: self._record_trajectory,
            **dict.fromkeys(ODOMETRY.values(), self._record_odometry),
        }
        self._record_trajectory_points = functions["note_trajectory"]
        if self.limits.held:
            self._check_functions[_TRACKING] = judge_of_header("judge_tracking", tracking)
        if self.limits.fix_noise is not None:
            self._instrument_estimate(functions)

    def _instrument_estimate(self, functions: Mapping[str, Compiled]) -> None:
        """Set the functions of the estimated odometry, which only flights with an estimator have."""
        estimate = self.estimate
        odometry, fix = (bytes_of(new_state(name).header) for name in (_ESTIMATE, estimates.FIX))
        judge_estimate = entry(functions["judge_estimate"], odometry, 0, estimate)
        self._record_estimate_header = entry(functions["note_estimate"], odometry, 0, estimate)
        note_fix = entry(functions["note_fix"], fix, estimate)
        self._check_functions[_ESTIMATE] = lambda state, now: judge_estimate(bytes_of(state.header), now, estimate)
        self._record_functions[_ESTIMATE] = self._record_estimate
        self._record_functions[estimates.FIX] = lambda state, now: note_fix(bytes_of(state.header), estimate)

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        forget(self.record)
        estimates.forget(self.estimate)
        self.blocks = np.zeros((KEPT, CAPACITY, rules.POINT_WIDTH))
        self.odometry = new_state(_TRUTH).header
        self._candidate: State | None = None

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication; the alarm names the field that violates its rule."""
        spec = state.spec
        judge = self._check_functions.get(spec.name)
        if judge is None:
            return None
        if spec.name in _CANDIDATES:
            self._candidate = state
        index = judge(state, time_us)
        if index < 0:
            return None
        field = f"{spec.name}.{(*spec.header, *spec.elements)[index].name}"
        if rule_of(field) not in self.rules:
            return None
        return Alarm(SOURCE, spec.stage.value, score=IMPLAUSIBLE, fields=(field,), hard=True)

    def score(self, state: State, time_us: int) -> float | None:
        """2 for a violation, else 0; None for states without a rule."""
        if state.spec.name not in CHECKED:
            return None
        if self.check(state, time_us) is None:
            return 0.0
        return IMPLAUSIBLE

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""
        if state is not self._candidate:
            note = self._record_functions.get(state.spec.name)
            if note is not None:
                note(state, time_us)
                return
            if state.spec.name in _CANDIDATES:
                self.check(state, time_us)  # makes it the candidate, unless it is not read
        if state is self._candidate:
            self._accepted[0] = True

    def _record_odometry(self, state: State, now: int) -> None:
        """Keep the header of a published odometry, without a copy; `arrays` makes one before a fault can change it."""
        self.odometry = state.header

    def _record_estimate(self, state: State, now: int) -> None:
        """Record a published estimate, which is the vehicle's odometry and has a rule of its own."""
        self.odometry = state.header
        self._record_estimate_header(bytes_of(state.header), now, self.estimate)

    def _record_trajectory(self, state: State, now: int) -> None:
        """Record a published trajectory of any length."""
        self._make_room(len(state.elements))
        points = rows(state.elements, rules.POINT_WIDTH)
        self._record_trajectory_points(state.header, points, self.record, self.blocks)

    def _make_room(self, count: int) -> None:
        """Grow the blocks to hold trajectories of `count` points."""
        capacity = self.blocks.shape[1]
        if count > capacity:
            blocks = np.zeros((KEPT, max(count, 2 * capacity), rules.POINT_WIDTH))
            blocks[:, :capacity] = self.blocks
            self.blocks = blocks

    def memory(self) -> tuple[Any, ...]:
        """Memory between publications, see `Detector`."""
        settle(self.record)
        vehicle = floats(self.odometry, _VEHICLE_FLOATS).tobytes()
        trajectories = tuple(points.tobytes() for points in self._trajectories())
        return self.record.view(np.uint8)[MEMORY].tobytes(), vehicle, trajectories, self.estimate.tobytes()

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        self.start()
        content, vehicle, trajectories, estimate = memory
        self.estimate[:] = np.frombuffer(estimate, self.estimate.dtype)
        self.record.view(np.uint8)[MEMORY] = np.frombuffer(content, np.uint8)
        floats(self.odometry, _VEHICLE_FLOATS)[:] = np.frombuffer(vehicle)
        for block, points in enumerate(trajectories):
            table = np.frombuffer(points).reshape(-1, rules.POINT_WIDTH)
            self._make_room(len(table))
            self.blocks[block, : len(table)] = table

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name, see `Detector`."""
        settle(self.record)
        self.odometry = self.odometry.copy()  # it belongs to the publication
        arrays = named_memory(self.record)
        arrays["vehicle"] = floats(self.odometry, _VEHICLE_FLOATS)
        for index, points in enumerate(self._trajectories()):
            arrays[f"trajectories[{index}]"] = points
        if self.limits.fix_noise is not None:
            arrays |= estimates.named_memory(self.estimate)
        return arrays

    def _trajectories(self) -> list[np.ndarray]:
        """Points of the stored trajectories, oldest first."""
        record = self.record[0]
        stored = used(int(record["stored"]), 0, KEPT)
        lengths = zip(record["blocks"][:stored], record["counts"][:stored], strict=True)
        return [self.blocks[block, :count] for block, count in lengths]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without machine code, which is valid in one process only."""
        return AcceptanceTest, (self.limits, self.rules), self.memory()

    __setstate__ = restore
