"""Flips bits in numbers of messages on their way, and keeps a record of each."""

import random
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from mavfi.errors import BadInputError
from mavfi.hosts.node.definition import FORMATS, AbsentError, Definition, Leaf, flip_bit
from mavfi.hosts.node.relay import Relay


@dataclass(frozen=True, slots=True)
class MessageFault:
    """Which bits of which messages.

    Attributes:
        field: Path of a number, e.g. `position[0]`.
        bit: 0 = least significant; None = drawn for each strike.
        at: The first message that may be struck; they are counted from 1.
        rate: Probability that a message is struck; None = one message is struck, once.
        seed: Draws messages and bits.
    """

    field: str
    bit: int | None = None
    at: int = 1
    rate: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.at < 1:
            raise BadInputError(f"at: {self.at}: allowed: 1 or more")
        if self.rate is not None and not 0.0 < self.rate <= 1.0:
            raise BadInputError(f"rate: {self.rate}: allowed: above 0, to 1")

    def check(self, definition: Definition) -> None:
        """Refuse a field or bit that messages of this type do not have.

        Raises:
            BadInputError: One line with what is allowed.
        """
        kind = definition.check(self.field)
        bits = 8 * struct.calcsize(FORMATS[kind])
        if self.bit is not None and not 0 <= self.bit < bits:
            raise BadInputError(f"bit {self.bit}: {self.field} is a {kind}; allowed: 0 to {bits - 1}")


@dataclass(frozen=True, slots=True)
class MessageInjection:
    """One strike.

    Attributes:
        topic: Of the message.
        message: Its number, counted from 1.
        time_s: When, by this machine's clock (s since 1970).
        field: Path of the number.
        kind: Its type.
        bit: Which bit was flipped.
        before: Value before.
        after: Value that readers got.
        readers: How many got it.
        verified: Whether the bytes that were sent differ from those that came in this bit alone, and a reader got them.
    """

    topic: str
    message: int
    time_s: float
    field: str
    kind: str
    bit: int
    before: int | float
    after: int | float
    readers: int
    verified: bool

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


class Corruptor:
    """What a relay does to messages.

    Args:
        fault: Which bits.
        tell: Called with each strike.

    Attributes:
        injections: What was done.
        struck: Set when a fault that strikes once has struck, and was sent.
        too_short: Messages that should have been struck and do not hold the element.
    """

    def __init__(self, fault: MessageFault, tell: Callable[[MessageInjection], None] | None = None) -> None:
        self.fault, self._tell = fault, tell
        self.injections: list[MessageInjection] = []
        self.struck = threading.Event()
        self.too_short = 0
        self._seen = 0
        self._stopped = False
        self._choices = random.Random(fault.seed)
        self._lock = threading.Lock()

    def __call__(self, message: bytes, relay: Relay) -> bytes:
        """Pass a message on, struck or as it is."""
        with self._lock:
            self._seen += 1
            if self._strikes():
                try:
                    leaf = relay.definition.locate(message, self.fault.field)
                except AbsentError:
                    self.too_short += 1
                else:
                    return self._strike(message, leaf, relay)
            relay.send(message)
            return message

    def stop(self) -> None:
        """Strike no more; messages still pass."""
        with self._lock:
            self._stopped = True

    def _strikes(self) -> bool:
        if self._stopped or self._seen < self.fault.at:
            return False
        if self.fault.rate is None:
            return not self.struck.is_set()
        return self._choices.random() < self.fault.rate

    def _strike(self, message: bytes, leaf: Leaf, relay: Relay) -> bytes:
        bit = self._choices.randrange(leaf.bits) if self.fault.bit is None else self.fault.bit
        changed = flip_bit(message, leaf, bit)
        readers = relay.send(changed)
        difference = int.from_bytes(message, "little") ^ int.from_bytes(changed, "little")
        done = MessageInjection(
            relay.to, self._seen, time.time(), self.fault.field, leaf.kind, bit, leaf.value(message),
            leaf.value(changed), readers,
            len(message) == len(changed) and difference == 1 << (8 * leaf.offset + bit) and readers > 0,
        )  # fmt: skip
        self.injections.append(done)
        self.struck.set()
        if self._tell is not None:
            self._tell(done)
        return changed
