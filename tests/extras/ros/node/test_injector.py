"""Bits of messages that are flipped on their way."""

import time

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.ros.node.injector import MessageInjector, check_fault
from mavfi.extras.ros.node.message import Composer
from mavfi.faults.fault import MessageFault
from mavfi.faults.levels.message.definition import Definition
from mavfi.faults.operations import parse_text

COMPOSER = Composer("sensor_msgs/JointState")
MESSAGE = COMPOSER.pack({"name": ["a"], "position": [0.5]})
DEFINITION = Definition("sensor_msgs/JointState", COMPOSER.header["message_definition"])


class FakeRelay:
    """Somebody gets the messages."""

    definition, topic, readers = DEFINITION, "/t", 2

    def __init__(self):
        self.sent = []

    def send(self, message):
        self.sent.append(message)
        return self.readers


def test_the_named_message_is_changed_and_no_other():
    relay, reported = FakeRelay(), []
    injector = MessageInjector(MessageFault("/t", "position[0]", 51, at=3), reported.append)
    for _ in range(5):
        injector(MESSAGE, relay)
    assert [message == MESSAGE for message in relay.sent] == [True, True, False, True, True]
    (injection,) = reported
    assert (injection.details["message"], injection.before, injection.after, injection.details["readers"]) == (
        3,
        0.5,
        0.75,
        2,
    )
    assert injection.activated and injector.done.is_set() and reported == injector.injections


def test_a_rate_draws_from_the_seed_and_stops_on_request():
    def injections(seed):
        relay, injector = FakeRelay(), MessageInjector(MessageFault("/t", "position[0]", rate=0.3, seed=seed))
        for _ in range(200):
            injector(MESSAGE, relay)
        injector.stop()
        injector(MESSAGE, relay)
        assert relay.sent[-1] == MESSAGE and len(relay.sent) == 201
        return [(injection.details["message"], injection.bit) for injection in injector.injections]

    assert injections(1) == injections(1) != injections(2) and 30 < len(injections(1)) < 90


@pytest.mark.parametrize("change", ["bit=30@0", "drop@position[9]>0.1"])
def test_an_index_beyond_a_list_is_said_after_a_few_messages(change):
    """The fault waits for a longer list, and says so: of its own number, and of that of its condition."""
    relay, told = FakeRelay(), []
    field = "position[9]" * change.startswith("bit")
    fault = MessageFault("/t", field, change=parse_text(change))
    injector = MessageInjector(fault, None, lambda text, is_last: told.append((text, is_last)))
    for _ in range(5):
        injector(MESSAGE, relay)
    line = "field position[9]: position has 1 elements in this message"
    assert told == [(f"message {number}: {line}", number == 3) for number in (1, 2, 3)]
    assert injector.too_short == 5 and relay.sent == [MESSAGE] * 5
    longer = COMPOSER.pack({"position": [0.5] * 10})
    injector(longer, relay)
    assert len(injector.injections) == 1 and injector.done.is_set()


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"field": "position[0]", "at": 0}, "at: 0: allowed: 1 or more"),
        ({"field": "position[0]", "rate": 0.0}, "allowed: above 0, to 1"),
        ({"field": "position[0]", "bit": 64}, "allowed: 0 to 63"),
        ({"field": "header.seq", "bit": 32}, "bit 32: header.seq is a uint32; allowed: 0 to 31"),
        ({"field": "header.seq", "change": parse_text("set=nan")}, "set=nan: header.seq is a uint32; allowed: whole"),
        ({"change": parse_text("drop@speed>1")}, "'speed': not known"),
    ],
)
def test_faults_that_cannot_be_are_refused(fault, message):
    with pytest.raises(BadInputError) as error:
        check_fault(MessageFault("/t", **fault), DEFINITION)
    assert message in str(error.value)


def forwarded(change, numbers, seed=0, field=""):
    """What subscribers get of messages with these positions."""
    relay, fault = FakeRelay(), MessageFault("/t", field, seed=seed, change=parse_text(change))
    check_fault(fault, DEFINITION)
    injector = MessageInjector(fault)
    for number in numbers:
        injector(COMPOSER.pack({"name": ["a"], "position": [number]}), relay)
    leaf = DEFINITION.locate(MESSAGE, "position[0]")
    return [leaf.value(message) for message in relay.sent], injector


@pytest.mark.parametrize(
    ("change", "field", "expected"),
    [
        ("drop:times=2@n=2", "", [0, 3, 4]),
        ("duplicate=2@n=3", "", [0, 1, 2, 2, 2, 3, 4]),
        ("freeze:every=2@n=2", "", [0, 1, 2, 1, 4]),
        ("reorder=2@n=2", "", [0, 2, 3, 1, 4]),
        ("reorder:times=2@n=2", "", [0, 1, 3, 2, 4]),
        ("set=nan@position[0]>2", "position[0]", [0, 1, 2, float("nan"), 4]),
        ("bias=0.5:times=0:every=2", "position[0]", [0.5, 1, 2.5, 3, 4.5]),
        ("scale=-1:times=0@n=4", "position[0]", [0, 1, 2, -3, -4]),
        ("freeze@n=3", "position[0]", [0, 1, 2, 2, 2]),
        ("bit=63:times=2@n=2", "position[0]", [0, -1, -2, 3, 4]),
    ],
)
def test_operations_on_whole_messages_and_numbers(change, field, expected):
    numbers, injector = forwarded(change, range(5), field=field)
    assert numbers == pytest.approx(expected, nan_ok=True)
    assert all(injection.activated for injection in injector.injections)
    assert injector.done.is_set() == ("times=0" not in change and "freeze" not in change)


def test_a_late_message_arrives_after_those_that_overtake_it():
    relay, injector = FakeRelay(), MessageInjector(MessageFault("/t", change=parse_text("delay=0.02")))
    second = COMPOSER.pack({"name": ["a"], "position": [1.5]})
    injector(MESSAGE, relay)
    injector(second, relay)
    assert relay.sent == [second]
    end = time.monotonic() + 5.0
    while len(relay.sent) < 2 and time.monotonic() < end:
        time.sleep(0.005)
    assert relay.sent == [second, MESSAGE]
