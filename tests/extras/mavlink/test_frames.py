"""Frames in a stream: cut out, and the same bytes again; recorded and random ones, between noise."""

import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega

from mavfi.extras.shared.mavlink_frames import FrameSplitter, MavlinkFrame
from tests.extras.mavlink.frames import KINDS, Peer, received


def pieces(data, chunk=4096):
    splitter = FrameSplitter(ardupilotmega)
    return [piece for start in range(0, len(data), chunk) for piece in splitter.feed(data[start : start + chunk])]


def joined(parts):
    return b"".join(part.data if isinstance(part, MavlinkFrame) else part for part in parts)


def test_a_hundred_thousand_frames_of_all_messages_pass_byte_for_byte():
    peer, signing = Peer(), Peer(2, is_signed=True)
    data = bytearray()
    for number in range(100_000):
        kind = KINDS[number % len(KINDS)]
        if number % 5 == 0:
            data += signing.frame(kind)
        else:
            data += peer.frame(kind, version=1 + (kind.id > 255 or number % 2))
    parts = pieces(bytes(data))
    assert joined(parts) == data
    assert len(parts) == 100_000
    assert {part.kind.msgname for part in parts} == {kind.msgname for kind in KINDS}


def test_noise_and_damaged_frames_pass_and_hide_no_frame():
    noise = random.Random(1)
    peer = Peer()
    data, frames = bytearray(), []
    for number in range(300):
        frame = bytearray(peer.frame(KINDS[number % len(KINDS)]))
        if number % 3 == 1:
            frame[noise.randrange(10, len(frame))] ^= 1 << noise.randrange(8)
        else:
            frames.append(bytes(frame))
        data += frame + noise.randbytes(noise.randrange(3))
    data += bytes(600)  # a frame that the noise seems to begin ends here
    parts = pieces(bytes(data), chunk=7)
    assert joined(parts) == data
    assert {part.data for part in parts if isinstance(part, MavlinkFrame)} >= set(frames)


@pytest.mark.parametrize("version", [1, 2])
def test_another_sequence_number_has_a_valid_checksum_also_in_an_unknown_message(version):
    data = Peer().frame(KINDS[0], version=version)
    (known,) = pieces(data)
    unknown = MavlinkFrame(data)
    assert known.rebuilt(sequence=300) == MavlinkFrame(unknown.rebuilt(sequence=300).data, known.kind)
    ((_, sequence, fields),) = received(known.rebuilt(sequence=300).data)
    assert sequence == 44
    assert fields == received(data)[0][2]


def test_a_payload_of_zeros_keeps_one_byte():
    (frame,) = pieces(Peer().frame(KINDS[0]))
    empty = frame.rebuilt(sequence=0, payload=bytes(len(frame.payload)))
    assert empty.data[1] == 1
    assert empty.payload == bytes(len(frame.payload))
    assert len(received(empty.data)) == 1


def test_a_signed_frame_is_never_rebuilt():
    (frame,) = pieces(Peer(is_signed=True).frame(KINDS[0]))
    assert frame.rebuilt(sequence=99, payload=bytes(9)) is frame
