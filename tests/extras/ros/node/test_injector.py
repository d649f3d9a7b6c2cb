"""Bits of messages that are flipped on their way."""

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.ros.node.injector import MessageInjector, check_fault
from mavfi.extras.ros.node.message import Composer
from mavfi.faults.fault import MessageFault
from mavfi.faults.levels.message.definition import Definition

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


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"field": "position[0]", "at": 0}, "at: 0: allowed: 1 or more"),
        ({"field": "position[0]", "rate": 0.0}, "allowed: above 0, to 1"),
        ({"field": "position[0]", "bit": 64}, "allowed: 0 to 63"),
        ({"field": "header.seq", "bit": 32}, "allowed: 0 to 31"),
    ],
)
def test_faults_that_cannot_be_are_refused(fault, message):
    with pytest.raises(BadInputError) as error:
        check_fault(MessageFault("/t", **fault), DEFINITION)
    assert message in str(error.value)
