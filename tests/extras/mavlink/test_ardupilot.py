"""ArduCopter's way of arming, taking off, guiding and flying missions, with the messages that DroneKit sends."""

import math

import pytest

mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega", reason="pymavlink is not installed")

from mavfi.extras.mavlink.ardupilot import ArduCopter, CopterMode  # noqa: E402
from mavfi.extras.mavlink.vocabulary import MavResult  # noqa: E402
from mavfi.numerics.frames import geodetic  # noqa: E402
from tests.extras.mavlink.client import NAN, Client  # noqa: E402

pytestmark = pytest.mark.slow

SET_MODE = 176
POSITION_ONLY = 0b0000_1111_1111_1000
VELOCITY_ONLY = 0b0000_1111_1100_0111


@pytest.fixture
def client():
    return Client("ardupilot")


@pytest.fixture
def flying(client):
    assert client.command(SET_MODE, 1, CopterMode.GUIDED) == MavResult.ACCEPTED
    assert client.command(400, 1) == MavResult.ACCEPTED
    assert client.command(22, 0, 0, 0, 0, 0, 0, 4.0) == MavResult.ACCEPTED
    client.wait(15, lambda: not client.autopilot.is_taking_off)
    assert -client.vehicle.position[2] == pytest.approx(4.0, abs=0.2), "height above home"
    return client


def degrees(north, east):
    latitude, longitude, _ = geodetic((north, east, 0.0), ArduCopter.origin)
    return latitude, longitude


def go_to_item(north, east, height, current=2, frame=3):
    """DroneKit's simple_goto."""
    return mavlink.MAVLink_mission_item_message(
        1, 0, 0, frame, 16, current, 0, 0, 0, 0, 0, *degrees(north, east), height
    )


def test_it_looks_like_arducopter_and_is_armable(client):
    client.wait(1.2)
    heartbeat = client.of("HEARTBEAT")[-1]
    assert (heartbeat.autopilot, heartbeat.type, heartbeat.custom_mode, heartbeat.base_mode & 1) == (3, 2, 0, 1)
    assert client.of("EKF_STATUS_REPORT")[-1].flags & 0x210 == 0x210, "position, absolute and predicted"
    assert client.of("GPS_RAW_INT")[-1].fix_type == 3
    assert client.of("GLOBAL_POSITION_INT")[-1].lat == round(-35.363262e7), "ArduPilot's simulation"
    assert client.command(520, 1) == MavResult.ACCEPTED
    version = client.of("AUTOPILOT_VERSION")[0]
    assert version.flight_sw_version & 0xFF == 255 and version.capabilities & 0x20000, "release; C cast"


def test_without_a_fix_it_is_not_armable(client):
    assert client.command(420, 4, 4, 0) == MavResult.ACCEPTED
    client.wait(1.2)
    assert not client.of("EKF_STATUS_REPORT")[-1].flags & 0x210
    client.command(SET_MODE, 1, CopterMode.GUIDED)
    assert client.command(400, 1) == MavResult.FAILED and "need position estimate" in client.texts()[0]


def test_modes_are_set_by_message_and_command(client):
    client.send(mavlink.MAVLink_set_mode_message(1, 1, CopterMode.GUIDED))
    assert client.result(11) == MavResult.ACCEPTED and client.autopilot.mode is CopterMode.GUIDED
    assert client.command(SET_MODE, 1, 14) == MavResult.FAILED, "FLIP"
    assert "Mode change to 14 failed: not supported" in client.texts()
    assert client.command(SET_MODE, 0, 4) == MavResult.DENIED, "no custom mode"
    assert client.command(SET_MODE, 1, CopterMode.AUTO) == MavResult.FAILED, "no mission"


def test_take_off_needs_guided_and_motors(client):
    client.command(400, 1)
    assert client.command(22, 0, 0, 0, 0, 0, 0, 5.0) == MavResult.FAILED
    assert "Takeoff failed: mode STABILIZE; allowed: GUIDED" in "".join(client.texts())
    client.command(400, 0)
    client.command(SET_MODE, 1, CopterMode.GUIDED)
    assert client.command(22, 0, 0, 0, 0, 0, 0, 5.0) == MavResult.FAILED and "not armed" in client.texts()[0]
    client.command(SET_MODE, 1, CopterMode.LAND)
    assert client.command(400, 1) == MavResult.FAILED and "not armable" in client.texts()[0]


def test_simple_goto_with_a_speed_and_the_return(flying):
    assert flying.command(178, 1, 3.0) == MavResult.ACCEPTED
    flying.send(go_to_item(15.0, 0.0, 6.0))
    assert flying.of("MISSION_ACK")[-1].type == 0
    flying.wait(3)
    assert math.hypot(*flying.vehicle.velocity) == pytest.approx(3.0, abs=0.4)
    flying.wait(6)
    assert flying.vehicle.position == pytest.approx((15.0, 0.0, -6.0), abs=0.5)
    flying.send(mavlink.MAVLink_set_mode_message(1, 1, CopterMode.RTL))
    flying.wait(90, lambda: not flying.vehicle.sim.armed)
    assert flying.vehicle.landed and flying.vehicle.position[:2] == pytest.approx((0.0, 0.0), abs=0.6)
    assert flying.autopilot.mode is CopterMode.RTL, "the mode stays"


def test_targets_count_in_guided_and_in_the_air_only(client, flying):
    del client
    flying.command(SET_MODE, 1, CopterMode.LOITER)
    flying.send(go_to_item(15.0, 0.0, 6.0))
    assert flying.of("MISSION_ACK")[-1].type == 1
    flying.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, POSITION_ONLY, 5, 0, -4, *[0] * 8))
    assert flying.autopilot.not_supported == ["SET_POSITION_TARGET_LOCAL_NED in mode LOITER: allowed: GUIDED"]


def test_a_position_is_flown_without_repetition_and_a_velocity_times_out(flying):
    fields = [0.0] * 8
    flying.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, POSITION_ONLY, *(round(1e7 * value) for value in degrees(8.0, 2.0)), 5.0, *fields
        )
    )
    flying.wait(8)
    assert flying.vehicle.position == pytest.approx((8.0, 2.0, -5.0), abs=0.4)
    flying.send(
        mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, VELOCITY_ONLY, 0, 0, 0, 1.0, *[0] * 7)
    )
    flying.wait(2.5)
    assert flying.vehicle.velocity[0] == pytest.approx(1.0, abs=0.2)
    flying.wait(3)
    assert abs(flying.vehicle.velocity[0]) < 0.1, "GUID_TIMEOUT"


def test_the_nose_turns_on_the_spot_and_on_the_way(flying):
    assert flying.command(115, 90, 0, 1, 0) == MavResult.ACCEPTED
    flying.wait(4)
    assert flying.vehicle.yaw == pytest.approx(math.radians(90), abs=0.1)
    assert flying.command(115, 45, 0, -1, 1) == MavResult.ACCEPTED, "relative, counter-clockwise"
    flying.wait(4)
    assert flying.vehicle.yaw == pytest.approx(math.radians(45), abs=0.1)


def test_a_mission_starts_after_home_and_can_be_skipped_forward(client):
    client.send(mavlink.MAVLink_mission_request_list_message(1, 0))
    assert client.of("MISSION_COUNT")[0].count == 1, "home"
    client.send(mavlink.MAVLink_mission_request_message(1, 0, 0))
    assert client.of("MISSION_ITEM")[0].x == pytest.approx(-35.363262, abs=1e-5)
    items = [(16, 0, 0, 0), (22, 0, 0, 4), (16, 8, 0, 4), (16, 8, 60, 4), (16, 4, 0, 4), (20, 0, 0, 0)]
    client.send(mavlink.MAVLink_mission_count_message(1, 0, len(items)))
    for number, (command, north, east, height) in enumerate(items):
        assert client.of("MISSION_REQUEST")[-1].seq == number
        place = degrees(north, east)
        client.send(mavlink.MAVLink_mission_item_message(1, 0, number, 3, command, 0, 1, 0, 0, 0, 0, *place, height))
    assert client.of("MISSION_ACK")[-1].type == 0
    client.command(SET_MODE, 1, CopterMode.GUIDED)
    client.command(400, 1)
    assert client.command(300) == MavResult.ACCEPTED and client.autopilot.mode is CopterMode.AUTO
    client.wait(40, lambda: any(m.seq == 2 for m in client.of("MISSION_ITEM_REACHED")))
    client.wait(1)
    client.send(mavlink.MAVLink_mission_set_current_message(1, 0, 4))
    client.wait(60, lambda: not client.vehicle.sim.armed)
    assert [m.seq for m in client.of("MISSION_ITEM_REACHED")] == [1, 2, 4, 5], "item 3 was skipped"


def test_overridden_channels_are_reported_and_move_the_vehicle(flying):
    flying.command(SET_MODE, 1, CopterMode.LOITER)
    channels = [65_535, 1400, 65_535, 65_535, *[65_535] * 4]  # channel 2 down = forward
    flying.send(mavlink.MAVLink_rc_channels_override_message(1, 1, *channels))
    flying.wait(2)
    assert flying.of("RC_CHANNELS")[-1].chan2_raw == 1400
    assert flying.vehicle.velocity[0] == pytest.approx(2.5, abs=0.4), "20 % of LOIT_SPEED"
    flying.send(mavlink.MAVLink_rc_channels_override_message(1, 1, *[0] * 8))
    flying.wait(3)
    assert abs(flying.vehicle.velocity[0]) < 0.2


def test_streams_are_set_by_groups(client):
    client.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    client.received.clear()
    client.wait(1.01)
    assert len(client.of("ATTITUDE")) in (4, 5)
    client.send(mavlink.MAVLink_request_data_stream_message(1, 1, 10, 0, 0))
    client.received.clear()
    client.wait(1)
    assert not client.of("ATTITUDE") and client.of("VFR_HUD")


def test_parameters_are_floats(client):
    client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"RTL_ALT", -1))
    assert (client.of("PARAM_VALUE")[0].param_value, client.of("PARAM_VALUE")[0].param_type) == (1500.0, 6)
    client.send(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000.0, 9))
    assert client.of("PARAM_VALUE")[-1].param_value == 2000.0


def test_a_reposition_is_for_command_int_only(flying):
    assert flying.command(192, -1, 1, 0, NAN, *degrees(4.0, 0.0), 5.0) == 8
    flying.received.clear()
    latitude, longitude = (round(1e7 * value) for value in degrees(4.0, 0.0))
    flying.send(mavlink.MAVLink_command_int_message(1, 1, 3, 192, 0, 0, -1, 1, 0, NAN, latitude, longitude, 5.0))
    assert flying.result(192) == MavResult.ACCEPTED
    flying.wait(5)
    assert flying.vehicle.position == pytest.approx((4.0, 0.0, -5.0), abs=0.4)


def test_an_attitude_has_a_climb_rate_in_place_of_a_thrust(flying):
    for _ in range(15):
        flying.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, 0.7))
        flying.wait(0.1)
    assert flying.vehicle.velocity[2] == pytest.approx(-1.0, abs=0.3), "0.4 of WPNAV_SPEED_UP"
