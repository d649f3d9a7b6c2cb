from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.detectors import rules
from mavfi.detectors.acceptance import CHECKED, COMPILED, SOURCE, AcceptanceTest
from mavfi.detectors.estimates import ESTIMATE
from mavfi.detectors.registry import load_detector
from mavfi.errors import BadInputError
from mavfi.states import STATES, floats, new_state, rows
from tests.core.unit.detectors.streams import LIMITS, odometry
from tests.core.unit.detectors.test_registry import FITS

STATUS, PATH, TRAJECTORY = "perception.collision_status", "planning.path", "planning.trajectory"
WAYPOINT, COMMAND, TRACKING = "planning.waypoint", "control.command", "control.tracking"
NOW = 2_000_000
HERE, SPEED = np.array([10.0, 0.0, 3.0]), np.array([2.0, 0.0, 0.0])
START = {"published": HERE + [0.5, 0.0, 0.0], "hardened": HERE}


def make(name, count=0, **fields):
    """A state; fields of all elements, or of the header with a leading underscore where elements have that name too."""
    state = new_state(name, count)
    for field, value in fields.items():
        (state.elements if count and field in state.elements.dtype.names else state.header)[field] = value
    return state


def status(counter=1, flag=False, time=30.0, **fields):
    free = {"distance_to_blocked": 9.0 if flag else np.inf, "distance_to_unknown": np.inf, "trajectory_seq": -1}
    return make(STATUS, future_collision_seq=counter, collision=flag, time_to_collision=time, **{**free, **fields})


def points(autopilot, count=6):
    """A straight line at 2 m/s from next to the vehicle on."""
    period = LIMITS[autopilot].point_period
    state = make(TRAJECTORY, count, trajectory_seq=1, future_collision_seq=1, y=0.0, z=3.0, vx=2.0, duration=period)
    state.elements["x"] = START[autopilot][0] + 2.0 * period * np.arange(count)
    state.elements["x"][-1], state.elements["vx"][-1] = state.elements["x"][-2], 0.0
    return state


def line(autopilot, junction=-1, epoch=1, entry_speed=0.0):
    state = make(PATH, 3, future_collision_seq=epoch, entry_speed=entry_speed, junction=junction, z=3.0)
    state.elements["x"] = START[autopilot][0], 20.0, 30.0
    return state


def short(state, autopilot):
    """A path that ends where the trajectory of `points` does."""
    state.elements["x"][-1] = points(autopilot).elements["x"][-1]
    return state


def step_of(autopilot, index, share=0.0, trajectory=1):
    """The way-point that a trajectory's point becomes; interpolated, by a share of the way to the next."""
    state = make(WAYPOINT, trajectory_seq=trajectory, future_collision_seq=1, index=index)
    numbers = rows(points(autopilot).elements, 11)
    floats(state.header, 11)[:] = (
        numbers[index]
        if autopilot == "published"
        else numbers[index] + share * (numbers[index + 1] - numbers[index]) * (np.arange(11) < 3)
    )
    return state


def held(autopilot):
    period, lag = LIMITS[autopilot].point_period, 0.4 * (autopilot == "published")
    x, y, z = HERE + lag * SPEED
    return make(WAYPOINT, x=x, y=y, z=z, yaw=3.5, duration=period, index=-1, future_collision_seq=1)


def drive(vx=2.0, vy=0.0, yaw_rate=0.5, duration=0.02):
    return make(COMMAND, vx=vx, vy=vy, yaw_rate=yaw_rate, duration=duration)


def flying(autopilot, *more, functions=COMPILED):
    """In flight: alarm 1 was answered by trajectory 1, the way-point in force is its point 1."""
    detector = AcceptanceTest(LIMITS[autopilot])
    detector.instrument(functions)
    detector.start()
    before = (
        odometry(HERE, SPEED),
        status(1, True, 5.0),
        short(line(autopilot), autopilot),
        points(autopilot),
        step_of(autopilot, 0),
        step_of(autopilot, 1),
        drive(),
        make(TRACKING, remaining=0.3),
    )
    for state in (*before, *more):
        detector.accept(state, NOW - 500_000)
    return detector


def good(autopilot):
    """What may come next, by what it shows."""
    interpolated = autopilot == "hardened"
    second = points(autopilot)
    second.header["trajectory_seq"] = 2
    common = {
        "no collision": (status(), ()),
        "a new collision": (status(2, True, 4.0), ()),
        "path": (line(autopilot, 0 if interpolated else -1, entry_speed=2.5), ()),
        "path to a new alarm": (line(autopilot, 0 if interpolated else -1, 2), (status(2, True, 4.0),)),
        "no path": (make(PATH, future_collision_seq=1), ()),
        "trajectory": (second, ()),
        "no trajectory": (make(TRAJECTORY, trajectory_seq=2, future_collision_seq=1), ()),
        "next point": (step_of(autopilot, 2), ()),
        "hold": (held(autopilot), ()),
        "first point": (step_of(autopilot, 0, trajectory=2), (second,)),
        "command": (drive(2.2), ()),
        "command at a new way-point": (drive(-2.2), (step_of(autopilot, 2),)),
        "tracking": (make(TRACKING, remaining=0.28), ()),
        "tracking of a step computed again": (make(TRACKING, remaining=0.3), ()),
        "tracking of a new way-point": (make(TRACKING, remaining=0.47), (step_of(autopilot, 2),)),
    }
    back = make(PATH, 3, future_collision_seq=1, junction=-1, z=3.0)
    back.elements["x"] = 10.0, 8.0, 6.0
    of_profile = {
        "between two points": (step_of(autopilot, 1, 0.5), ()),
        "the way back": (back, ()),
        "known space of the trajectory": (status(trajectory_seq=1, distance_to_unknown=4.0), ()),
    }
    return common | (of_profile if interpolated else {})


GOOD = [(autopilot, case) for autopilot in LIMITS for case in good(autopilot)]


@pytest.mark.parametrize(("autopilot", "case"), GOOD)
def test_what_a_flight_publishes_passes(autopilot, case):
    state, before = good(autopilot)[case]
    assert flying(autopilot, *before).check(state, NOW) is None


BOTH = tuple(LIMITS)
FIRST, NEW = ("published",), ("hardened",)
BROKEN = [
    (BOTH, "no collision", "time_to_collision", np.nan),
    (BOTH, "a new collision", "time_to_collision", 100.0),
    (BOTH, "no collision", "time_to_collision", 15.0),
    (BOTH, "no collision", "future_collision_seq", -(2**31) + 1),
    (BOTH, "a new collision", "future_collision_seq", 3),
    (BOTH, "no collision", "collision", True),
    (BOTH, "a new collision", "collision", False),
    (NEW, "no collision", "distance_to_blocked", 5.0),
    (NEW, "no collision", "distance_to_unknown", np.nan),
    (NEW, "known space of the trajectory", "trajectory_seq", 9),
    (BOTH, "path", "future_collision_seq", 0),
    (BOTH, "path", "future_collision_seq", 3),
    (BOTH, "path to a new alarm", "future_collision_seq", 0),
    (BOTH, "path", "entry_speed", 4.4),
    (BOTH, "path", "entry_speed", np.nan),
    (NEW, "path", "junction", 3),
    (BOTH, "path", ("x", 1), 70.0),
    (BOTH, "path", ("y", 1), np.inf),
    (BOTH, "path", ("z", 1), -3.0),
    (BOTH, "path", ("x", 0), 15.0),
    (NEW, "path", "junction", -2),
    (BOTH, "path", ("x", 2), 20.0),
    (NEW, "the way back", ("x", 2), 1.0),
    (BOTH, "trajectory", "trajectory_seq", 3),
    (BOTH, "trajectory", "trajectory_seq", 1),
    (BOTH, "trajectory", "future_collision_seq", 0),
    (BOTH, "trajectory", ("x", 2), np.nan),
    (NEW, "trajectory", ("az", 2), 1e3),
    (BOTH, "trajectory", ("y", 2), 12.5),
    (BOTH, "trajectory", ("yaw", 2), 4.0),
    (BOTH, "trajectory", ("vx", 2), 5.0),
    (BOTH, "trajectory", ("duration", 1), 0.001),
    (BOTH, "trajectory", ("duration", 5), 0.0),
    (BOTH, "trajectory", ("y", 3), 1.5),
    (BOTH, "next point", "trajectory_seq", 2),
    (BOTH, "next point", "index", 5),
    (BOTH, "next point", "index", 0),
    (FIRST, "next point", "future_collision_seq", 0),
    (FIRST, "next point", "future_collision_seq", 2),
    *((BOTH, "next point", name, 7.5) for name in ("x", "y", "z", "yaw", "vx", "vy", "vz", "duration")),
    (FIRST, "next point", "ax", 0.1),
    (NEW, "next point", "ax", 8.0),
    (NEW, "between two points", "x", 10.01),
    (NEW, "between two points", "vx", 2.1),
    (FIRST, "first point", "index", 1),
    (NEW, "first point", "index", 50),
    (BOTH, "hold", "x", 12.0),
    (BOTH, "hold", "yaw", 4.1),
    (BOTH, "hold", "vz", 0.1),
    (BOTH, "hold", "ay", np.nan),
    (BOTH, "hold", "trajectory_seq", 1),
    (BOTH, "hold", "index", 2),
    (BOTH, "command", "vx", 3.3),
    (BOTH, "command", "vy", np.nan),
    (BOTH, "command", "yaw_rate", 1.6),
    (BOTH, "command", "duration", 0.04),
    (FIRST, "command", "vx", 1.6),
    (FIRST, "tracking", "remaining", 0.301),
    (FIRST, "tracking of a new way-point", "remaining", 0.5),
    (FIRST, "tracking of a new way-point", "remaining", 0.45),
]


def broken(autopilot, case, field, value):
    state, before = good(autopilot)[case]
    state = state.copy()
    if isinstance(field, tuple):
        field, element = field
        state.elements[field][element] = value
    else:
        state.header[field] = value
    return state, before, field


MUTANTS = [(autopilot, *rest) for autopilots, *rest in BROKEN for autopilot in autopilots]


@pytest.mark.parametrize(("autopilot", "case", "field", "value"), MUTANTS)
def test_one_value_that_breaks_a_rule_is_a_hard_alarm_that_names_it(autopilot, case, field, value):
    state, before, name = broken(autopilot, case, field, value)
    alarm = flying(autopilot, *before).check(state, NOW)
    assert alarm is not None
    assert (alarm.source, alarm.stage, alarm.hard) == (SOURCE, STATES[state.spec.name].stage, True)
    assert alarm.score > 1.0 and alarm.fields == (f"{state.spec.name}.{name}",)


def test_every_consumed_state_but_map_and_cloud_has_a_rule_and_every_rule_a_mutant():
    ours = {name for name, spec in STATES.items() if spec.stage in ("planning", "control") or spec.acted_on}
    assert set(CHECKED) == {*ours, ESTIMATE}, "those of the estimate are in test_estimates"
    assert {good(autopilot)[case][0].spec.name for autopilot, case, *_ in MUTANTS} == ours


def test_repeated_alarms_are_recognized_by_the_epoch_of_the_last_trajectory():
    again = status(2, True, 4.0)
    once = flying("published", again)
    assert once.check(again, NOW).fields == (f"{STATUS}.collision",)
    repeated = AcceptanceTest(replace(LIMITS["published"], repeated=True))
    repeated.accept(again, NOW)
    assert repeated.check(again, NOW) is None
    answer = make(TRAJECTORY, trajectory_seq=1, future_collision_seq=2)
    repeated.accept(answer, NOW)
    assert repeated.check(again, NOW).fields == (f"{STATUS}.collision",)


def test_nothing_is_left_of_a_way_point_before_there_is_one():
    detector = AcceptanceTest(LIMITS["published"])
    assert detector.check(make(TRACKING), 0) is None
    assert detector.check(make(TRACKING, remaining=0.1), 0).fields == (f"{TRACKING}.remaining",)


def naive_spike(vertices):
    for index in range(1, len(vertices) - 1):
        a, b, c = vertices[index - 1 : index + 2]
        to, onwards = b - a, c - b
        lengths = np.linalg.norm(to), np.linalg.norm(onwards)
        detour = sum(lengths) - np.linalg.norm(c - a)
        turns_back = to @ onwards < -0.5 * lengths[0] * lengths[1]
        if detour > 30.0 or (detour > 8.0 and turns_back):
            return index
    return -1


@given(st.lists(st.tuples(*[st.floats(-60.0, 60.0)] * 3), max_size=7))
def test_a_spike_is_a_long_detour_that_turns_back(points):
    vertices = np.array(points).reshape(-1, 3)
    index, column = naive_spike(vertices), rules.spike(vertices)
    assert (column >= 0) == (index >= 0)
    if index >= 0:
        away = np.abs(vertices[index] - (vertices[index - 1] + vertices[index + 1]) / 2)
        names = [field.name for field in (*STATES[PATH].header, *STATES[PATH].elements)]
        assert away["xyz".index(names[column])] == away.max()


def everything(autopilot):
    """All good and all broken publications, each with what comes before."""
    cases = [good(autopilot)[case] for case in good(autopilot)]
    return cases + [broken(profile, *rest)[:2] for profile, *rest in MUTANTS if profile == autopilot]


@pytest.mark.parametrize("autopilot", LIMITS)
def test_judging_changes_nothing_and_memory_is_restored(autopilot):
    for state, before in everything(autopilot):
        detector, other = flying(autopilot, *before), AcceptanceTest(LIMITS[autopilot])
        memory = detector.memory()
        alarm = detector.check(state, NOW)
        assert detector.memory() == memory == detector.memory()
        other.restore(memory)
        assert other.memory() == memory
        assert other.check(state, NOW) == alarm
        assert other.score(state, NOW) == (0.0 if alarm is None else alarm.score)
        detector.accept(state, NOW)
        assert detector.memory() != memory or detector.check(state, NOW) == alarm
        detector.start()
        assert detector.memory() == AcceptanceTest(LIMITS[autopilot]).memory()


def test_it_is_loaded_with_the_limits_of_the_mission():
    detector, model = load_detector(SOURCE, "paper", None, {**FITS, "limits": LIMITS["published"]})
    assert isinstance(detector, AcceptanceTest) and model == ""
    with pytest.raises(BadInputError, match="'acceptance': needs the limits of the mission"):
        load_detector(SOURCE, "paper", None, FITS)
