"""The decision table of recovery, and the wait for a path, against tables in words."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.config import AutopilotConfig, shipped
from mavfi.detectors import Alarm
from mavfi.flight.decide import (
    GAP_US,
    INLINE,
    MAX_RESTARTS,
    PERSISTS_US,
    RESTART_US,
    SCANNING,
    SHARE,
    VALID_S,
    Action,
    History,
    HoldMemory,
    HoldPosition,
    Origin,
    PathDeadline,
    PathWait,
    RecoveryPolicy,
    Rejection,
    Response,
    decide,
    decide_overdue,
)
from mavfi.kernels.perception.collision_check import NO_COLLISION
from mavfi.states import STATES, Stage, new_state

BOTH = (False, True)
STATUS, PATH, WAYPOINT, COMMAND = (
    "perception.collision_status",
    "planning.path",
    "planning.waypoint",
    "control.command",
)
RECOMPUTE, CONTROL, PLANNING, PERCEPTION = Response.RECOMPUTE, Stage.CONTROL, Stage.PLANNING, Stage.PERCEPTION
CASES = [
    (Alarm("d", "control"), COMMAND, Action(RECOMPUTE, CONTROL, "pid", ("pid",), COMMAND, True)),
    (Alarm("d", "planning"), WAYPOINT, Action(RECOMPUTE, PLANNING, "waypoint", ("waypoint",), WAYPOINT, True)),
    (
        Alarm("d", "perception"),
        "perception.map_update",
        Action(RECOMPUTE, PERCEPTION, SCANNING[0], SCANNING, "perception.map_update", True),
    ),
    (
        Alarm("d", "perception"),
        "perception.odometry",
        Action(RECOMPUTE, PERCEPTION, "state_estimation", ("state_estimation",), "perception.odometry", True),
    ),
    (Alarm("d", "control"), WAYPOINT, Action(RECOMPUTE, CONTROL, "pid", ("pid",))),
    (Alarm("d", "planning"), COMMAND, Action(RECOMPUTE, PLANNING)),
    (Alarm("d", "perception"), "sensor.odometry", Action(RECOMPUTE, PERCEPTION)),
    (
        Alarm("d", "control", abandon_waypoint=True),
        COMMAND,
        Action(Response.ABANDON, CONTROL, "waypoint", (), WAYPOINT),
    ),
    (Alarm("d", "control", stop=True), WAYPOINT, Action(Response.STOP, CONTROL, "waypoint", (), WAYPOINT, True)),
    (
        Alarm("d", "control", abandon_waypoint=True, withhold=True),
        COMMAND,
        Action(Response.ABANDON, CONTROL, "waypoint", (), COMMAND, True),
    ),
    (
        Alarm("d", "control", stop=True, withhold=True),
        COMMAND,
        Action(Response.STOP, CONTROL, "waypoint", (), COMMAND, True),
    ),
]


def answer(alarm, state, policy=INLINE, origin=Origin.STEP, history=None, now=0):
    return decide(Rejection(alarm, STATES[state], origin, now), history or History(), policy)


@pytest.mark.parametrize(("alarm", "state", "expected"), CASES)
def test_the_answer_to_an_alarm(alarm, state, expected):
    assert answer(alarm, state) == expected


@pytest.mark.parametrize(("alarm", "state", "expected"), CASES)
def test_an_observer_asks_for_the_same_and_holds_nothing_back(alarm, state, expected):
    response = answer(alarm, state, RecoveryPolicy("observer"))
    assert not response.withholds
    assert (response.kind, response.kernel, response.restores, response.awaited) == (
        expected.kind,
        expected.kernel,
        expected.restores,
        expected.awaited,
    )


def test_a_message_that_is_wrong_twice_is_computed_again():
    policy, alarm = RecoveryPolicy(grain="message", same_twice="escalate"), Alarm("d", "perception", hard=True)
    assert answer(alarm, STATUS, policy) == Action(Response.RESEND, PERCEPTION, awaited=STATUS, withholds=True)
    assert answer(alarm, STATUS, policy, Origin.RESENT) == Action(
        RECOMPUTE, PERCEPTION, "collision_check", ("collision_check",), STATUS, True, alone=True
    )


def test_an_alarm_has_the_first_response_that_applies():
    flags = itertools.product(*[BOTH] * 7)
    for hard, degrades, persists, stop, abandon, has_kernel, resends in flags:
        for origin, left in itertools.product(Origin, (0, 1, MAX_RESTARTS)):
            policy = RecoveryPolicy(
                grain="message" if resends else "stage",
                same_twice="escalate",
                degraded="hold" if degrades else "none",
            )
            now = 1_000_000 + PERSISTS_US + persists
            history = History(restarts_left=left, first_us=1_000_000, last_us=now - GAP_US)
            alarm = Alarm(
                "d", "perception" if has_kernel else "control", hard=hard, stop=stop, abandon_waypoint=abandon
            )
            recomputed = origin is Origin.RECOMPUTED
            applies = {
                Response.HOLD: hard and degrades and (persists or (recomputed and left == 0)),
                None: (origin is not Origin.STEP and not hard) or (recomputed and left == 0),
                Response.RESTART: recomputed,
                Response.STOP: stop,
                Response.ABANDON: abandon,
                Response.RESEND: has_kernel and resends and origin is Origin.STEP,
                Response.RECOMPUTE: True,
            }
            response = answer(alarm, STATUS, policy, origin, history, now)
            assert (None if response is None else response.kind) is next(kind for kind in applies if applies[kind])


@pytest.mark.parametrize("gap", BOTH)
def test_a_gap_begins_a_new_series_of_alarms(gap):
    history = History()
    for now in (1_000_000, 1_400_000):
        history.extend_series(now)
    later = 1_400_000 + GAP_US + gap
    history.extend_series(later)
    assert (history.first_us, history.last_us) == (later if gap else 1_000_000, later)


@pytest.mark.parametrize(
    ("left", "degraded", "expected"),
    [(1, "none", "restart"), (1, "hold", "restart"), (0, "none", None), (0, "hold", "hold")],
)
def test_an_overdue_path_restarts_the_planner_while_a_restart_is_left(left, degraded, expected):
    response = decide_overdue(History(restarts_left=left), RecoveryPolicy(answer_s=0.6, degraded=degraded))
    assert (None if response is None else response.kind) == expected
    if expected == "restart":
        assert response == Action(Response.RESTART, PLANNING, "planner", withholds=True)


def test_each_restart_takes_three_times_as_long():
    downs = [History(restarts_left=left).down_time() for left in range(MAX_RESTARTS, 0, -1)]
    assert downs == [RESTART_US * 3**number for number in range(MAX_RESTARTS)]


# ---- the wait for a path --------------------------------------------------------------------------------------------
def status(number, flag=False, time=2.0, blocked=5.0):
    state = new_state(STATUS)
    state.header["future_collision_seq"], state.header["collision"] = number, flag
    state.header["time_to_collision"], state.header["distance_to_blocked"] = time, blocked
    return state


def path(number):
    state = new_state(PATH, 2)
    state.header["future_collision_seq"] = number
    return state


def waypoint(index):
    state = new_state(WAYPOINT)
    state.header["index"] = index
    return state


def deadline(alarm="repeated"):
    return PathDeadline(0.6, shipped("autopilots", AutopilotConfig, "published").model_copy(update={"alarm": alarm}))


@pytest.mark.parametrize("waiting", BOTH)
@pytest.mark.parametrize("down", BOTH)
@pytest.mark.parametrize("late", BOTH)
@pytest.mark.parametrize(
    ("state", "ends"),
    [
        (path(3), True),
        (path(4), True),
        (path(2), False),
        (status(3), False),
        (status(3, flag=True), False),
        (status(3, time=NO_COLLISION, blocked=math.inf), True),
        (status(2, time=NO_COLLISION, blocked=math.inf), False),
    ],
)
def test_a_wait_begins_with_an_alarm_and_ends_with_an_answer_or_its_deadline(waiting, down, late, state, ends):
    since, now = (1_000_000 if waiting else None), 1_600_000 + late
    wait = PathWait(since, 3, 3, waypoint(0))
    waited = deadline().overdue(wait, state, now, planner_is_down=down)
    is_path, is_alarm = state.spec.name == PATH, state.spec.name == STATUS and bool(state.header["collision"][0])
    overdue = waiting and late and not (ends or down or is_path)
    assert waited == (pytest.approx(0.600001) if overdue else None)
    if not waiting:
        assert wait.since_us == (now if is_alarm else None)
    elif ends or overdue:
        assert wait.since_us is None
    else:
        assert wait.since_us == (now if down and not is_path else since)


V_MAX = 3.0
reals = st.floats(-1e3, 1e3)
points = st.tuples(reals, reals, reals)


@given(points, points, st.floats(0.1, 10.0))
def test_a_command_points_to_the_target_and_is_limited(position, target, v_max):
    row = HoldPosition(v_max).command(HoldMemory(list(position), list(target)), new_state("control.command")).header[0]
    velocity, way = np.array([row["vx"], row["vy"], row["vz"]]), np.subtract(target, position)
    assert np.linalg.norm(velocity) == pytest.approx(min(np.linalg.norm(way), SHARE * v_max))
    assert np.allclose(np.cross(velocity, way), 0.0, atol=1e-6 * (1.0 + np.linalg.norm(way)))
    assert velocity @ way >= 0.0


def odometry(position):
    state = new_state("sensor.odometry")
    for name, value in zip("xyz", position, strict=True):
        state.header[name] = value
    return state


def test_the_vehicle_returns_to_where_the_mode_began():
    hold, memory = HoldPosition(V_MAX), HoldMemory()
    hold.note(memory, odometry((1.0, 2.0, 3.0)))
    hold.begin(memory)
    position = np.array([5.0, -1.0, 3.0])
    for _ in range(500):
        hold.note(memory, odometry(position))
        row = hold.command(memory, new_state("control.command")).header[0]
        assert row["duration"] == VALID_S and row["yaw_rate"] == 0.0
        position = position + 0.02 * np.array([row["vx"], row["vy"], row["vz"]])
    assert np.allclose(position, (1.0, 2.0, 3.0), atol=0.01)


def test_without_a_finite_position_it_hovers():
    hold, memory = HoldPosition(V_MAX), HoldMemory()
    hold.note(memory, odometry((math.nan, 0.0, 0.0)))
    hold.begin(memory)
    assert hold.command(memory, new_state("control.command")) is None
