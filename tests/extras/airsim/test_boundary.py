"""Faults and a detector at the boundary."""

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.airsim.boundary import ApiRecording, Boundary, parse_fault

VELOCITY = [1.0, 2.0, 0.0, 5.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, ""]


def call(boundary, name, arguments, result, now_us=0):
    arguments = boundary.arguments(name, arguments, now_us)
    return arguments, boundary.returned(name, arguments, result, now_us)


def test_an_argument_is_changed_once_from_its_instant_on():
    boundary = Boundary(parse_fault("moveByVelocity.vy:bit=63@2"))
    assert call(boundary, "moveByVelocity", list(VELOCITY), True, 1_999_999)[0] == VELOCITY
    assert call(boundary, "hover", [""], True, 3_000_000)[0] == [""]
    assert call(boundary, "moveByVelocity", list(VELOCITY), True, 3_000_000)[0][:3] == [1.0, -2.0, 0.0]
    assert call(boundary, "moveByVelocity", list(VELOCITY), True, 4_000_000)[0] == VELOCITY
    injection = boundary.injection
    assert (injection.time_s, injection.bit, injection.before, injection.after, injection.activated) == (
        3.0,
        63,
        2.0,
        -2.0,
        True,
    )


@pytest.mark.parametrize(
    ("text", "name", "arguments", "after"),
    [
        ("moveByVelocity.vx:bit=62", "moveByVelocity", [2, 0, 0, 1, 0, {}, ""], 0.0),
        ("moveByVelocity.drivetrain:bit=1", "moveByVelocity", [2, 0, 0, 1, 0, {}, ""], 2),
        ("moveByVelocity.yaw_mode.is_rate:bit=0", "moveByVelocity", [2, 0, 0, 1, 0, {"is_rate": True}, ""], False),
        ("moveOnPath.path.0.x_val:bit=63", "moveOnPath", [[{"x_val": 3}]], -3.0),
        ("simPlotPoints.arguments#0:bit=1", "simPlotPoints", [1], 3),
    ],
)
def test_a_number_has_the_type_of_airsim_s_signature_however_the_program_writes_it(text, name, arguments, after):
    boundary = Boundary(parse_fault(text))
    boundary.arguments(name, arguments, 0)
    assert boundary.injection.after == after and type(boundary.injection.after) is type(after)


@pytest.mark.parametrize(
    "text", ["simGetVehiclePose.return.position.x_val:bit=63#2", "simGetVehiclePose.return#0:bit=63#2"]
)
def test_a_returned_value_is_changed_in_the_nth_call(text):
    boundary = Boundary(parse_fault(text))
    for wanted in (1.0, -1.0, 1.0):
        _, result = call(boundary, "simGetVehiclePose", [""], {"position": {"x_val": 1.0}})
        assert result["position"]["x_val"] == wanted
    assert boundary.injection.details["number"] == 2


@pytest.mark.parametrize(
    "text", ["moveOnPath.path.9.x_val:bit=1", "simGetVehiclePose.return.none:bit=1", "hover.return#7"]
)
def test_a_number_that_is_not_there_leaves_the_fault_not_activated(text):
    boundary = Boundary(parse_fault(text))
    call(boundary, text.partition(".")[0], [[]], {"position": 1.0})
    assert boundary.injection is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nonsense", "allowed: CALL.PATH"),
        ("fly.x:bit=1", "call 'fly': not known"),
        ("moveByVelocity.speed:bit=1", "'speed': not known; allowed: vx, vy, vz, duration"),
        ("moveByVelocity.vx:bit=64", "bit 64: allowed: 0 to 63"),
        ("moveByVelocity.vx:bit=1@-3", "start_s: -3.0: allowed: 0 or more"),
        ("moveByVelocity.vx:bit=1#0", "allowed: CALL.PATH"),
        ("moveByVelocity.arguments:bit=1", "'arguments': not known; allowed: vx"),
        ("moveByVelocity.arguments#:bit=1", "allowed: CALL.PATH"),
        ("moveByVelocity:reorder", "reorder: calls are answered in order; allowed: drop, delay, duplicate, freeze"),
        ("moveByVelocity:set=nan", "set: allowed: drop, delay, duplicate, freeze, reorder"),
        ("moveByVelocity.vx:drop", "drop: allowed: flip, set, bias, scale, freeze"),
        ("moveByVelocity.speed:set=nan", "'speed': not known; allowed: vx"),
    ],
)
def test_what_cannot_be_is_refused(text, message):
    with pytest.raises(BadInputError, match=message):
        parse_fault(text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("moveByVelocity.vx:set=nan:times=2@2", [0, 1, np.nan, np.nan, 4]),
        ("moveByVelocity.vx:bias=0.5:every=2@1..4", [0, 1.5, 2, 3.5, 4]),
        ("moveByVelocity.vx:scale=-1@n=4", [0, 1, 2, -3, 4]),
        ("moveByVelocity.vx:freeze@vx>1", [0, 1, 2, 2, 2]),
        ("moveByVelocity.arguments#0:bit=63:times=0@n=4", [0, 1, 2, -3, -4]),
    ],
)
def test_operations_change_a_number_in_the_calls_that_their_trigger_selects(text, expected):
    boundary = Boundary(parse_fault(text))
    calls = [call(boundary, "moveByVelocity", [x, *VELOCITY[1:]], True, 1_000_000 * x)[0] for x in range(5)]
    np.testing.assert_array_equal([arguments[0] for arguments in calls], expected)
    changed = ~np.equal(expected, range(5)) | np.array(["freeze" in text and x == 2 for x in range(5)])
    assert boundary.injection.details["calls"] == changed.sum()
    assert boundary.injection.details["number"] == 1 + np.flatnonzero(changed)[0]
    assert boundary.injection.details["path"] == "vx"


def test_an_operation_that_the_number_does_not_allow_leaves_the_fault_not_activated():
    boundary = Boundary(parse_fault("moveByVelocity.yaw_mode.is_rate:bias=1"))
    assert call(boundary, "moveByVelocity", list(VELOCITY), True)[0] == VELOCITY and boundary.injection is None


def test_the_seed_draws_the_bit_that_is_not_named():
    drawn = {parse_fault("moveByVelocity.vx", seed).fault.bit for seed in range(40)}
    assert len(drawn) > 20 and parse_fault("moveByVelocity.vx", 3) == parse_fault("moveByVelocity.vx", 3)


def test_a_detector_learns_normal_calls_and_names_the_number_that_is_not():
    recording, random = ApiRecording(), np.random.default_rng(1)
    calls = [[float(x), float(y), 0.0, 1.0] for x, y in random.normal(2.0, 0.1, (200, 2))]
    for arguments in calls:
        call(Boundary(recording=recording), "moveByVelocity", list(arguments), True)
    watch = recording.train("gaussian", "paper")
    boundary = Boundary(parse_fault("moveByVelocity.vx:bit=61#20"), watch=watch)
    for number, arguments in enumerate(calls[:60]):
        call(boundary, "moveByVelocity", list(arguments), True, 20_000 * number)
    assert {alarm.state for alarm in watch.alarms} == {"moveByVelocity(arguments)"} and len(watch.alarms) < 4
    assert watch.alarms[0].time_s == pytest.approx(0.38) and "vx" in watch.alarms[0].fields[0]


def test_too_few_calls_teach_nothing():
    with pytest.raises(BadInputError, match="no number to monitor"):
        ApiRecording().train("gaussian", "paper")
