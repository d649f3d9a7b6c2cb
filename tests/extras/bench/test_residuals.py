"""Residuals against plain formulas on whole columns, on the publications of a flight."""

import numpy as np
import pytest

from mavfi.extras.bench.field_codes import QUANTA, CodeRecorder, FieldCodes, sample_of
from mavfi.flight.fly import fly
from mavfi.states import AUTOPILOTS, floats, rows
from tests.core.flights.missions import mission


def octave(values):
    size = np.log2(np.clip(np.abs(values), 0.25, 64.0))
    return np.where(values < 0, -20.0 - size, size)


def turn(angles):
    return np.angle(np.exp(1j * np.asarray(angles)))


def apart(places, other):
    return np.abs(np.asarray(places) - other).max(axis=-1)


@pytest.fixture(scope="module", params=AUTOPILOTS)
def flown(request):
    recorder, published = CodeRecorder(request.param), []
    fly(mission(request.param), recorders=[recorder.accept, lambda state, now: published.append(state)])
    field_codes = FieldCodes(request.param)
    return request.param, field_codes, sample_of(recorder.recording(), field_codes), published


def column(flown, state, name):
    """Residuals of all publications of a state, in its unit, as they were measured."""
    _, field_codes, sample, _ = flown
    index = field_codes.fields.index(f"{state}.{name}")
    return sample.vectors[sample.slots == field_codes.slots[state], index] * field_codes.quanta[index]


def of(flown, state):
    return [state_ for state_ in flown[3] if state_.spec.name == state]


def before_each(flown, state, kinds):
    """The last publication of one of some states before each one of another."""
    last, earlier = None, []
    for published in flown[3]:
        if published.spec.name == state:
            earlier.append(last)
        if published.spec.name in kinds:
            last = published
    return earlier


def field(states, name):
    return np.array([state.header[name][0] for state in states]).astype(float)


def check(flown, state, name, expected, quantum):
    assert column(flown, state, name) == pytest.approx(np.asarray(expected), abs=0.51 * quantum), name


def test_command_and_tracking(flown):
    commands = of(flown, "control.command")
    for name in ("vx", "vy", "vz", "yaw_rate", "duration"):
        quantum = QUANTA["s"] if name == "duration" else 0.01
        check(flown, "control.command", name, np.diff(field(commands, name), prepend=commands[0].header[name]), quantum)
    if flown[0] == "published":
        expected, duration, left, fresh = [], 0.0, 0.0, False
        for state in flown[3]:
            if state.spec.name == "planning.waypoint":
                duration, fresh = state.header["duration"][0], True
            elif state.spec.name == "control.tracking":
                value = state.header["remaining"][0]
                expected.append(value - (duration if fresh else left))
                left, fresh = value, False
        check(flown, "control.tracking", "remaining", expected, QUANTA["s"])


def test_way_points(flown):
    points = of(flown, "planning.waypoint")
    motions = before_each(flown, "planning.waypoint", ("sensor.odometry",))
    numbers = np.array([floats(point.header, 11) for point in points])
    number, index = field(points, "trajectory_seq"), field(points, "index")
    expected = {name: np.zeros(len(points)) for name in ("x", "y", "z", "vx", "vy", "vz", "index")}
    for k in range(1, len(points)):
        same = number[k] == number[k - 1]
        start = (
            numbers[k - 1, :7] if same else np.r_[floats(motions[k].header, 6)[:3], 0, floats(motions[k].header, 6)[3:]]
        )
        for axis, name in enumerate("xyz"):
            expected[name][k] = numbers[k, axis] - start[axis] - numbers[k, 4 + axis] * numbers[k, 10]
            expected[f"v{name}"][k] = numbers[k, 4 + axis] - start[4 + axis]
        expected["index"][k] = 0 if index[k] == -1 else index[k] - (index[k - 1] + 1 if same else 0)
    for name, values in expected.items():
        check(flown, "planning.waypoint", name, values, 1.0 if name == "index" else 0.01)
    check(flown, "planning.waypoint", "yaw", turn(np.diff(numbers[:, 3], prepend=numbers[0, 3])), 0.01)


def test_collision_status(flown):
    statuses = of(flown, "perception.collision_status")
    growth = np.diff(field(statuses, "future_collision_seq"), prepend=0)
    check(flown, "perception.collision_status", "future_collision_seq", growth, 1.0)
    check(flown, "perception.collision_status", "collision", field(statuses, "collision") - (growth > 0), 1.0)
    for name in ("time_to_collision", "distance_to_blocked", "distance_to_unknown"):
        values = octave(field(statuses, name))
        index = flown[1].fields.index(f"perception.collision_status.{name}")
        expected = np.diff(values, prepend=values[0]) * (flown[1].quanta[index] > 0)
        check(flown, "perception.collision_status", name, expected, 0.01)


def test_paths_and_trajectories(flown):
    field_codes = [s for s in flown[3] if s.spec.name in ("planning.path", "planning.trajectory", "sensor.odometry")]
    wanted = {name: [] for name in ("detour", "start", "entry_speed", "step", "change", "turn", "from", "speed", "end")}
    motion = path = None
    for state in field_codes:
        if state.spec.name == "sensor.odometry":
            motion = floats(state.header, 6)
        elif state.spec.name == "planning.path":
            path = vertices = rows(state.elements, 3)
            legs = np.sqrt((np.diff(vertices, axis=0) ** 2).sum(axis=1)).sum()
            line = np.sqrt(((vertices[-1] - vertices[0]) ** 2).sum()) if len(vertices) else 0.0
            wanted["detour"].append(legs - line)
            wanted["start"].append(apart(vertices[0], motion[:3]) if len(vertices) else 0.0)
            entry = state.header["entry_speed"][0]
            wanted["entry_speed"].append(entry - np.sqrt((motion[3:] ** 2).sum()) if entry else 0.0)
        else:
            points = rows(state.elements, 11)
            steps = np.diff(points[:, :3], axis=0) - points[1:, 4:7] * points[1:, 10:]
            wanted["step"].append(np.abs(steps).max(initial=0.0))
            wanted["change"].append(np.abs(np.diff(points[:, 4:7], axis=0)).max(initial=0.0))
            wanted["turn"].append(np.abs(turn(np.diff(points[:, 3]))).max(initial=0.0))
            wanted["speed"].append(np.abs(points[:, 4:7]).max(initial=0.0))
            wanted["from"].append(apart(points[0, :3], motion[:3]) if len(points) else 0.0)
            wanted["end"].append(apart(points[-1, :3], path[-1]) if len(points) else 0.0)
    for name in ("detour", "start", "entry_speed"):
        check(flown, "planning.path", name, wanted[name], 0.01)
    for name in ("step", "change", "turn", "speed", "end"):
        check(flown, "planning.trajectory", name, wanted[name], 0.01)
    check(flown, "planning.trajectory", "start", wanted["from"], 0.01)
