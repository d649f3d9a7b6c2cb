"""Nothing is accepted silently: every message and command of the dialect is executed, answered or noted."""

import math
import struct

import pytest

mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega", reason="pymavlink is not installed")

from mavfi.extras.mavlink.vocabulary import MavResult  # noqa: E402
from tests.extras.mavlink.client import NAN, Client  # noqa: E402

pytestmark = pytest.mark.slow

EMPTY = {"HEARTBEAT", "MISSION_ACK", "LOG_REQUEST_END"}
"""Messages that ask for nothing."""
EXECUTED = {
    "px4": {"SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET", "MANUAL_CONTROL"},
    "ardupilot": {"RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL", "REQUEST_DATA_STREAM"},
}
"""Messages without an answer that are executed: flown in test_setpoints.py and test_ardupilot.py."""
INTEGERS = {
    "int8_t": "b",
    "uint8_t": "B",
    "char": "c",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "int64_t": "q",
    "uint64_t": "Q",
}
COMMANDS = sorted(number for number, entry in mavlink.enums["MAV_CMD"].items() if "ENUM_END" not in entry.name)


def message_of(message_class, number=0, text=b""):
    """A message for the autopilot whose other fields are a number, or a text."""
    values = []
    lengths = [message_class.array_lengths[place] for place in message_class.orders]  # from the order on the wire
    for name, kind, length in zip(message_class.fieldnames, message_class.fieldtypes, lengths, strict=True):
        value = number
        if kind not in ("float", "double"):
            size = 8 * struct.calcsize(INTEGERS[kind])
            value = 0
            if number:
                value = 2 ** (size - 1) - 1
        if kind == "char" and length:
            values.append(text)
        elif length:
            values.append([value] * length)
        elif name.startswith("target") and message_class.msgname != "PING":  # of a request for an echo it is 0
            values.append(1)
        else:
            values.append(value)
    return message_class(*values)


@pytest.mark.parametrize("dialect", ["px4", "ardupilot"])
def test_every_message_is_executed_answered_or_noted(dialect):
    client = Client(dialect)
    silent = set()
    for message_class in mavlink.mavlink_map.values():
        client.received.clear()
        before = len(client.autopilot.not_supported)
        client.send(message_of(message_class))
        if not client.received and len(client.autopilot.not_supported) == before:
            silent.add(message_class.msgname)
    assert silent == EMPTY | EXECUTED[dialect]
    if dialect == "px4":  # no mode that follows them was set
        client.wait(2.5)
        assert {f"{kind} in mode hold" for kind in EXECUTED["px4"]} <= set(client.autopilot.not_supported)


@pytest.mark.parametrize(
    ("dialect", "number"), [("px4", NAN), ("px4", 1e30), ("ardupilot", math.inf), ("ardupilot", -1e30)]
)
def test_no_value_of_a_message_or_command_stops_the_autopilot(dialect, number):
    client = flying(dialect)
    for message_class in mavlink.mavlink_map.values():
        client.send(message_of(message_class, number, b"\xff" * 4))
        client.wait(0.02)
    for command in COMMANDS:
        client.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *[number] * 7))
        client.send(mavlink.MAVLink_command_int_message(1, 1, 0, command, 0, 0, *[number] * 4, 2**31 - 2, 5, number))
        client.wait(0.02)
    client.received.clear()
    client.wait(1.1)
    assert client.of("HEARTBEAT")


def test_what_is_noted_is_told_once():
    told = []
    client = Client()
    client.autopilot._tell = told.append
    for _ in range(3):
        client.send(mavlink.MAVLink_play_tune_message(1, 1, b"A"))
        client.send(mavlink.MAVLink_play_tune_message(9, 1, b"A"))
        client.send(mavlink.MAVLink_manual_control_message(9, 0, 0, 500, 0, 0))
    lines = ["PLAY_TUNE", "PLAY_TUNE to system 9, component 1", "MANUAL_CONTROL to system 9, component 0"]
    assert told == client.autopilot.not_supported == lines


def test_a_message_of_another_dialect_is_noted():
    client = Client()
    unknown = struct.pack("<BBBBBBBHB", 253, 1, 0, 0, 0, 245, 190, 60_000 & 0xFFFF, 0) + b"\x01\x00\x00"
    for parsed in client._to_it.parse_buffer(unknown):
        client.autopilot.handle(parsed)
    assert client.autopilot.not_supported == ["UNKNOWN_60000"]


# ---- commands ------------------------------------------------------------------------------------------------------
def flying(dialect):
    """A client whose vehicle hovers."""
    client = Client(dialect)
    if dialect == "px4":
        client.fly_up()
        return client
    assert client.command(176, 1, 4) == MavResult.ACCEPTED and client.command(400, 1) == MavResult.ACCEPTED
    assert client.command(22, 0, 0, 0, 0, 0, 0, 3) == MavResult.ACCEPTED
    client.wait(10, lambda: not client.autopilot.is_taking_off)
    return client


def mode(number):
    """The mode becomes this number of HEARTBEAT."""

    def check(client):
        client.wait(0.1)
        assert client.of("HEARTBEAT")[-1].custom_mode == number

    return check


def sends(kind):
    """A message arrives."""

    def check(client):
        client.wait(0.1)
        assert client.of(kind)

    return check


def px4_mode(main, sub):
    return mode(main << 16 | sub << 24)


def moved_home(client):
    client.wait(0.1)
    assert client.of("HOME_POSITION")[-1].altitude == 490_000


def fast(client):
    assert client.autopilot.speed == 3.0


def off(client):
    assert not client.vehicle.sim.armed


def faster_attitude(client):
    client.received.clear()
    client.wait(1.0)
    assert len(client.of("ATTITUDE")) == 5


def turned(client):
    client.wait(4.0)
    assert abs(math.remainder(client.vehicle.yaw - math.radians(90.0), 2 * math.pi)) < 0.1


def text(words):
    return lambda client: None if words in client.texts() else pytest.fail(f"{client.texts()}")


def failed(client):
    assert client.vehicle.failures.active or client.autopilot.failures.fix_type == 2


HERE = {"px4": (47.397742, 8.545594, 490.0), "ardupilot": (-35.363262, 149.165237, 586.0)}
BOTH = {
    178: ((1, 3.0), fast),
    185: ((1,), off),
    410: ((), sends("HOME_POSITION")),
    420: ((4, 4, 0), failed),
    510: ((30,), sends("MESSAGE_INTERVAL")),
    511: ((30, 200_000), faster_attitude),
    512: ((148,), sends("AUTOPILOT_VERSION")),
    520: ((1,), sends("AUTOPILOT_VERSION")),
}
"""Parameters of commands that are accepted in flight, and their effect."""
EFFECTS = {
    "px4": BOTH
    | {
        20: ((), px4_mode(4, 5)),
        21: ((), px4_mode(4, 6)),
        22: ((0, 0, 0, NAN, NAN, NAN, 495.0), px4_mode(4, 2)),
        34: ((10, 2, 0, 0, NAN, NAN, NAN), px4_mode(3, 1)),
        176: ((1, 4, 3), px4_mode(4, 3)),
        179: ((0, 0, 0, 0, *HERE["px4"]), moved_home),
        192: ((-1, 0, 0, NAN, NAN, NAN, 495.0), px4_mode(4, 3)),
        193: ((0,), px4_mode(4, 3)),
        400: ((0, 21196), off),
    },
    "ardupilot": BOTH
    | {
        17: ((), mode(5)),
        20: ((), mode(6)),
        21: ((), mode(9)),
        115: ((90, 0, 1, 0), turned),
        176: ((1, 5), mode(5)),
        400: ((0, 21196), off),
    },
}
ELSEWHERE = {22, 179, 192, 300, 401}
"""Commands that are accepted on the ground, with a mission or as COMMAND_INT, tested below and in test_ardupilot.py."""


@pytest.mark.parametrize("dialect", ["px4", "ardupilot"])
def test_every_command_is_acknowledged_and_few_are_accepted(dialect):
    clients = (Client(dialect), flying(dialect))
    accepted = set()
    for client in clients:
        for number in COMMANDS:
            for value in (0.0, 1.0, NAN):
                client.received.clear()
                client.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *[value] * 7))
                client.send(mavlink.MAVLink_command_int_message(1, 1, 0, number, 0, 0, *[value] * 4, 0, 0, value))
                client.wait(0.02)
                results = [m.result for m in client.of("COMMAND_ACK") if m.command == number]
                if number != 420:  # acknowledged once a value has changed
                    assert len(results) == 2, number
                if MavResult.ACCEPTED in results:
                    accepted.add(number)
    assert accepted <= set(EFFECTS[dialect]) | ELSEWHERE


@pytest.mark.parametrize(
    ("dialect", "number"), [(dialect, number) for dialect, effects in EFFECTS.items() for number in effects]
)
def test_what_is_accepted_has_an_effect(dialect, number):
    parameters, check = EFFECTS[dialect][number]
    client = flying(dialect)
    assert client.command(number, *parameters) == MavResult.ACCEPTED
    check(client)


def test_checks_are_run_on_the_ground():
    client = Client()
    assert client.command(401) == MavResult.ACCEPTED and "Pre-arm checks passed" in client.texts()


def test_files_extended_parameters_and_parts_of_missions_are_refused():
    client = Client()
    open_file = bytes([7, 0, 0, 4, *[0] * 247])
    client.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, open_file))
    reply = client.of("FILE_TRANSFER_PROTOCOL")[0].payload
    assert (reply[0], reply[3], reply[5], reply[12]) == (8, 129, 4, 10), "number, NAK, of OpenFileRO, not found"
    client.send(mavlink.MAVLink_param_ext_set_message(1, 1, b"X", b"1", 1))
    assert client.of("PARAM_EXT_ACK")[0].param_result == 2
    client.send(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 0, 1))
    assert client.of("MISSION_ACK")[0].type == 3
