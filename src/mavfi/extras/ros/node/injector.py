"""Flips bits in numbers of messages in transit, and records each injection."""

import random
import threading
import time
from collections.abc import Callable
from typing import Protocol

from mavfi.errors import BadInputError
from mavfi.faults.fault import MessageFault
from mavfi.faults.levels.message.definition import AbsentError, Definition, Leaf, flip_bit
from mavfi.record import Injection


class MessageSink(Protocol):
    """Forwards messages of one definition to a topic."""

    definition: Definition
    topic: str

    def send(self, message: bytes) -> int:
        """Forward a message; returns the number of subscribers that received it."""


def check_fault(fault: MessageFault, definition: Definition) -> None:
    """Raise a BadInputError, with the allowed values, for a field or bit that the message type does not have."""
    kind = definition.check(fault.field)
    bits = Leaf(0, kind).bits
    if fault.bit is not None and not 0 <= fault.bit < bits:
        raise BadInputError(f"bit {fault.bit}: {fault.field} is a {kind}; allowed: 0 to {bits - 1}")


class MessageInjector:
    """Changes messages in a relay, and calls `tell` with each injection.

    Attributes:
        injections: With times in seconds since construction.  An injection is activated if the sent bytes differ from
            the received ones in this bit only, and a subscriber received them.
        done: Set after the first injection was sent.
        too_short: Messages due for injection that do not contain the element.
    """

    def __init__(self, fault: MessageFault, tell: Callable[[Injection], None] | None = None) -> None:
        self.fault = fault
        self._tell = tell
        self.injections: list[Injection] = []
        self.done = threading.Event()
        self.too_short = 0
        self._began = time.monotonic()
        self._message_count = 0
        self._is_stopped = False
        self._choices = random.Random(fault.seed)
        self._lock = threading.Lock()

    def __call__(self, message: bytes, outlet: MessageSink) -> bytes:
        """Forward a message, changed or unchanged."""
        with self._lock:
            self._message_count += 1
            if self._is_due():
                try:
                    leaf = outlet.definition.locate(message, self.fault.field)
                except AbsentError:
                    self.too_short += 1
                else:
                    return self._inject(message, leaf, outlet)
            outlet.send(message)
            return message

    def stop(self) -> None:
        """Stop injecting; messages are still forwarded."""
        with self._lock:
            self._is_stopped = True

    def _is_due(self) -> bool:
        if self._is_stopped or self._message_count < self.fault.at:
            return False
        if self.fault.rate is None:
            return not self.done.is_set()
        return self._choices.random() < self.fault.rate

    def _inject(self, message: bytes, leaf: Leaf, outlet: MessageSink) -> bytes:
        """Flip a bit, send the message, and record the injection."""
        bit = self.fault.bit
        if bit is None:
            bit = self._choices.randrange(leaf.bits)
        changed = flip_bit(message, leaf, bit)
        readers = outlet.send(changed)
        # activated: exactly this bit has left, and somebody received it
        difference = int.from_bytes(message, "little") ^ int.from_bytes(changed, "little")
        activated = len(message) == len(changed) and difference == 1 << (8 * leaf.offset + bit) and readers > 0
        injection = Injection(
            "message",
            f"{outlet.topic}.{self.fault.field}",
            round(time.monotonic() - self._began, 6),
            bit,
            leaf.value(message),
            leaf.value(changed),
            activated,
            details={
                "topic": outlet.topic,
                "message": self._message_count,
                "field": self.fault.field,
                "kind": leaf.kind,
                "readers": readers,
            },
        )
        self.injections.append(injection)
        self.done.set()
        if self._tell is not None:
            self._tell(injection)
        return changed
