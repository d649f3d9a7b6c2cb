"""Whole messages that are lost, late, repeated, frozen or out of order in flights."""

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from mavfi.levels.level import parse
from mavfi.levels.message import MessageLevel
from mavfi.levels.message.fault import MessageFault
from tests.core.flights.missions import Scripted, golden, mission


def message_fault(text, seed=0):
    return parse(text).resolve(seed, golden().profile)


def sent_and_received(text, state="control.command"):
    """Instants (us) and bytes of what the producer of a state sends and of what arrives, in order, in one flight."""
    loop = new_loop(mission())
    fault = message_fault(text)
    MessageLevel().inject(loop, fault, None)
    sent, received = [], []

    def note(messages):
        def add(publication, now):
            if publication.spec.name == state:
                messages.append((now, publication.header.tobytes() + publication.elements.tobytes()))

        return add

    loop.taps.seal = note(sent)
    loop.taps.recorders.append(note(received))
    return sent, received, loop.fly()


def test_lost_messages_do_not_arrive():
    sent, received, flight = sent_and_received("message:control.command:drop@3..4")
    assert received == [message for message in sent if not 3_000_000 <= message[0] <= 4_000_000]
    assert flight.log.injections[0].details == {"operation": "drop", "publications": 50}


def test_late_messages_arrive_when_their_delay_is_over_and_are_overtaken():
    sent, received, flight = sent_and_received("message:control.command:delay=0.25:times=20@3")
    late = [message for message in sent if message[0] >= 3_000_000][:20]
    expected = [message for message in sent if message not in late]
    expected += [(time_us + 250_000, content) for time_us, content in late]
    assert sorted(received) == sorted(expected) and received == sorted(received, key=lambda message: message[0])
    assert flight.log.digest() != golden().log.digest()


def test_repeated_messages_arrive_again_at_once():
    sent, received, _ = sent_and_received("message:control.command:duplicate=2:every=10@3..4")
    repeated = [message for message in sent if 3_000_000 <= message[0] <= 4_000_000][::10]
    assert received == [message for message in sent for _ in range(3 if message in repeated else 1)]


def test_a_frozen_topic_repeats_its_first_message():
    sent, received, _ = sent_and_received("message:control.command:freeze@3")
    first = next(content for time_us, content in sent if time_us >= 3_000_000)
    assert received == [(time_us, first if time_us >= 3_000_000 else content) for time_us, content in sent]


def test_a_message_is_overtaken_by_later_ones():
    sent, received, _ = sent_and_received("message:control.command:reorder=3@n=100")
    contents = [content for _, content in sent]
    contents.insert(102, contents.pop(99))
    assert [content for _, content in received] == contents


def test_a_fault_can_begin_at_the_first_replan():
    sent, received, flight = sent_and_received(
        "message:planning.trajectory:drop@trajectory_seq>1", "planning.trajectory"
    )
    assert received == [sent[0], *sent[2:]] and flight.log.injections[0].time_s == sent[1][0] / 1e6


@pytest.mark.parametrize("state", ["sensor.depth", "perception.point_cloud", "perception.map_update"])
@pytest.mark.parametrize(
    "change", ["drop", "delay=0.7", "delay=0.15:times=0", "duplicate:times=0", "reorder=2:times=3"]
)
def test_the_camera_goes_on_at_its_rate_whatever_happens_to_scans(state, change):
    text = f"message:{state}:{change}@2"
    flight = fly(mission(), message_fault(text), profile=True)
    received = flight.profile.times_us["sensor.depth"]
    if state == "sensor.depth":
        received = flight.profile.times_us["perception.point_cloud"]
    assert flight.log.injections[0].activated
    assert np.diff(received).max() < 900_000 and received[-1] > 1e6 * (flight.log.rows[-1, 0] - 1.0)
    images = mission().camera.period_us
    captured = flight.log.meta["publications"]["sensor.depth"]
    assert captured <= 2 * (flight.log.rows[-1, 0] * 1e6 / images), "scans must not multiply"


def test_a_detector_sees_what_is_late_and_nothing_of_what_is_lost():
    for change, missing in (("drop@3..4", 50), ("delay=0.5@3..4", 0)):
        loop, detector = new_loop(mission()), Scripted("control.command", n=10**6)
        MessageLevel().inject(loop, message_fault(f"message:control.command:{change}"), None)
        watch(loop, detector, RecoveryPolicy(grain="message"))
        sent = []
        loop.taps.seal = lambda state, now, sent=sent: sent.append(state.spec.name)
        flight = loop.fly()
        assert detector.seen == sent.count("control.command") - missing and flight.log.alarms == []


def test_a_detector_at_the_producer_is_not_asked_again_when_a_message_arrives_late():
    loop, detector = new_loop(mission()), Scripted("control.command", n=10**6)
    MessageLevel().inject(loop, message_fault("message:control.command:duplicate=5@3..4"), None)
    watch(loop, detector, RecoveryPolicy(detector_place="producer"))
    loop.fly()
    assert detector.seen == loop.record.publications["control.command"] - 5 * 50


def test_numbers_in_messages_of_other_programs_are_refused():
    with pytest.raises(
        BadInputError, match=r"fault in /scan.ranges: allowed in a flight: whole messages, message:STATE"
    ):
        fly(mission(), MessageFault("/scan", "ranges", 3))
