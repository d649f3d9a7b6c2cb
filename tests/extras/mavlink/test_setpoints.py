"""Set-points, take-off heights, missions in both forms, and parameters, as PX4 has them."""

import math
import struct

import pytest

mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega", reason="pymavlink is not installed")

from mavfi.extras.mavlink.px4 import FlightMode  # noqa: E402
from mavfi.extras.mavlink.vocabulary import MavResult  # noqa: E402
from mavfi.numerics.frames import HOME, geodetic  # noqa: E402
from tests.extras.mavlink.client import NAN, Client  # noqa: E402

pytestmark = pytest.mark.slow

POSITION_ONLY = 0b0000_1101_1111_1000
VELOCITY_ONLY = 0b0000_0101_1100_0111


def stream(client, message, seconds):
    """Send a set-point at 5 Hz, in mode offboard."""
    for _ in range(round(seconds / 0.2)):
        client.send(message)
        if client.autopilot.mode is not FlightMode.OFFBOARD:
            assert client.command(176, 1, 6) == MavResult.ACCEPTED
        client.wait(0.2)


def global_target(frame, mask, place=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0)):
    """A SET_POSITION_TARGET_GLOBAL_INT for latitude, longitude, and the altitude in the frame."""
    latitude, longitude, altitude = place
    integers = (round(1e7 * latitude), round(1e7 * longitude), altitude)
    fields = (*integers, *velocity, *acceleration, 0.0, 0.0)
    return mavlink.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, *fields)


def local_target(frame, mask, position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0)):
    fields = (*position, *velocity, *acceleration, 0.0, 0.0)
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *fields)


@pytest.mark.parametrize(("frame", "altitude"), [(0, 493.0), (5, 493.0), (3, 5.0), (6, 5.0), (10, 5.0), (11, 5.0)])
def test_global_positions_in_every_frame(flying, frame, altitude):
    latitude, longitude, _ = geodetic((6.0, 3.0, 0.0))
    stream(flying, global_target(frame, POSITION_ONLY, (latitude, longitude, altitude)), 8)
    assert flying.vehicle.position == pytest.approx((6.0, 3.0, -5.0), abs=0.3)


def test_global_velocities_and_heights_alone(flying):
    stream(flying, global_target(6, VELOCITY_ONLY, velocity=(0.0, 1.5, 0.0)), 4)
    assert flying.vehicle.velocity[1] == pytest.approx(1.5, abs=0.2)
    here = flying.vehicle.position
    stream(flying, global_target(6, POSITION_ONLY | 3, (0.0, 0.0, 6.0)), 6)
    assert flying.vehicle.position[2] == pytest.approx(-6.0, abs=0.3)
    assert flying.vehicle.position[0] == pytest.approx(here[0], abs=1.0), "latitude was ignored"


def test_positions_from_where_the_vehicle_is(flying):
    start = flying.vehicle.position
    flying.send(local_target(7, POSITION_ONLY, (2.0, 0.0, -1.0)))
    target = flying.autopilot._setpoint.position
    assert target == pytest.approx((start[0] + 2.0, start[1], start[2] - 1.0))
    flying.vehicle.place(start, (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)))  # nose to the east
    flying.send(local_target(9, POSITION_ONLY, (2.0, 0.0, 0.0)))
    north, east, _ = flying.autopilot._setpoint.position
    assert (north - start[0], east - start[1]) == pytest.approx((0.0, 2.0), abs=0.01)


@pytest.mark.parametrize(
    ("message", "note"),
    [
        (local_target(4, POSITION_ONLY), "SET_POSITION_TARGET_LOCAL_NED in frame 4"),
        (global_target(1, POSITION_ONLY), "SET_POSITION_TARGET_GLOBAL_INT in frame 1"),
        (local_target(1, 0b1100_0011_1111, acceleration=(1.0, 0.0, 0.0)), "type mask 3135"),
        (local_target(1, 0b1111_1111_1111), "type mask 4095"),
        (mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 64, [1, 0, 0, 0], 0, 0, 0, 0.5), "without a thrust"),
    ],
)
def test_set_points_that_are_not_flown_are_noted(client, message, note):
    client.send(message)
    assert len(client.autopilot.not_supported) == 1 and note in client.autopilot.not_supported[0]
    assert client.autopilot._setpoint is None


def test_an_acceleration_beside_a_velocity_is_noted_and_the_velocity_flown(flying):
    stream(flying, local_target(1, 0b1100_0000_0111, velocity=(1.0, 0, 0), acceleration=(0.5, 0, 0)), 3)
    assert flying.autopilot.not_supported == ["acceleration in SET_POSITION_TARGET_LOCAL_NED"]
    assert flying.vehicle.velocity[0] == pytest.approx(1.0, abs=0.2)


def test_set_points_before_mode_offboard_are_not_noted(flying):
    for _ in range(20):
        flying.send(local_target(1, VELOCITY_ONLY, velocity=(1.0, 0, 0)))
        flying.wait(0.2)
    stream(flying, local_target(1, VELOCITY_ONLY, velocity=(1.0, 0, 0)), 3)
    assert not flying.autopilot.not_supported and flying.vehicle.velocity[0] == pytest.approx(1.0, abs=0.2)


def test_a_place_is_not_flown_to_while_disarmed(client):
    assert client.command(192, -1, 0, 0, NAN, NAN, NAN, 495.0) == MavResult.REJECTED
    assert client.command(34, 10, 2, 0, 0, NAN, NAN, NAN) == MavResult.REJECTED


def test_an_attitude_tilts_the_vehicle(flying):
    pitch = math.radians(-6.0)
    attitude = [math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0]
    stream(flying, mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, attitude, 0, 0, 0, 0.5), 1.0)
    assert flying.of("ATTITUDE")[-1].pitch == pytest.approx(pitch, abs=0.03)


def test_sticks_move_the_vehicle_in_mode_position(flying):
    assert flying.command(176, 1, 3, 0) == MavResult.ACCEPTED
    start = flying.vehicle.position
    for _ in range(20):
        flying.send(mavlink.MAVLink_manual_control_message(1, 200, 0, 500, 0, 0))
        flying.wait(0.1)
    assert flying.vehicle.velocity[0] == pytest.approx(2.0, abs=0.3), "20 % of MPC_VEL_MANUAL"
    flying.wait(3)
    assert abs(flying.vehicle.velocity[0]) < 0.2, "the stick was released"
    assert flying.vehicle.position[2] == pytest.approx(start[2], abs=0.4)


# ---- take-off ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("altitude", "height", "text"),
    [
        (498.0, 10.0, None),
        (NAN, 2.5, None),
        (0.0, 2.5, "Using minimum takeoff altitude: 2.50 m"),
        (10.0, 2.5, "Using minimum takeoff altitude: 2.50 m"),
    ],
)
def test_a_take_off_climbs_to_its_altitude_above_sea_level(client, altitude, height, text):
    client.command(400, 1)
    assert client.command(22, 0, 0, 0, NAN, NAN, NAN, altitude) == MavResult.ACCEPTED
    assert text is None or text in client.texts()
    client.wait(25, lambda: client.autopilot.mode is FlightMode.HOLD)
    client.wait(2)
    assert -client.vehicle.position[2] == pytest.approx(height, abs=0.2)


def test_a_take_off_to_another_place_and_in_the_air(client):
    client.command(400, 1)
    latitude, longitude, _ = geodetic((5.0, 0.0, 0.0))
    client.send(
        mavlink.MAVLink_command_int_message(
            1, 1, 3, 22, 0, 0, 0, 0, 0, NAN, round(1e7 * latitude), round(1e7 * longitude), 4.0
        )
    )
    assert client.result(22) == MavResult.ACCEPTED
    client.wait(25, lambda: client.autopilot.mode is FlightMode.HOLD)
    assert client.vehicle.position == pytest.approx((5.0, 0.0, -4.0), abs=0.7)
    client.command(22, 0, 0, 0, NAN, NAN, NAN, 489.0)
    assert "Already higher than takeoff altitude" in client.texts()


# ---- missions ------------------------------------------------------------------------------------------------------
def float_item(number, command, place, parameters=(0.0, 0.0, 0.0, NAN), frame=3):
    latitude, longitude, _ = geodetic((place[0], place[1], 0.0))
    return mavlink.MAVLink_mission_item_message(
        1, 1, number, frame, command, 0, 1, *parameters, latitude, longitude, place[2]
    )


def upload(client, items):
    """Upload items of MISSION_ITEM; the type of the acknowledgement."""
    client.received.clear()
    client.send(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    for item in items:
        client.send(item)
        if client.of("MISSION_ACK"):
            break
    return client.of("MISSION_ACK")[-1].type


def test_a_mission_of_floats_flies_with_a_wait_and_a_jump(client):
    items = [
        float_item(0, 22, (0, 0, 3)),
        float_item(1, 16, (4, 0, 3), (2.0, 0, 0, NAN)),
        float_item(2, 16, (4, 4, 3)),
        float_item(3, 177, (0, 0, 0), (1, 1, 0, 0), frame=2),
        float_item(4, 21, (4, 4, 0)),
    ]
    assert upload(client, items) == 0
    client.command(400, 1)
    assert client.command(300) == MavResult.ACCEPTED
    client.wait(90, lambda: "Mission finished" in client.texts())
    assert [m.seq for m in client.of("MISSION_ITEM_REACHED")] == [0, 1, 2, 1, 2, 4]
    assert client.vehicle.landed and client.vehicle.position[:2] == pytest.approx((4.0, 4.0), abs=0.8)


@pytest.mark.parametrize(
    ("dialect", "mission_mode", "hold_mode", "first"), [("px4", (4, 4), (4, 3), 0), ("ardupilot", (3,), (4,), 1)]
)
def test_mission_current_tells_the_number_of_items_and_how_far_the_mission_is(dialect, mission_mode, hold_mode, first):
    client = Client(dialect)

    def status():
        client.received.clear()
        client.wait(1.1)
        message = client.of("MISSION_CURRENT")[-1]
        return message.total, message.mission_state, message.mission_mode

    assert status() == (65535, 1, 2), "no mission"
    home = [float_item(0, 16, (0, 0, 0))][:first]
    delay = float_item(first + 1, 93, (0, 0, 0), (9.0, 0, 0, 0), frame=2)
    upload(client, [*home, float_item(first, 22, (0, 0, 3)), delay])
    assert status() == (2, 2, 2), "not started"
    client.command(176, 1, *hold_mode)
    client.command(400, 1)
    client.command(300)
    assert status() == (2, 3, 1), "active"
    client.command(176, 1, *hold_mode)
    assert status() == (2, 4, 2), "paused"
    client.command(176, 1, *mission_mode)
    client.wait(40, lambda: "Mission finished" in client.texts())
    assert status()[1] == 5, "complete"
    client.send(mavlink.MAVLink_mission_clear_all_message(1, 1))
    assert status()[:2] == (65535, 1)


def test_items_are_asked_for_in_the_older_form_when_they_do_not_come(client):
    client.send(mavlink.MAVLink_mission_count_message(1, 1, 1))
    assert len(client.of("MISSION_REQUEST_INT")) == 1
    client.wait(1.2)
    assert [m.seq for m in client.of("MISSION_REQUEST")] == [0]


def test_items_come_back_in_the_form_of_the_request(client):
    upload(client, [float_item(0, 16, (4, 2, 3))])
    latitude, longitude, _ = geodetic((4.0, 2.0, 0.0))
    client.send(mavlink.MAVLink_mission_request_message(1, 1, 0))
    item = client.of("MISSION_ITEM")[0]
    assert (item.x, item.y) == pytest.approx((latitude, longitude), abs=1e-5)
    client.send(mavlink.MAVLink_mission_request_int_message(1, 1, 0))
    item = client.of("MISSION_ITEM_INT")[0]
    assert (item.x, item.y) == pytest.approx((1e7 * latitude, 1e7 * longitude), abs=20)
    client.send(mavlink.MAVLink_mission_request_int_message(1, 1, 5))
    assert client.of("MISSION_ACK")[-1].type == 13, "no such item"


@pytest.mark.parametrize(
    ("item", "result", "text"),
    [
        (float_item(0, 183, (0, 0, 0)), 3, "command 183 is not supported"),
        (float_item(0, 16, (0, 0, 3), frame=1), 2, "frame 1 is not supported"),
        (float_item(0, 1000, (0, 0, 0), frame=2), 0, "DO_GIMBAL_MANAGER_PITCHYAW is skipped"),
    ],
)
def test_items_that_cannot_be_flown_are_refused_or_said_to_be_skipped(client, item, result, text):
    assert upload(client, [item]) == result and text in "".join(client.texts())


def test_mode_mission_may_be_set_before_the_upload_and_the_motors(client):
    """The order of DroneKit's script for PX4, which sets MAV_MODE_AUTO without a custom mode."""
    assert client.command(176, 4) == MavResult.ACCEPTED and client.autopilot.mode is FlightMode.MISSION
    assert (
        upload(client, [float_item(0, 22, (0, 0, 3)), float_item(1, 16, (4, 0, 3)), float_item(2, 21, (4, 0, 0))]) == 0
    )
    client.wait(1)
    client.command(400, 1)
    client.wait(60, lambda: "Mission finished" in client.texts())
    assert client.vehicle.landed and client.vehicle.position[0] == pytest.approx(4.0, abs=0.8)
    client.wait(1.1)
    assert client.of("MISSION_CURRENT")[-1].seq == 0, "it could be flown again"


def test_a_mission_that_does_not_exist_is_denied_and_a_stray_item_refused(client):
    assert client.command(300) == MavResult.DENIED
    client.command(400, 1)
    assert client.command(176, 1, 4, 4) == MavResult.DENIED
    client.send(float_item(0, 16, (0, 0, 3)))
    assert client.of("MISSION_ACK")[-1].type == 1


# ---- parameters ----------------------------------------------------------------------------------------------------
def read(client, name):
    client.received.clear()
    client.send(mavlink.MAVLink_param_request_read_message(1, 1, name, -1))
    return client.received[0]


def bits(value):
    return struct.unpack("<f", struct.pack("<i", value))[0]


def test_common_parameters_have_px4s_defaults_and_types(client):
    for name, value in (("RTL_RETURN_ALT", 30.0), ("MPC_XY_VEL_MAX", 12.0), ("BAT1_CAPACITY", -1.0)):
        answer = read(client, name.encode())
        assert (answer.param_id, answer.param_value, answer.param_type) == (name, value, 9)
    answer = read(client, b"NAV_RCL_ACT")
    assert answer.param_type == 6 and struct.pack("<f", answer.param_value) == struct.pack("<i", 2)


def test_unknown_parameters_are_answered_with_an_error_and_exist_once_they_are_set(client):
    answer = read(client, b"MY_OWN")
    assert answer.get_type() == "PARAM_ERROR" and (answer.param_id, answer.error) == ("MY_OWN", 1)
    client.send(mavlink.MAVLink_param_set_message(1, 1, b"MY_OWN", bits(-7), 6))
    answer = read(client, b"MY_OWN")
    assert struct.pack("<f", answer.param_value) == struct.pack("<i", -7) and answer.param_type == 6
    client.received.clear()
    client.send(mavlink.MAVLink_param_request_list_message(1, 1))
    values = client.of("PARAM_VALUE")
    assert len(values) == values[0].param_count == len({m.param_index for m in values})


def test_a_float_for_an_integer_is_refused_and_a_speed_has_an_effect(client):
    client.send(mavlink.MAVLink_param_set_message(1, 1, b"NAV_RCL_ACT", 1.0, 9))
    assert client.of("PARAM_ERROR")[0].error == 7, "type mismatch"
    client.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 2.0, 9))
    assert client.autopilot.speed == 2.0
    client.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", math.inf, 9))
    assert client.of("PARAM_ERROR")[-1].error == 2 and client.autopilot.speed == 2.0


def test_a_return_is_flown_at_its_altitude(flying):
    flying.vehicle.place((60.0, 0.0, -4.0), (1.0, 0.0, 0.0, 0.0))
    flying.command(20)
    flying.wait(8)
    assert flying.vehicle.position[2] == pytest.approx(-30.0, abs=2.0)


def test_the_list_of_logs_is_empty(client):
    client.send(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    assert client.of("LOG_ENTRY")[0].num_logs == 0


def test_home_moves_with_what_is_relative_to_it(flying):
    assert flying.command(179, 0, 0, 0, 0, HOME[0], HOME[1], 480.0) == MavResult.ACCEPTED
    flying.wait(0.2)
    height = flying.of("GLOBAL_POSITION_INT")[-1].relative_alt
    assert height == pytest.approx(1e3 * (8.0 - flying.vehicle.position[2]), abs=100)
    assert flying.command(179, 0, 0, 0, 0, 0.0, 0.0, 480.0) == MavResult.DENIED, "another continent"
