"""Changes messages in transit, whole ones or numbers in them, and records each injection."""

import random
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.fault import MessageFault
from mavfi.faults.levels.message.definition import FORMATS, AbsentError, Definition, Leaf
from mavfi.faults.levels.state_injector import schedule_of
from mavfi.faults.operations import Operation, changed_number, check_number_operation
from mavfi.record import Injection


class MessageSink(Protocol):
    """Forwards messages of one definition to a topic."""

    definition: Definition
    topic: str

    def send(self, message: bytes) -> int:
        """Forward a message; returns the number of subscribers that received it."""


class TellRefusal(Protocol):
    """Tells that a message was not changed."""

    def __call__(self, refusal: str, *, is_last: bool) -> None:
        """`is_last`: further ones are not told."""


def check_fault(fault: MessageFault, definition: Definition) -> None:
    """Raise a BadInputError, with the allowed values, for a field or change that the message type does not have."""
    operation, when = fault.planned
    if when.condition is not None:
        definition.check(when.condition.field)
    if not fault.field:
        return
    kind = definition.check(fault.field)
    if operation.name == "freeze":
        return
    try:
        check_number_operation(operation, _dtype(kind))
    except BadInputError as error:
        name, _, allowed = str(error).partition(":")
        raise BadInputError(f"{name}: {fault.field} is a {kind};{allowed}") from None


def _dtype(kind: str) -> str:
    """NumPy's name of a numeric type of ROS; a flag is a byte."""
    return np.dtype(f"<{FORMATS[kind]}").str


def with_number(message: bytes, leaf: Leaf, value: float) -> bytes:
    """The message with another value of a number."""
    word = np.array(value).astype(_dtype(leaf.kind)).tobytes()
    return message[: leaf.offset] + word + message[leaf.offset + len(word) :]


MAX_REFUSALS = 3
"""Messages without the element that are told of, as in ROS 2."""


@dataclass(slots=True)
class HeldBytes:
    """A message that waits until `remaining` others have passed."""

    message: bytes
    remaining: int


class MessageInjector:
    """Changes messages in a relay.

    Args:
        fault: The planned change.
        tell: Called with each injection.
        tell_refusal: Called with each of `refusals`, and whether it is the last of them.

    Attributes:
        injections: With times in seconds since construction.  One in a number is activated if the sent bytes differ
            from the received ones in this number only, as planned, and a subscriber received them; one of a whole
            message always is.
        done: Set after the last injection was sent, if there is a last one.
        too_short: Messages that do not contain the element when they are due, or that of the condition.
        refusals: What the first few of these have instead, one line each.
    """

    def __init__(
        self,
        fault: MessageFault,
        tell: Callable[[Injection], None] | None = None,
        tell_refusal: TellRefusal | None = None,
    ) -> None:
        self.fault = fault
        self._tell = tell
        self._tell_refusal = tell_refusal
        self.refusals: list[str] = []
        self.injections: list[Injection] = []
        self.done = threading.Event()
        self.too_short = 0
        self._began = time.monotonic()
        self._operation, when = fault.planned
        self._schedule = schedule_of(when, fault.time_us, fault.seed)
        self._message_count = 0
        self._is_stopped = False
        self._choices = random.Random(fault.seed)
        self._lock = threading.Lock()
        self._frozen: bytes | None = None  # the message that a frozen topic repeats
        self._frozen_value = 0.0  # value at which a frozen number is stuck, if there was an injection
        self._held: list[HeldBytes] = []

    def __call__(self, message: bytes, outlet: MessageSink) -> bytes:
        """Forward a message, changed or unchanged; returns what was sent now."""
        with self._lock:
            self._message_count += 1
            now_s = time.monotonic() - self._began
            if self._is_stopped or not self._schedule.due(now_s, lambda path: self._number(message, path, outlet)):
                outlet.send(message)
                self._release(outlet)
                return message
            if not self.fault.field:
                return self._inject_whole(message, outlet)
            try:
                leaf = outlet.definition.locate(message, self.fault.field)
            except AbsentError as error:
                self._note_absent(error)
                self._schedule.take_back()
                outlet.send(message)
                return message
            return self._inject(message, leaf, outlet)

    def _note_absent(self, error: AbsentError) -> None:
        """Count a message without the element, and tell of the first few."""
        self.too_short += 1
        if self.too_short > MAX_REFUSALS:
            return
        refusal = f"message {self._message_count}: {error}"
        self.refusals.append(refusal)
        if self._tell_refusal is not None:
            self._tell_refusal(refusal, is_last=self.too_short == MAX_REFUSALS)

    def _number(self, message: bytes, path: str, outlet: MessageSink) -> float:
        """A number of a message for the condition; NaN if the message lacks it."""
        try:
            return float(outlet.definition.locate(message, path).value(message))
        except AbsentError as error:
            self._note_absent(error)
            return float("nan")

    def stop(self) -> None:
        """Stop injecting; messages are still forwarded."""
        with self._lock:
            self._is_stopped = True

    # ---- a number in a message --------------------------------------------------------------------------------------
    def _inject(self, message: bytes, leaf: Leaf, outlet: MessageSink) -> bytes:
        """Change a number, send the message, and record the injection."""
        before = leaf.value(message)
        operation = self._operation
        if operation.name == "flip" and operation.bit is None:
            operation = replace(operation, bit=self._choices.randrange(leaf.bits))
        if operation.name == "freeze":
            if not self.injections:
                self._frozen_value = before
            after: float = self._frozen_value
        else:
            after = changed_number(operation, before, _dtype(leaf.kind))
        changed = with_number(message, leaf, after)
        readers = outlet.send(changed)
        # activated: this number alone has left otherwise, and somebody received it
        end = leaf.offset + leaf.bits // 8
        is_same_elsewhere = message[: leaf.offset] == changed[: leaf.offset] and message[end:] == changed[end:]
        is_as_planned = self._is_as_planned(message, changed, leaf, operation)
        details = {"field": self.fault.field, "kind": leaf.kind}
        activated = is_same_elsewhere and is_as_planned and readers > 0
        self._record(outlet, operation, readers, before, leaf.value(changed), details, is_activated=activated)
        return changed

    def _is_as_planned(self, message: bytes, changed: bytes, leaf: Leaf, operation: Operation) -> bool:
        """Whether the number was changed: a flip inverts exactly its bit, other operations may leave it as it was."""
        if operation.name != "flip":
            return True
        assert operation.bit is not None  # drawn before
        difference = int.from_bytes(message, "little") ^ int.from_bytes(changed, "little")
        return difference == 1 << (8 * leaf.offset + operation.bit)

    # ---- a whole message --------------------------------------------------------------------------------------------
    def _inject_whole(self, message: bytes, outlet: MessageSink) -> bytes:
        """Lose, delay, repeat, freeze or reorder a message; returns what was sent now."""
        operation = self._operation
        sent = b""
        readers = 0
        if operation.name == "delay":
            assert operation.value is not None  # a delay has one
            timer = threading.Timer(operation.value, outlet.send, [message])
            timer.daemon = True
            timer.start()
        elif operation.name == "duplicate":
            for _ in range(1 + operation.count):
                readers = outlet.send(message)
            sent = message
        elif operation.name == "freeze":
            if self._frozen is None:
                self._frozen = message
            sent = self._frozen
            readers = outlet.send(sent)
        self._release(outlet)
        if operation.name == "reorder":
            self._held.append(HeldBytes(message, operation.count))
        self._record(outlet, operation, readers, None, None, {"field": ""}, is_activated=True)
        return sent

    def _release(self, outlet: MessageSink) -> None:
        """Count a message that has passed, and send those that enough of them have overtaken."""
        for held in list(self._held):
            held.remaining -= 1
            if held.remaining == 0:
                self._held.remove(held)
                outlet.send(held.message)

    # ---- the record -------------------------------------------------------------------------------------------------
    def _record(
        self,
        outlet: MessageSink,
        operation: Operation,
        readers: int,
        before: float | None,
        after: float | None,
        details: dict[str, str],
        *,
        is_activated: bool,
    ) -> None:
        """Record the injection, and tell of it."""
        site = outlet.topic
        if self.fault.field:
            site = f"{outlet.topic}.{self.fault.field}"
        injection = Injection(
            "message",
            site,
            round(time.monotonic() - self._began, 6),
            operation.bit,
            before,
            after,
            is_activated,
            details={
                "topic": outlet.topic,
                "message": self._message_count,
                **details,
                "readers": readers,
                "operation": str(operation),
            },
        )
        self.injections.append(injection)
        if self._schedule.is_over:
            self.done.set()
        if self._tell is not None:
            self._tell(injection)
