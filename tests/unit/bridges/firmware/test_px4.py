"""PX4's HIL protocol against written frames."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.bridges.firmware import px4
from mavfi.bridges.firmware.px4 import Controls, Stream, checksum, sensor

DEFINITIONS = {
    "HIL_ACTUATOR_CONTROLS": (
        93, 47, [("uint64_t", "time_usec", 0), ("uint64_t", "flags", 0), ("float", "controls", 16),
                 ("uint8_t", "mode", 0)],
    ),
    "HIL_SENSOR": (
        107, 108, [("uint64_t", "time_usec", 0),
                   *(("float", name, 0) for name in ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag",
                                                     "zmag", "abs_pressure", "diff_pressure", "pressure_alt",
                                                     "temperature")),
                   ("uint32_t", "fields_updated", 0)],
    ),
}  # fmt: skip
"""From MAVLink's common.xml, in the order of the wire: number, last byte of the checksum, fields."""


def frame(time_us, controls=(0.5,) * 16, sequence=0, version=2, flags=px4.LOCKSTEP, mode=129):
    content = struct.pack("<QQ16fB", time_us, flags, *controls, mode)
    if version == 1:
        head = struct.pack("<BBBBBB", 0xFE, len(content), sequence, 1, 1, 93)
    else:
        head = struct.pack("<BBBBBBBHB", 0xFD, len(content), 0, 0, sequence, 1, 1, 93, 0)
    return head + content + checksum(head[1:] + content + b"\x2f").to_bytes(2, "little")


def heartbeat(sequence):
    head = struct.pack("<BBBBBBBHB", 0xFD, 9, 0, 0, sequence, 1, 1, 0, 0)
    return head + b"\1" * 9 + b"xx"  # its definition is not known here: the checksum is not looked at


@pytest.mark.parametrize("name", DEFINITIONS)
def test_the_last_byte_of_the_checksum_stands_for_the_definition(name):
    number, extra, fields = DEFINITIONS[name]
    text = name.encode() + b" "
    for kind, field, length in fields:
        text += f"{kind} {field} ".encode() + (bytes([length]) if length else b"")
    crc = checksum(text)
    assert (crc & 0xFF) ^ (crc >> 8) == extra == px4._CRC_EXTRA[number]


def test_the_checksum_is_that_of_the_standard():
    assert checksum(b"123456789") == 0x6F91  # CRC-16/MCRF4XX


def test_sensors_are_in_forward_right_down_without_zeros_at_the_end():
    sent = sensor(1_000_000, (1, 2, 9.8), (0.1, 0.2, 0.3), (0.2, 0.0, -0.4), 1013.25, 12.0, 300)
    assert sent[0] == 0xFD and sent[4] == 300 % 256 and sent[7:10] == (107).to_bytes(3, "little")
    content = sent[10:-2]
    assert len(content) == sent[1] == 62  # two zero bytes of fields_updated are left out
    values = struct.unpack("<Q13fI", content.ljust(64, b"\0"))
    assert values[0] == 1_000_000
    assert values[1:7] == pytest.approx((1, -2, -9.8, 0.1, -0.2, -0.3))
    assert values[-1] == px4.SENSORS_UPDATED
    assert checksum(sent[1:-2] + bytes([108])) == int.from_bytes(sent[-2:], "little")


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
    assert (stream.damaged, stream.lost, stream.stale) == (0, 0, 0)


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
    assert stream.damaged >= 1


def test_lost_frames_are_counted_over_all_messages():
    stream = Stream()
    stream.feed(frame(1000, sequence=254) + heartbeat(255) + frame(2000, sequence=3))
    assert stream.lost == 3


def test_after_a_restart_time_begins_again():
    stream = Stream()
    stream.feed(frame(9_000_000, sequence=9))
    stream.feed(frame(9_004_000, sequence=10)[:20])
    stream.restarted()
    assert [one.time_us for one in stream.feed(frame(4000, sequence=0))] == [4000]
    assert (stream.restarts, stream.lost, stream.stale) == (1, 0, 0)


def test_pymavlink_reads_our_sensors_and_we_read_its_controls():
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="pymavlink is not installed")
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    (read,) = link.parse_buffer(sensor(2_000_000, (1, 2, 9.8), (0.1, 0.2, 0.3), (0.2, 0.0, -0.4), 1013.25, 12.0, 0))
    assert read.get_type() == "HIL_SENSOR"
    assert (read.time_usec, read.fields_updated) == (2_000_000, px4.SENSORS_UPDATED)
    assert (read.yacc, read.zgyro, read.abs_pressure) == pytest.approx((-2.0, -0.3, 1013.25))
    sent = mavlink.MAVLink_hil_actuator_controls_message(4000, [0.5] * 16, 129, px4.LOCKSTEP).pack(link)
    assert Stream().feed(bytes(sent)) == [Controls(4000, (0.5,) * 16, 129, px4.LOCKSTEP)]
