"""Acceptance test: physics and protocol rules for every consumed field.  Nothing is trained.

Clouds and map updates have no rules: no mission depends on a single value of theirs, since neighbouring values and the
next scan repair it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors import estimates, following, known, rules
from mavfi.detectors.detector import Alarm, AtOnce
from mavfi.detectors.gate import IMPLAUSIBLE
from mavfi.detectors.limits import MissionLimits
from mavfi.numerics.jit import entry, is_compiled, kernel_jit, short_jit
from mavfi.numerics.lent import content_of, header_of, lent
from mavfi.numerics.stored import Stored, kind_of, load
from mavfi.states import ODOMETRY, State, bytes_of, floats, new_state

SOURCE = "acceptance"
Compiled = Callable[..., Any]
_VEHICLE_FLOATS = 6
_STATUS = "perception.collision_status"
_WAYPOINT, _COMMAND, _TRACKING = "planning.waypoint", "control.command", "control.tracking"
_POSITIONS = tuple(ODOMETRY.values())


@kernel_jit
def judge_status(header: np.ndarray, record: np.ndarray) -> int:
    """See `rules.status`."""
    before, trajectory = (
        record[0]["last_status"].view(known.STATUS),
        record[0]["last_trajectory"].view(known.TRAJECTORY),
    )
    return rules.status(header, before, trajectory, record)


@kernel_jit
def judge_path(
    header: np.ndarray, vertices: np.ndarray, now: int, odometry: np.ndarray, record: np.ndarray, blocks: np.ndarray
) -> int:
    """See `rules.path`; `now` in us, `odometry` starts with position and velocity."""
    epochs, vehicle = known.answerable(now, record), odometry.view(np.float64)
    return rules.path(header, vertices, epochs, vehicle, known.newest(record, blocks), record)


@kernel_jit
def judge_trajectory(header: np.ndarray, points: np.ndarray, odometry: np.ndarray, record: np.ndarray) -> int:
    """See `rules.trajectory`."""
    before, path = record[0]["last_trajectory"].view(known.TRAJECTORY), record[0]["last_path"].view(known.PATH)
    end = record[0]["end"][: 3 if record[0]["ended"] else 0]
    return rules.trajectory(header, points, before, path, end, odometry.view(np.float64), record)


@kernel_jit
def judge_waypoint(header: np.ndarray, odometry: np.ndarray, record: np.ndarray, blocks: np.ndarray) -> int:
    """See `following.waypoint`; makes the way-point the candidate."""
    known.settle(record)
    known.propose(header, known.OF_WAYPOINT, record)
    before, newest = (
        record[0]["last_waypoint"].view(known.WAYPOINT),
        record[0]["last_trajectory"].view(known.TRAJECTORY),
    )
    points = known.points_of(int(header[0]["trajectory_seq"]), record, blocks)
    values = record[0]["candidate"][: 8 * rules.POINT_WIDTH].view(np.float64)
    return following.waypoint(values, header, before, newest, points, odometry.view(np.float64), record)


@kernel_jit
def judge_command(header: np.ndarray, record: np.ndarray) -> int:
    """See `following.command`; makes the command the candidate."""
    known.settle(record)
    known.propose(header, known.OF_COMMAND, record)
    return following.command(header, record[0]["last_command"].view(known.COMMAND), record[0]["switched"], record)


@kernel_jit
def judge_tracking(header: np.ndarray, record: np.ndarray) -> int:
    """See `following.tracking`; makes the report the candidate."""
    known.settle(record)
    known.propose(header, known.OF_TRACKING, record)
    duration = record[0]["last_waypoint"].view(known.WAYPOINT)[0]["duration"] if record[0]["fresh"] else 0.0
    return following.tracking(header, record[0]["last_tracking"].view(known.TRACKING), duration, record)


_KIND = kind_of(np.zeros(1, known.KNOWN), np.zeros((1, 1, rules.POINT_WIDTH)))


@short_jit
def _admit_command(address: int, header: Any) -> bool:
    record, _ = load(address, _KIND)
    return known.accept_unless_violated(judge_command(header_of(header), record), record)


@short_jit
def _admit_tracking(address: int, header: Any) -> bool:
    record, _ = load(address, _KIND)
    return known.accept_unless_violated(judge_tracking(header_of(header), record), record)


@short_jit
def _admit_waypoint(address: int, odometry: Any, header: Any) -> bool:
    record, blocks = load(address, _KIND)
    return known.accept_unless_violated(judge_waypoint(header_of(header), content_of(odometry), record, blocks), record)


@short_jit
def _admit_status(address: int, header: Any) -> bool:
    record, _ = load(address, _KIND)
    own = header_of(header)
    if known.is_counted(own, record) or judge_status(own, record) >= 0:  # its time counts, or there is an alarm
        return True
    known.note_status(own, 0, record)
    return False


@dataclass(frozen=True, slots=True)
class Functions:
    """Entry points from Python into compiled code; a host may supply instrumented ones."""

    judge_status: Compiled = judge_status
    judge_path: Compiled = judge_path
    judge_trajectory: Compiled = judge_trajectory
    judge_waypoint: Compiled = judge_waypoint
    judge_command: Compiled = judge_command
    judge_tracking: Compiled = judge_tracking
    note_status: Compiled = known.note_status
    note_path: Compiled = known.note_path
    note_trajectory: Compiled = known.note_trajectory
    judge_estimate: Compiled = estimates.judge_estimate
    note_estimate: Compiled = estimates.note_estimate
    note_fix: Compiled = estimates.note_fix


PLAIN = Functions()
"""The functions without instrumentation."""


class AcceptanceTest:
    """Checks publications against `RULES`: a violation is a hard alarm for the stage of the publishing kernel.

    Args:
        limits: Limits of the mission.
        functions: Compiled code.

    Attributes:
        states: Names of the states that it reads.
        limits: Limits of the mission.
        functions: Compiled code in use.
        record: Limits and memory, see `known.KNOWN`. Shape (1,).
        blocks: Points of trajectories, see `known`. Shape (KEPT, capacity, 11).
        estimates: Rule of the estimated odometry and what it remembers.
    """

    source, needs_limits = SOURCE, True

    def __init__(self, limits: MissionLimits, functions: Functions = PLAIN) -> None:
        self.limits = limits
        self.record = known.new_record(limits)
        self._accepted = self.record["accepted"]
        self.held = limits.held
        self.estimates = estimates.Estimates(limits)
        unread = () if limits.held else (_TRACKING,)
        self.states = frozenset((*RULES, *_POSITIONS, *self.estimates.states)).difference(unread)
        self._untimed = [name for name in _POSITIONS if name not in self.estimates.states]
        self._calls: dict[str, Compiled] = {}
        self._stepwise, self._at_once = False, AtOnce()
        self.start()
        self._use(functions)

    def _use(self, functions: Functions) -> None:
        header = {name: new_state(name).header for name in (_STATUS, _WAYPOINT, _COMMAND, _TRACKING)}
        self.functions = functions
        self._at_ticks = {_COMMAND: entry(functions.judge_command, header[_COMMAND], self.record)}
        if self.held:
            self._at_ticks[_TRACKING] = entry(functions.judge_tracking, header[_TRACKING], self.record)
        self.judge_status = entry(functions.judge_status, header[_STATUS], self.record)
        self.note_status = entry(functions.note_status, header[_STATUS], 0, self.record)
        self.judge_waypoint = entry(
            functions.judge_waypoint, header[_WAYPOINT], bytes_of(self.odometry), self.record, self.blocks
        )
        self.estimates.use(functions.judge_estimate, functions.note_estimate, functions.note_fix)
        self._calls = {}
        if functions == PLAIN and is_compiled(_admit_command):
            places = {name: lent(own) for name, own in header.items()}
            odometry = lent(self.odometry, listed=True)
            self._calls = {
                _STATUS: entry(_admit_status, 0, places[_STATUS]),
                _WAYPOINT: entry(_admit_waypoint, 0, odometry, places[_WAYPOINT]),
                _COMMAND: entry(_admit_command, 0, places[_COMMAND]),
            }
            if self.held:
                self._calls[_TRACKING] = entry(_admit_tracking, 0, places[_TRACKING])
        self._store()

    def _store(self) -> None:
        """Bring `at_once` up to date: the blocks are others."""
        self._own = Stored(_KIND, self.record, self.blocks)
        self._at_once.clear()
        if self._stepwise:
            return
        self._at_once.update(dict.fromkeys(self._untimed, self._latest.append))
        for name, call in self._calls.items():
            own = (self._own.address, self._latest) if name == _WAYPOINT else (self._own.address,)
            self._at_once[name] = partial(call, *own)

    @property
    def at_once(self) -> AtOnce:
        """See `Detector`."""
        return self._at_once

    def step_by_step(self, always: bool) -> None:
        """Whether hosts always call `check` and `accept`, which one of them may have replaced."""
        self._stepwise = always
        self._store()

    @property
    def odometry(self) -> np.ndarray:
        """Header of the latest odometry; zeros before the first."""
        return self._latest[-1]

    @property
    def compiled(self) -> dict[str, Compiled]:
        """The compiled functions, by name."""
        return {field.name: getattr(PLAIN, field.name) for field in fields(Functions)}

    def instrument(self, made: Mapping[str, Compiled]) -> None:
        """Replace compiled functions by those of the same name; restore all others."""
        self._use(replace(PLAIN, **made))

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        known.forget(self.record)
        self.estimates.start()
        self.blocks = np.zeros((known.KEPT, known.CAPACITY, rules.POINT_WIDTH))
        self._latest = [new_state(ODOMETRY["truth"]).header]
        self.candidate: State | None = None
        self._store()

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication; the alarm names the field that violates its rule."""
        name = state.spec.name
        judge = self._at_ticks.get(name)
        if judge is not None:  # most publications: skip the table look-up
            self.candidate = state
            place = judge(state.header, self.record)
        else:
            rule = RULES.get(name)
            if rule is None or rule.judge is None:
                return None
            del self._latest[:-1]  # `at_once` keeps all
            place = rule.judge(self, state, time_us)
        return None if place < 0 else _alarm(state, place)

    def score(self, state: State, time_us: int) -> float | None:
        """2 for a violation, else 0; None for states without a rule."""
        if state.spec.name not in RULES:
            return None
        return 0.0 if self.check(state, time_us) is None else IMPLAUSIBLE

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""
        if state is self.candidate:
            self._accepted[0] = True
            return
        name = state.spec.name
        if name in _POSITIONS:
            self._latest[:] = [state.header]
        if name in RULES:
            RULES[name].note(self, state, time_us)
        elif name in self.estimates.states:
            self.estimates.accept(state, time_us)

    def make_room(self, count: int) -> None:
        """Grow the blocks to hold trajectories of `count` points."""
        capacity = self.blocks.shape[1]
        if count > capacity:
            blocks = np.zeros((known.KEPT, max(count, 2 * capacity), rules.POINT_WIDTH))
            blocks[:, :capacity] = self.blocks
            self.blocks = blocks
            self._store()

    def memory(self) -> tuple[Any, ...]:
        """Memory between publications, see `Detector`."""
        known.settle(self.record)
        own = self.record[0]
        stored = zip(own["blocks"][: known.used(int(own["stored"]), 0, known.KEPT)], own["counts"], strict=False)
        trajectories = tuple(self.blocks[place, :count].tobytes() for place, count in stored)
        vehicle = floats(self.odometry, _VEHICLE_FLOATS).tobytes()
        return self.record.view(np.uint8)[known.MEMORY].tobytes(), vehicle, trajectories, self.estimates.memory()

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        self.start()
        content, vehicle, trajectories, estimate = memory
        self.estimates.restore(estimate)
        self.record.view(np.uint8)[known.MEMORY] = np.frombuffer(content, np.uint8)
        floats(self.odometry, _VEHICLE_FLOATS)[:] = np.frombuffer(vehicle)
        for place, points in enumerate(trajectories):
            found = np.frombuffer(points).reshape(-1, rules.POINT_WIDTH)
            self.make_room(len(found))
            self.blocks[place, : len(found)] = found

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name, see `Detector`."""
        known.settle(self.record)
        self._latest[:] = [self.odometry.copy()]  # it belongs to the publication
        stored = known.used(int(self.record[0]["stored"]), 0, known.KEPT)
        places = zip(self.record[0]["blocks"][:stored], self.record[0]["counts"], strict=False)
        points = {f"trajectories[{index}]": self.blocks[place, :count] for index, (place, count) in enumerate(places)}
        vehicle = {"vehicle": floats(self.odometry, _VEHICLE_FLOATS)}
        return {**known.named(self.record), **vehicle, **points, **self.estimates.arrays()}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without machine code, which is valid in one process only."""
        return AcceptanceTest, (self.limits,), self.memory()

    __setstate__ = restore


class Rule(NamedTuple):
    """Rule for a state, given earlier publications.

    Attributes:
        judge: Index of the violating field among those of header and element, or -1; None = `check` calls the compiled
            function itself, provided that the state is read at all.
        note: Records a published value.
    """

    judge: Callable[[AcceptanceTest, State, int], int] | None
    note: Callable[[AcceptanceTest, State, int], None]


def _judge_status(test: AcceptanceTest, state: State, now: int) -> int:
    return int(test.judge_status(state.header, test.record))


def _note_status(test: AcceptanceTest, state: State, now: int) -> None:
    test.note_status(state.header, now, test.record)


def _judge_path(test: AcceptanceTest, state: State, now: int) -> int:
    vertices = _rows(state.elements, 3)
    return int(
        test.functions.judge_path(state.header, vertices, now, bytes_of(test.odometry), test.record, test.blocks)
    )


def _note_path(test: AcceptanceTest, state: State, now: int) -> None:
    test.functions.note_path(state.header, _rows(state.elements, 3), test.record)


def _judge_trajectory(test: AcceptanceTest, state: State, now: int) -> int:
    points = _rows(state.elements, rules.POINT_WIDTH)
    return int(test.functions.judge_trajectory(state.header, points, bytes_of(test.odometry), test.record))


def _note_trajectory(test: AcceptanceTest, state: State, now: int) -> None:
    test.make_room(len(state.elements))
    points = _rows(state.elements, rules.POINT_WIDTH)
    test.functions.note_trajectory(state.header, points, test.record, test.blocks)


def _judge_waypoint(test: AcceptanceTest, state: State, now: int) -> int:
    test.candidate = state
    return int(test.judge_waypoint(state.header, bytes_of(test.odometry), test.record, test.blocks))


def _note_candidate(test: AcceptanceTest, state: State, now: int) -> None:
    """Record a header other than the one checked last: checking it makes it the candidate."""
    test.check(state, now)
    if state is test.candidate:
        test.accept(state, now)


RULES: dict[str, Rule] = {
    ODOMETRY["estimator"]: Rule(
        lambda test, *given: test.estimates.check(*given), lambda test, *given: test.estimates.accept(*given)
    ),
    _STATUS: Rule(_judge_status, _note_status),
    "planning.path": Rule(_judge_path, _note_path),
    "planning.trajectory": Rule(_judge_trajectory, _note_trajectory),
    _WAYPOINT: Rule(_judge_waypoint, _note_candidate),
    _COMMAND: Rule(None, _note_candidate),
    _TRACKING: Rule(None, _note_candidate),
}
"""Rules by the name of their state in `STATES`; states without a rule are not checked."""


def _rows(elements: np.ndarray, width: int) -> np.ndarray:
    return floats(elements, width).reshape(-1, width)


def _alarm(state: State, place: int) -> Alarm:
    spec = state.spec
    field = (*spec.header, *spec.elements)[place].name
    return Alarm(SOURCE, spec.stage.value, score=IMPLAUSIBLE, fields=(f"{spec.name}.{field}",), hard=True)
