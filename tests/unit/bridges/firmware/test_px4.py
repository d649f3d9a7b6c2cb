"""PX4's HIL protocol against written frames."""

import struct
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.bridges.firmware import px4
from mavfi.bridges.firmware.px4 import Controls, Stream, sensor
from mavfi.errors import BadInputError

mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="pymavlink (extra mavlink) is not installed")


def frame(time_us, controls=(0.5,) * 16, sequence=0, version=2, flags=px4.LOCKSTEP, mode=129):
    content = struct.pack("<QQ16fB", time_us, flags, *controls, mode)
    if version == 1:
        head = struct.pack("<BBBBBB", 0xFE, len(content), sequence, 1, 1, 93)
    else:
        head = struct.pack("<BBBBBBBHB", 0xFD, len(content), 0, 0, sequence, 1, 1, 93, 0)
    check = mavlink.x25crc(head[1:] + content + b"\x2f").crc  # 0x2f: of this message's definition
    return head + content + check.to_bytes(2, "little")


def unknown(sequence):
    head = struct.pack("<BBBBBBBHB", 0xFD, 9, 0, 0, sequence, 1, 1, 0xFFFF, 0xFE)
    return head + b"\1" * 9 + b"xx"  # its definition is not known: the checksum is not looked at


def test_sensors_are_in_forward_right_down_without_zeros_at_the_end():
    sent = sensor(1_000_000, (1, 2, 9.8), (0.1, 0.2, 0.3), (0.2, 0.0, -0.4), 1013.25, 12.0, 300)
    assert sent[0] == 0xFD and sent[4] == 300 % 256 and sent[7:10] == (107).to_bytes(3, "little")
    content = sent[10:-2]
    assert len(content) == sent[1] == 62  # two zero bytes of fields_updated are left out
    values = struct.unpack("<Q13fI", content.ljust(64, b"\0"))
    assert values[0] == 1_000_000
    assert values[1:7] == pytest.approx((1, -2, -9.8, 0.1, -0.2, -0.3))
    assert values[-1] == px4.SENSORS_UPDATED
    assert mavlink.x25crc(sent[1:-2] + bytes([108])).crc == int.from_bytes(sent[-2:], "little")


@pytest.mark.parametrize("version", [1, 2])
def test_an_answer_is_read(version):
    (found,) = Stream().feed(frame(4_000, (0.25,) * 16, version=version))
    assert found == Controls(4_000, (0.25,) * 16, 129, px4.LOCKSTEP)


@given(st.lists(st.integers(1, 40), max_size=30))
def test_answers_survive_any_fragmentation(sizes):
    content = b"junk" + b"".join(frame(1000 * (n + 1), sequence=n) for n in range(4))
    stream, found = Stream(), []
    for size in sizes:
        found += stream.feed(content[:size])
        content = content[size:]
    found += stream.feed(content)
    assert [one.time_us for one in found] == [1000, 2000, 3000, 4000]
    assert (stream.damaged > 0, stream.lost, stream.stale) == (True, 0, 0)  # the junk


def test_repeated_and_late_answers_are_dropped():
    stream = Stream()
    times = [one.time_us for time in (1000, 1000, 2000, 1000, 3000) for one in stream.feed(frame(time))]
    assert times == [1000, 2000, 3000]
    assert stream.stale == 2


def test_a_damaged_answer_is_dropped_and_the_next_one_is_read():
    broken = bytearray(frame(1000, sequence=0))
    broken[20] ^= 0x40
    stream = Stream()
    found = stream.feed(bytes(broken) + frame(2000, sequence=1))
    assert [one.time_us for one in found] == [2000]
    assert stream.damaged == 1


def test_lost_frames_are_counted_over_all_messages():
    stream = Stream()
    stream.feed(frame(1000, sequence=254) + unknown(255) + frame(2000, sequence=3))
    assert stream.lost == 3


def test_after_a_restart_time_starts_again():
    stream = Stream()
    stream.feed(frame(9_000_000, sequence=9))
    stream.feed(frame(9_004_000, sequence=10)[:20])
    stream.restarted()
    assert [one.time_us for one in stream.feed(frame(4000, sequence=0))] == [4000]
    assert (stream.restarts, stream.lost, stream.stale) == (1, 0, 0)


def test_without_pymavlink_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    with pytest.raises(BadInputError, match="px4: needs pymavlink"):
        Stream()
