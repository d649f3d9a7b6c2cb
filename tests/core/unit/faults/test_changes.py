"""Operations on values and on whole publications: a stream of commands, and what arrives of it."""

import heapq
import json
from dataclasses import replace

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.faults.changes import Change, When, parse_text
from mavfi.faults.fault import NO_SITE, FaultSite, fault_from_json
from mavfi.faults.fields import number_in
from mavfi.faults.operations import Operation
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.message.injector import PublicationInjector
from mavfi.levels.state.fault import StateFault
from mavfi.levels.state.injector import StateInjector
from mavfi.states import new_state

COMMAND = "control.command"
PERIOD_US = 20_000


def command(number):
    state = new_state(COMMAND)
    state.header["vx"] = float(number)
    state.header["vy"] = -7.0
    return state


class Queue:
    """The event queue of a flight whose producer publishes every 20 ms."""

    def __init__(self):
        self.entries = []
        self.order = 0

    def transmit(self, state, time_us):
        self.order += 1
        heapq.heappush(self.entries, (time_us, self.order, state))

    def until(self, time_us):
        while self.entries and self.entries[0][0] <= time_us:
            yield heapq.heappop(self.entries)[2]


def value_fault(text, field="vx", **changes):
    change = parse_text(text)
    bit = change.operation.bit
    time_us = round(1e6 * change.when.start_s)
    when = replace(change.when, start_s=0.0)
    planned = change._replace(operation=replace(change.operation, bit=None), when=when)
    return StateFault(FaultSite(COMMAND, field), time_us, bit, change=planned, **changes)


def message_fault(text):
    change = parse_text(text)
    return MessageFault(
        COMMAND,
        time_us=round(1e6 * change.when.start_s),
        change=change._replace(when=replace(change.when, start_s=0.0)),
    )


# ---- values ----------------------------------------------------------------------------------------------------------
VALUES = {
    "set=nan:times=2@0.04": [0, 1, np.nan, np.nan, 4, 5],
    "set=2.5@vx>2": [0, 1, 2, 2.5, 4, 5],
    "bias=0.5@0.02..0.06": [0, 1.5, 2.5, 3.5, 4, 5],
    "scale=-1:every=2@0.02..": [0, -1, 2, -3, 4, -5],
    "freeze@n=3": [0, 1, 2, 2, 2, 2],
    "freeze:times=2@0.02": [0, 1, 1, 3, 4, 5],
    "bit=63:times=3@0.02": [0, -1, -2, -3, 4, 5],
}
"""First field of six commands 0, 1, 2, ..., by the change."""


def arriving_values(make, text):
    """What consumers receive of commands; all other fields must be as they were, and so must the producer's copies."""
    injector = make(value_fault(text))
    values = []
    for number in range(6):
        sent = command(number)
        seen = injector(sent, PERIOD_US * number)
        assert sent.same_bits(command(number)) and seen.value("vy") == -7.0
        values.append(seen.value("vx"))
    return values, injector


@pytest.mark.parametrize("text", VALUES)
def test_values_change_as_their_operation_says(text):
    values, injector = arriving_values(StateInjector, text)
    np.testing.assert_array_equal(values, VALUES[text])
    injection = injector.finish()[0]
    first = parse_text(text).operation.name
    assert injection.activated and injection.details["operation"].startswith(first.replace("flip", "bit"))
    assert injection.bit == parse_text(text).operation.bit
    assert json.loads(json.dumps(injection.to_json(), allow_nan=False))["site"] == f"{COMMAND}.vx"


def test_a_duration_begins_with_the_first_change():
    injector = StateInjector(value_fault("set=9:times=0@vx>1", lasts_s=0.04))
    assert [injector(command(n), PERIOD_US * n).value("vx") for n in range(7)] == [0, 1, 9, 9, 9, 5, 6]
    assert injector.spent and injector.finish()[0].details["publications"] == 3


def test_a_list_that_is_empty_is_passed_over_and_a_short_one_is_struck_at_its_end():
    change = parse_text("set=5")
    injector = StateInjector(StateFault(FaultSite("planning.path", "x", 7), change=change))
    empty = new_state("planning.path")
    assert injector(empty, 0) is empty and not injector.spent
    assert injector(new_state("planning.path", 3), 1).elements["x"].tolist() == [0, 0, 5]
    assert injector.finish()[0].site == "planning.path.x[2]"


def test_what_never_comes_is_not_activated():
    for fault in (value_fault("set=1@9"), replace(value_fault("set=1"), time_us=NO_SITE)):
        injector = StateInjector(fault)
        assert injector(command(3), 0).value("vx") == 3
        (injection,) = injector.finish()
        assert not injection.activated and injection.before is None
    assert injector.spent


def test_a_condition_reads_header_and_elements():
    state = new_state("planning.path", 2)
    state.header["junction"] = 4
    state.elements["y"] = [1.5, 2.5]
    assert [number_in(state, path) for path in ("junction", "y", "y[1]")] == [4, 1.5, 2.5]
    assert np.isnan(number_in(state, "y[2]"))


# ---- whole publications ----------------------------------------------------------------------------------------------
MESSAGES = {
    "drop:times=2@0.02": [0, 3, 4, 5],
    "drop@0.02..0.06": [0, 4, 5],
    "delay=0.05@0.02": [0, 2, 3, 1, 4, 5],
    "delay=0.04:times=2@0.02": [0, 1, 3, 2, 4, 5],
    "duplicate=2@n=2": [0, 1, 1, 1, 2, 3, 4, 5],
    "freeze@0.04": [0, 1, 2, 2, 2, 2],
    "freeze:times=2:every=2@0.04": [0, 1, 2, 3, 2, 5],
    "reorder@vx>0": [0, 2, 1, 3, 4, 5],
    "reorder=3@n=2": [0, 2, 3, 4, 1, 5],
    "reorder:times=2@n=2": [0, 1, 3, 2, 4, 5],
}
"""First field of what arrives of six commands 0, 1, 2, ..., by the change; at equal instants, what is late is first."""


def arriving_messages(make, text):
    """What arrives of commands; what is in the queue comes before a publication of the same instant."""
    queue = Queue()
    injector = make(message_fault(text), queue)
    arrived = []
    for number in range(6):
        now = PERIOD_US * number
        arrived += [state.value("vx") for state in queue.until(now)]
        sent = command(number)
        seen = injector(sent, now)
        assert sent.same_bits(command(number))
        if seen is not None:
            arrived.append(seen.value("vx"))
        arrived += [state.value("vx") for state in queue.until(now)]
    return arrived, injector


@pytest.mark.parametrize("text", MESSAGES)
def test_publications_arrive_as_their_operation_says(text):
    arrived, injector = arriving_messages(PublicationInjector, text)
    assert arrived == MESSAGES[text]
    (injection,) = injector.finish()
    operation = parse_text(text).operation
    assert injection.activated and injection.details["operation"] == str(operation)


class Copied(PublicationInjector):
    """Goes on as a copy of itself; another copy, which is discarded, sees other publications."""

    def __call__(self, state, time_us):
        discarded = self.copy()
        discarded._messages._send = lambda state, time_us: None
        PublicationInjector.__call__(discarded, command(99), time_us)
        copy = self.copy()
        seen = PublicationInjector.__call__(copy, state, time_us)
        self.__dict__.update(copy.__dict__)
        return seen


@pytest.mark.parametrize("text", MESSAGES)
def test_a_copy_goes_on_as_the_original(text):
    assert arriving_messages(Copied, text)[0] == MESSAGES[text]


# ---- data ------------------------------------------------------------------------------------------------------------
def test_stored_faults_have_a_change_as_text_and_published_ones_none():
    fault = value_fault("set=nan:times=3@2..4")
    data = fault.to_json()
    assert data["change"] == "set=nan:times=3@0..4" and fault_from_json(json.loads(json.dumps(data))) == fault
    assert "change" not in StateFault(FaultSite(COMMAND, "vx"), 0, 3).to_json()
    published = {"topic": "t", "field": "f", "bit": 3, "at": 2, "rate": None, "stratum": "", "weight": 1.0, "seed": 5}
    fault = fault_from_json({"level": "message", **published})
    assert fault.to_json() == {"level": "message", **published}
    assert fault.planned == Change(Operation("flip", bit=3), When(first=2))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: value_fault("drop"), "control.command.vx: drop: of whole publications; allowed: message:control.comm"),
        (lambda: value_fault("set=1", times=2), "times, share, width, also: allowed: those of the change"),
        (lambda: replace(value_fault("bit=3"), bit=None), "bit: None: allowed: of a flip"),
        (lambda: replace(value_fault("set=1"), bit=3), "bit: 3: allowed: of a flip, and none of another"),
        (lambda: value_fault("bit=64"), "control.command.vx: bit 64: allowed: 0 to 63"),
        (lambda: value_fault("set=1@speed>1"), "field 'speed': not known; allowed: vx"),
        (
            lambda: StateFault(FaultSite("planning.path", "length_x"), change=parse_text("set=1")),
            "set: is the length of a list; allowed: flips of a bit",
        ),
        (lambda: message_fault("set=1"), "control.command: set: allowed: drop, delay, duplicate, freeze, reorder"),
        (lambda: MessageFault("t", change=parse_text("drop"), at=3), "t: bit, at, rate: allowed: those of the change"),
        (lambda: fault_from_json({"level": "message", "topic": "t", "change": "lose"}), "'lose': not known"),
    ],
)
def test_changes_that_cannot_be_are_refused(make, message):
    with pytest.raises(BadInputError, match=message):
        make()
