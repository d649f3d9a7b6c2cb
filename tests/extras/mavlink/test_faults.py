"""Faults in streams of frames: what a receiver sees of them, by pymavlink's own parser."""

import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega

from mavfi.errors import BadInputError
from mavfi.extras.mavlink.faults import FaultyStream, MavlinkFault
from mavfi.extras.shared.mavlink_frames import FrameSplitter, MavlinkFrame, numbers_of
from tests.extras.mavlink.frames import KINDS, Peer, received

BY_NAME = {kind.msgname: kind for kind in KINDS}
ATTITUDE, HEARTBEAT = BY_NAME["ATTITUDE"], BY_NAME["HEARTBEAT"]


class Stream:
    """A stream with faults, fed a frame each 10 ms."""

    def __init__(self, *texts, seed=0):
        self.faults = [MavlinkFault(text, ardupilotmega, seed) for text in texts]
        self.injections = []
        self.stream = FaultyStream(self.faults, self.injections.append)
        self._splitter = FrameSplitter(ardupilotmega)
        self._time_us = 0

    def send(self, frames):
        sent = []
        for frame in frames:
            for piece in self._splitter.feed(frame):
                sent += self.stream.passed(piece, self._time_us)
            self._time_us += 10_000
        return sent


def attitudes(peer, count):
    return [peer.frame(ATTITUDE) for _ in range(count)]


def rolls(frames):
    return [fields["roll"] for _, _, fields in received(b"".join(frames))]


def sequences(frames):
    return [sequence for _, sequence, _ in received(b"".join(frames))]


def test_each_of_200_faults_changes_one_field_of_one_message():
    draw = random.Random(3)
    peer = Peer(seed=4)
    for number in range(200):
        version = 1 + number % 2
        kinds = [kind for kind in KINDS if numbers_of(kind) and (version == 2 or kind.id < 256)]
        kind = draw.choice(kinds)
        field = draw.choice(list(numbers_of(kind)))
        frames = [peer.frame(each, version=version) for each in (kind, HEARTBEAT, kind, kind, ATTITUDE)]
        nth = draw.choice([1, 2])
        stream = Stream(f"{kind.msgname}.{field}:flip@n={nth}", seed=number)
        sent = stream.send(frames)
        changed = [index for index, frame in enumerate(frames) if sent[index] != frame]
        assert changed == [[0, 2][nth - 1]]
        ((_, sequence, before),) = received(frames[changed[0]])
        ((_, new_sequence, after),) = received(sent[changed[0]])
        assert sequence == new_sequence
        assert [name for name in before if before[name] != after[name]] == [field.partition("[")[0]]
        (injection,) = stream.injections
        assert injection.activated
        assert injection.bit is not None
        assert injection.details["message"] == nth


@pytest.mark.parametrize(("operation", "after"), [("set=nan", "nan"), ("set=2.5", "2.5"), ("value=inf", "inf")])
def test_a_number_is_set(operation, after):
    frames = attitudes(Peer(), 3)
    stream = Stream(f"ATTITUDE.roll:{operation}@n=2")
    assert rolls(stream.send(frames)) == [rolls(frames)[0], after, rolls(frames)[2]]
    assert stream.faults[0].changed == 1


def test_bias_and_scale_of_an_integer():
    frames = [Peer(seed=seed).frame(BY_NAME["RC_CHANNELS"]) for seed in range(2)]
    before = [int(received(frame)[0][2]["chan1_raw"]) for frame in frames]
    stream = Stream("RC_CHANNELS.chan1_raw:bias=3@n=1", "RC_CHANNELS.chan2_raw:scale=1e9@n=2")
    first, second = (received(frame)[0][2] for frame in stream.send(frames))
    assert int(first["chan1_raw"]) == before[0] + 3
    assert second["chan2_raw"] == "65535"  # the largest that fits


def test_a_number_is_frozen():
    frames = attitudes(Peer(), 4)
    before = rolls(frames)
    assert rolls(Stream("ATTITUDE.roll:freeze@n=2").send(frames)) == [before[0], *[before[1]] * 3]


def test_the_same_number_again_is_reported_and_not_counted():
    frames = attitudes(Peer(), 2)
    stream = Stream("ATTITUDE.roll:scale=1:times=2")
    assert stream.send(frames) == frames
    assert stream.faults[0].changed == 0
    assert [injection.activated for injection in stream.injections] == [False, False]


@pytest.mark.parametrize(
    ("operation", "order"),
    [
        ("drop@n=2", [0, 2, 3, 4, 5]),
        ("drop:times=2@n=2", [0, 3, 4, 5]),
        ("duplicate=2@n=2", [0, 1, 1, 1, 2, 3, 4, 5]),
        ("delay=0.025@n=2", [0, 2, 3, 4, 1, 5]),
        ("reorder=2@n=2", [0, 2, 3, 1, 4, 5]),
        ("freeze@n=2", [0, 1, 1, 1, 1, 1]),
    ],
)
def test_operations_on_whole_messages_leave_consecutive_sequence_numbers(operation, order):
    frames = attitudes(Peer(), 6)
    sent = Stream(f"ATTITUDE:{operation}").send(frames)
    before = rolls(frames)
    assert rolls(sent) == [before[index] for index in order]
    assert sequences(sent) == list(range(len(order)))
    assert sent[0] == frames[0]


def test_a_lost_message_moves_the_numbers_of_its_sender_only():
    one, other = Peer(1), Peer(2)
    frames = [one.frame(ATTITUDE), other.frame(ATTITUDE), one.frame(HEARTBEAT), other.frame(HEARTBEAT)]
    sent = Stream("ATTITUDE:drop").send(frames)
    assert sent[0] == frames[1]
    assert sequences(sent) == [0, 0, 1]
    assert sent[2] == frames[3]


def test_a_condition_starts_a_fault():
    peer = Peer()
    frames = attitudes(peer, 4)
    times = [received(frame)[0][2]["time_boot_ms"] for frame in frames]
    third = f"time_boot_ms={times[2]}"
    assert len(Stream(f"ATTITUDE:drop@{third}").send(frames)) == 3


def test_a_number_of_a_signed_frame_is_refused_and_the_next_frame_changed():
    signed = Peer(2, is_signed=True)
    frames = [signed.frame(ATTITUDE), Peer().frame(ATTITUDE)]
    stream = Stream("ATTITUDE.roll:bit=3")
    sent = stream.send(frames)
    assert sent[0] == frames[0]
    assert sent[1] != frames[1]
    (reason,) = stream.faults[0].refusals
    assert "signed" in reason


def test_a_number_that_mavlink_1_lacks_is_refused():
    frames = [MavlinkFrame(Peer().frame(ATTITUDE, version=1))]
    short = BY_NAME["ATTITUDE_QUATERNION"]  # MAVLink 2 has added repr_offset_q
    content = bytes(32)
    from pymavlink.dialects.v20 import common

    message = common.MAVLink_message(short.id, short.msgname)
    old = bytes(message._pack(common.MAVLink(None), short.crc_extra, content, force_mavlink1=True))
    stream = Stream("ATTITUDE_QUATERNION.repr_offset_q[0]:set=1", "ATTITUDE:drop@roll>1e38")
    assert stream.send([old, frames[0].data]) == [old, frames[0].data]
    assert dict(stream.faults[0].refusals) == {"a frame of MAVLink 1 has no repr_offset_q[0]": 1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ATTITUD.roll:bit=3", "message 'ATTITUD': not known .did you mean 'ATTITUDE'"),
        ("ATTITUDE.rol:bit=3", "number of ATTITUDE 'rol': not known .did you mean 'roll'"),
        ("ATTITUDE:bit=3", "changes a number; allowed: ATTITUDE.NUMBER:bit=3"),
        ("ATTITUDE.roll:bit=32", "bit 32: allowed: 0 to 31"),
        ("ATTITUDE.roll:drop", "drop: changes no single number"),
        ("ATTITUDE.roll", "not known; allowed: bit=, flip"),
        ("ATTITUDE:drop@sim=3", "a link has no simulated time"),
        ("ATTITUDE:drop@rol>3", "number of ATTITUDE 'rol'"),
        ("HEARTBEAT.type:set=300", "allowed: whole numbers from 0 to 255"),
        ("STATUSTEXT.text:bit=3", "number of STATUSTEXT 'text'"),
        ("", "message ''"),
    ],
)
def test_what_is_not_understood_is_refused_in_one_line(text, message):
    with pytest.raises(BadInputError, match=message) as refusal:
        MavlinkFault(text, ardupilotmega)
    assert "\n" not in str(refusal.value)
