"""ArduPilot's JSON protocol against written frames."""

import json
import math
import struct

import pytest

from mavfi.bridges.firmware.ardupilot import Frames, Servos, servos, state
from mavfi.errors import BadInputError

# 18458, 400 Hz, frame 258, pulses 1000, 1001 ... 1015, as bytes of the wire
FRAME = bytes.fromhex(
    "1a48 9001 02010000 e803 e903 ea03 eb03 ec03 ed03 ee03 ef03 f003 f103 f203 f303 f403 f503 f603 f703"
)


def test_a_frame_of_servo_outputs_is_read():
    assert servos(FRAME) == Servos(400, 258, tuple(range(1000, 1016)))


def test_a_frame_with_32_channels_is_read():
    assert servos(struct.pack("<HHI32H", 29569, 50, 1, *range(32))).pulses_us == tuple(range(32))


@pytest.mark.parametrize("broken", [b"", b"\x1a", FRAME[:-1], FRAME + b"\0", b"\0\0" + FRAME[2:]])
def test_other_datagrams_are_refused(broken):
    with pytest.raises(BadInputError, match="ArduPilot: datagram"):
        servos(broken)


def test_the_answer_is_one_line_in_north_east_down():
    line = state(1.25, (1, 2, 3), (0, 0, 9.8), (10, 20, 30), (0.5, 0.5, 0.5, 0.5), (4, 5, 6))
    assert line.startswith(b"\n") and line.endswith(b"\n") and line.count(b"\n") == 2
    assert json.loads(line) == {
        "timestamp": 1.25, "imu": {"gyro": [1, -2, -3], "accel_body": [0, 0, -9.8]}, "position": [10, -20, -30],
        "quaternion": [0.5, 0.5, -0.5, -0.5], "velocity": [4, -5, -6],
    }  # fmt: skip


def test_a_state_that_is_not_finite_is_no_json():
    with pytest.raises(ValueError, match="JSON"):
        state(0.0, (math.nan, 0, 0), (0, 0, 0), (0, 0, 0), (1, 0, 0, 0), (0, 0, 0))


def test_repeated_lost_and_restarted_frames_are_counted():
    frames = Frames()
    assert [frames.is_new(count) for count in (7, 8, 8, 8, 9, 12, 0, 1)] == [
        True, True, False, False, True, True, True, True,
    ]  # fmt: skip
    assert (frames.repeated, frames.lost, frames.restarts) == (2, 2, 1)
