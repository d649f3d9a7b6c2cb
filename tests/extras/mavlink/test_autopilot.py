"""The autopilot without sockets: a client's messages in, telemetry out, in simulated time."""

import math
import socket
import struct
import threading

import pytest

mavlink = pytest.importorskip(
    "pymavlink.dialects.v20.ardupilotmega", reason="pymavlink (extra mavlink) is not installed"
)

from mavfi.cli.commands import run  # noqa: E402
from mavfi.extras.mavlink.failures import TYPES, UNITS  # noqa: E402
from mavfi.extras.mavlink.px4 import FlightMode  # noqa: E402
from mavfi.extras.mavlink.server import MavlinkServer  # noqa: E402
from mavfi.extras.mavlink.vocabulary import MavResult  # noqa: E402
from mavfi.mission import MissionSpec  # noqa: E402
from mavfi.numerics.frames import geodetic  # noqa: E402
from tests.core.unit.sim.environments.octrees import bits, tree_of  # noqa: E402

pytestmark = pytest.mark.slow

NAN = math.nan
GYRO, POSITION, MOTOR = 0, 4, 101
OFF, STUCK = 1, 2


def test_take_off_and_land(client):
    client.wait(1.1)
    kinds = {m.get_type() for m in client.received}
    assert {
        "HEARTBEAT",
        "SYS_STATUS",
        "HOME_POSITION",
        "GLOBAL_POSITION_INT",
        "ATTITUDE",
        "EXTENDED_SYS_STATE",
    } <= kinds
    assert client.of("HEARTBEAT")[0].autopilot == 12 and client.of("EXTENDED_SYS_STATE")[0].landed_state == 1
    assert client.command(22) == MavResult.REJECTED, "motors are off"
    client.fly_up()
    client.received.clear()
    client.wait(1.1)
    assert client.of("EXTENDED_SYS_STATE")[0].landed_state == 2
    assert client.of("HEARTBEAT")[-1].custom_mode == 4 << 16 | 3 << 24
    assert client.command(400, 0) == MavResult.DENIED, "in flight"
    assert client.command(21) == MavResult.ACCEPTED
    client.wait(40, lambda: not client.vehicle.sim.armed)
    assert client.vehicle.landed and "Disarmed by landing" in client.texts()


def test_reposition(flying):
    latitude, longitude, altitude = geodetic((10.0, -4.0, -4.0))
    assert flying.command(192, -1, 1, 0, NAN, latitude, longitude, altitude) == MavResult.ACCEPTED
    flying.wait(15)
    assert flying.vehicle.position == pytest.approx((10.0, -4.0, -4.0), abs=0.8)


def offboard(client, mask, seconds, **values):
    given = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0.0) | values
    for _ in range(round(seconds / 0.2)):
        client.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, mask, *given.values()))
        if client.autopilot.mode is not FlightMode.OFFBOARD:
            assert client.command(176, 1, 6) == MavResult.ACCEPTED
        client.wait(0.2)


def test_offboard_velocity_and_timeout(flying):
    north = flying.vehicle.position[0]
    offboard(flying, 0b0000_0101_1100_0111, 4, vx=2.0)
    assert flying.vehicle.velocity[0] == pytest.approx(2.0, abs=0.3) and flying.vehicle.position[0] > north + 5
    flying.wait(4)
    assert abs(flying.vehicle.velocity[0]) < 0.2, "set-points ended"


def upload(client, items):
    """Upload a mission of (command, north, east, height above home)."""
    client.send(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    for number, (command, north, east, height) in enumerate(items):
        assert client.of("MISSION_REQUEST_INT")[-1].seq == number
        latitude, longitude, _ = geodetic((north, east, 0.0))
        client.send(
            mavlink.MAVLink_mission_item_int_message(
                1,
                1,
                number,
                6,
                command,
                0,
                1,
                0,
                1,
                0,
                NAN,
                round(1e7 * latitude),
                round(1e7 * longitude),
                height,
            )
        )
    assert client.of("MISSION_ACK")[-1].type == 0


def test_a_mission(client):
    upload(client, [(16, 0.0, 0.0, 5.0), (16, 6.0, 0.0, 5.0), (21, 6.0, 6.0, 0.0)])
    assert client.command(400, 1) == MavResult.ACCEPTED and client.command(300) == MavResult.ACCEPTED
    client.wait(90, lambda: "Mission finished" in client.texts())
    assert [m.seq for m in client.of("MISSION_ITEM_REACHED")] == [0, 1, 2]
    assert client.vehicle.landed and not client.vehicle.sim.armed
    assert client.vehicle.position[:2] == pytest.approx((6.0, 6.0), abs=0.8)


# ---- failures ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("unit", "kind", "instance", "result", "reason"),
    [
        (GYRO, OFF, 2, MavResult.UNSUPPORTED, "gyro: this vehicle has 1"),
        (8, OFF, 0, MavResult.UNSUPPORTED, "airspeed"),
        (MOTOR, 9, 0, MavResult.UNSUPPORTED, "FAILURE_TYPE 9"),
        (MOTOR, OFF, 5, MavResult.UNSUPPORTED, "motor: this vehicle has 4"),
        (GYRO, STUCK, 0, MavResult.REJECTED, "motors off"),
    ],
)
def test_failures_that_are_not_possible_are_refused_with_a_reason(client, unit, kind, instance, result, reason):
    assert client.command(420, unit, kind, instance) == result
    assert reason in "".join(client.texts())


@pytest.mark.parametrize("unit", [number for number in UNITS])
def test_every_type_of_failure_changes_a_value_before_it_is_acknowledged(flying, unit):
    """`gps wrong` has a test of its own."""
    offboard(flying, 0b0000_0101_1100_0111, 1, vx=1.0, vy=0.5)
    for kind in [kind for kind, name in TYPES.items() if name != "ok" and (unit, name) != (POSITION, "wrong")]:
        assert flying.command(420, unit, kind, 0) is None
        failure = flying.autopilot.vehicle.failures.active[-1]
        flying.wait(1.5, lambda: flying.result(420) is not None)
        assert flying.result(420) == MavResult.ACCEPTED, failure
        injection = failure.injection
        assert injection.time_s >= 1e-6 * failure.fault.time_us and injection.before != injection.after
        before, after = (f"{value:.4g}" for value in (injection.before, injection.after))
        assert "".join(flying.texts()) == f"fault: {failure.fault.site}: {before} -> {after}", "not cut off"
        assert flying.command(420, unit, 0, 0) == MavResult.ACCEPTED
        assert not flying.autopilot.vehicle.failures.active
        flying.vehicle.place((0.0, 0.0, -6.0), (1.0, 0.0, 0.0, 0.0))


def test_every_pair_of_unit_and_type_is_proven_or_refused_with_a_reason(flying):
    for unit in [*range(10), *range(100, 109)]:
        for kind in range(10):
            if unit in UNITS and kind in TYPES:
                continue  # the test above
            result = flying.command(420, unit, kind, 0)
            if result == MavResult.ACCEPTED:
                assert unit == 100 and TYPES[kind] in ("ok", "off", "wrong")
            else:
                assert result == MavResult.UNSUPPORTED and "failure refused: " in "".join(flying.texts())


def test_a_mask_names_several_motors_and_ok_ends_some_of_them(flying):
    assert flying.command(420, MOTOR, 4, NAN, 0b101) is None
    flying.wait(1.5, lambda: flying.result(420) is not None)
    assert flying.result(420) == MavResult.ACCEPTED
    failing = [failure.fault.instance for failure in flying.vehicle.failures.active]
    assert failing == [1, 3]
    assert flying.command(420, MOTOR, 0, NAN, 0b001) == MavResult.ACCEPTED
    assert [failure.fault.instance for failure in flying.vehicle.failures.active] == [3]
    assert flying.command(420, MOTOR, OFF, NAN, 0b10001) == MavResult.UNSUPPORTED, "motor 5"
    assert flying.command(420, MOTOR, OFF, NAN, 0) == MavResult.DENIED, "nobody"


def test_one_motor_of_four_that_fail_recovers(flying):
    flying.command(420, MOTOR, 4, 0)
    assert flying.command(420, MOTOR, 0, 2) == MavResult.ACCEPTED
    assert [failure.fault.instance for failure in flying.vehicle.failures.active] == [1, 3, 4]


def test_wrong_gps_degrades_the_fix_as_in_px4(flying):
    """PX4 since August 2026: SYS_FAIL_GPS_WRG, and the estimator does not use a 2D fix."""
    assert flying.command(420, POSITION, 4, 1) == MavResult.ACCEPTED
    assert "fix type 3 -> 2" in "".join(flying.texts())
    flying.wait(1.2)
    assert flying.of("GPS_RAW_INT")[-1].fix_type == 2
    assert not flying.of("SYS_STATUS")[-1].onboard_control_sensors_health & 0x20
    here = flying.vehicle.position
    flying.vehicle.place((5.0, 0.0, -6.0), (1.0, 0.0, 0.0, 0.0))
    flying.wait(0.1)
    assert flying.vehicle.position == pytest.approx(here), "the position is that of before"
    assert flying.command(420, POSITION, 0, 0) == MavResult.ACCEPTED
    flying.wait(1.2)
    assert flying.of("GPS_RAW_INT")[-1].fix_type == 3


def test_a_depleted_battery_is_reported(flying):
    assert flying.command(420, 100, 4, 0) == MavResult.ACCEPTED
    flying.wait(1.2)
    assert flying.of("BATTERY_STATUS")[-1].battery_remaining == 6 == flying.of("SYS_STATUS")[-1].battery_remaining
    assert flying.command(420, 100, OFF, 0) == MavResult.ACCEPTED
    flying.received.clear()
    flying.wait(1.2)
    assert not flying.of("BATTERY_STATUS") and flying.of("SYS_STATUS")[-1].battery_remaining == -1


def test_a_repeated_command_is_acknowledged_and_starts_no_second_failure(flying):
    """Programs repeat a command whose answer is late."""
    flying.command(420, MOTOR, OFF, 1)
    flying.wait(0.1)
    assert flying.result(420) == MavResult.ACCEPTED
    assert flying.command(420, MOTOR, OFF, 1) == MavResult.ACCEPTED
    assert len(flying.vehicle.failures.active) == 1


def test_a_motor_that_is_off_brings_the_vehicle_down(flying):
    flying.command(420, MOTOR, OFF, 1)
    flying.wait(3)
    assert flying.vehicle.sim.height < 0.3


def test_a_wrong_position_moves_the_vehicle(flying):
    """Position hold follows what it believes: 10 m of error in x become 10 m of displacement."""
    set_parameter(flying, b"MAVFI_GPS_WRONG", 1)
    begin = float(flying.vehicle.sim.odometry[0])
    flying.command(420, POSITION, 4, 0)
    flying.wait(15)
    assert float(flying.vehicle.sim.odometry[0]) - begin == pytest.approx(-10.0, abs=1.0)


def set_parameter(client, name, value):
    """Set an integer parameter, in the byte-wise encoding of PX4."""
    (bits,) = struct.unpack("<f", struct.pack("<i", value))
    client.send(mavlink.MAVLink_param_set_message(1, 1, name, bits, 6))


# ---- the shell -----------------------------------------------------------------------------------------------------
def typed(client, line):
    """Type a line; what is printed."""
    client.received.clear()
    data = f"{line}\n".encode()
    client.send(mavlink.MAVLink_serial_control_message(10, 6, 0, 0, len(data), [*data, *[0] * (70 - len(data))]))
    client.wait(0.1)
    return "".join(bytes(m.data[: m.count]).decode() for m in client.of("SERIAL_CONTROL"))


def test_failures_are_typed_with_instances_and_masks(flying):
    assert typed(flying, "failure motor wrong -m 0x5") == "command 420: accepted\n"
    assert [failure.fault.site for failure in flying.vehicle.failures.active] == ["motor1 wrong", "motor3 wrong"]
    assert typed(flying, "failure motor ok -i 1") == "command 420: accepted\n"
    assert not flying.of("COMMAND_ACK"), "nobody sent one"
    assert [failure.fault.site for failure in flying.vehicle.failures.active] == ["motor3 wrong"]
    assert typed(flying, "failure baro off") == "command 420: unsupported\n"
    assert "no barometer" in "".join(flying.texts())
    assert "allowed: gyro, accel" in typed(flying, "failure wing off")
    assert "allowed: failure COMPONENT TYPE" in typed(flying, "failure gps off -k 3")


def test_other_commands_are_typed(client):
    assert typed(client, "commander takeoff") == "command 400: accepted\ncommand 22: accepted\n"
    assert client.autopilot.mode is FlightMode.TAKEOFF
    typed(client, "param set MPC_XY_CRUISE 3.5")
    assert typed(client, "param show MPC_XY_CRUISE") == "MPC_XY_CRUISE: 3.5\n" and client.autopilot.speed == 3.5
    assert "not a value of NAV_RCL_ACT" in typed(client, "param set NAV_RCL_ACT x")
    assert "'ps': not known; allowed: failure, commander, param" in typed(client, "ps")


# ---- UDP -----------------------------------------------------------------------------------------------------------
def test_over_udp():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(5)
        server = MavlinkServer(MissionSpec(environment="farm", seed=7), 0, (station.getsockname()[1],))
        serving = threading.Thread(target=server.run, args=(1.5,))
        serving.start()
        parser, link, found = mavlink.MAVLink(None), mavlink.MAVLink(None, srcSystem=245), []
        station.sendto(b"noise", ("127.0.0.1", server.port))
        arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
        station.sendto(arm.pack(link), ("127.0.0.1", server.port))
        while not any(m.get_type() == "COMMAND_ACK" for m in found):
            found += parser.parse_buffer(station.recv(65_535)) or []
        serving.join()
        assert server.vehicle.sim.armed and server.received == 1
        server.close()


def test_a_port_in_use_is_refused(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = str(taken.getsockname()[1])
        assert run(["mavlink", "serve", "--environment", "farm", "--port", port]) == 2
    err = capsys.readouterr().err
    assert f"--port: {port}: cannot be opened" in err and err.count("\n") == 1


def test_a_scan_is_refused_as_it_has_no_ground(tmp_path, capsys):
    scan = tmp_path / "building.bt"
    tree = tree_of({(i, j, 0): True for i in range(8) for j in range(8)})
    scan.write_bytes(b"# Octomap OcTree binary file\nid OcTree\nsize 100\nres 0.5\ndata\n" + bits(tree))
    assert run(["mavlink", "serve", "--environment", str(scan), "--start", "2", "5", "1.5"]) == 2
    err = capsys.readouterr().err
    assert "building: a scan, which has no ground to stand on" in err and err.count("\n") == 1


def test_an_unknown_dialect_is_refused(capsys):
    assert run(["mavlink", "serve", "--environment", "farm", "--dialect", "inav"]) == 2
    assert "--dialect: 'inav': not known; allowed: px4, ardupilot" in capsys.readouterr().err


def test_serving_ends_with_a_sentence_on_the_vehicle(capsys):
    assert run(["mavlink", "serve", "--environment", "farm", "--seed", "7", "--port", "0", "--seconds", "0.2"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert "0 messages received: the vehicle is on the ground" in last and "; digest " in last
