"""Packets, frames, sticks and MSP of Betaflight, without Betaflight."""

import math
import struct

import numpy as np
import pytest

from mavfi.errors import MavfiError
from mavfi.extras.firmware import betaflight


def quaternion(axis, angle):
    return np.array([math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis))])


def test_the_packets_have_the_sizes_of_the_firmware():
    packets = betaflight.packets(5_000_000_000, betaflight.AT_REST, None)
    assert len(packets) == 8 + 144 + 40  # flag, fdm_packet, rc_packet of Betaflight's target.h
    assert struct.unpack_from("<Qd", packets) == (0, 5.0)


def test_rc_is_announced_only_if_there_is_any():
    packets = betaflight.packets(0, betaflight.AT_REST, betaflight.ARMED)
    assert struct.unpack_from("<Q", packets) == (1,)
    assert struct.unpack_from("<16H", packets, 8 + 144 + 8) == betaflight.ARMED


def test_rates_and_attitude_are_those_of_a_body_with_y_to_the_right_and_z_down():
    zero = np.zeros(3)
    state = betaflight.state_of(zero, quaternion((0, 1, 0), 0.2), zero, np.array([1.0, 2.0, 3.0]), zero)
    assert state[:3] == (1.0, -2.0, -3.0)
    assert state[6:10] == pytest.approx((math.cos(0.1), 0.0, -math.sin(0.1), 0.0))


def test_sticks_are_linear_and_saturate():
    half = betaflight.channels(0.5 * betaflight.ANGLE_LIMIT, -0.5 * betaflight.ANGLE_LIMIT, 0.25, 0.0)
    assert half[:4] == [1750, 1250, 1250, 1500]
    assert betaflight.channels(9.0, -9.0, 2.0, -9.0)[:4] == [2000, 1000, 2000, 2000]
    assert half[4] == betaflight.HIGH  # armed
    assert len(half) == betaflight.CHANNELS


def test_an_msp_message_has_length_code_and_check():
    assert betaflight.message(1) == b"$M<\x00\x01\x01"
    assert betaflight.message(35, b"\x01\x02") == bytes([36, 77, 60, 2, 35, 1, 2, 2 ^ 35 ^ 1 ^ 2])


def answer(code, data, direction=b">"):
    return b"$M" + direction + betaflight.message(code, data)[3:]


def test_a_reply_is_read_when_it_is_complete():
    whole = answer(2, b"BTFL")
    assert [betaflight.reply(whole[:size], 2) for size in range(len(whole))] == [None] * len(whole)
    assert betaflight.reply(whole, 2) == b"BTFL"


@pytest.mark.parametrize(
    "broken",
    [answer(2, b"BTFL", b"!"), answer(3, b"BTFL"), answer(2, b"BTFL")[:-1] + b"\x00"],
    ids=["refused", "another code", "wrong check"],
)
def test_a_refusal_is_an_error(broken):
    with pytest.raises(MavfiError, match="refused the MSP request 2"):
        betaflight.reply(broken, 2)
