"""One change of a value or message: what is done, when, and how often; for flights, ROS, AirSim and MAVLink alike.

As text, behind the site of a fault and separated by colons (on a command line for ROS also by spaces):

    bit=30@10            set=nan@10..12          bias=0.5:every=5@10..
    drop@n=100           delay=0.2:times=20@n=1  scale=1.1:share=0.1@linear.x>0.5

First what is done, then how often, then from when on; see `parse_change`.

A value is changed through a `Carrier`, which reads and writes it; whatever it is in (a state, a memory, a message):

    class PayloadField:
        def __init__(self, payload: bytearray, offset: int, dtype: str) -> None: ...
        def read(self) -> np.ndarray:
            return np.frombuffer(self.payload, self.dtype, 1, self.offset).copy()
        def write(self, word: np.ndarray) -> None:
            self.payload[self.offset : self.offset + word.itemsize] = word.tobytes()

    injector = ChangeInjector.of(parse_text("bit=31:times=3@n=10"), seed=1)
    for message in messages:
        if injector.due(message.time_us, message.number_at):
            values = injector.change(PayloadField(message.payload, 4, "f4"))  # the numbers before and after

Whole messages are changed by a `MessageInjector`.
"""

import math
import operator
import re
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from mavfi.errors import BadInputError, not_known
from mavfi.faults.operations import (
    MEANING,
    OPERATIONS,
    SYNONYMS,
    Number,
    Operation,
    changed_number,
    number_text,
    parse_operation,
    read_number,
)

_COMPARISONS: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
}
_CONDITION = re.compile(r"([A-Za-z_][\w.\[\]]*)(>=|<=|>|<|=)(.+)")
_DURATION = re.compile(r"inf|\d+(\.\d*)?")
_MESSAGE = "n"
_SIM = "sim"
_TIMES_FOR_EVER = 0
LATEST_S = 1e9
"""Latest instant of a fault (s): far beyond any flight, and still exact in microseconds."""

# Constants of splitmix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, OOPSLA 2014).
_GAMMA = 0x9E3779B97F4A7C15
_MIX = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
_MASK = (1 << 64) - 1


# ---- when, and how often ---------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class Condition:
    """A comparison of a number of the message with a constant, e.g. `trajectory_seq>1`."""

    field: str
    comparison: str
    value: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise BadInputError(f"{self.field}{self.comparison}{self.value}: allowed: finite numbers")

    def holds(self, value: float) -> bool:
        """Whether it holds for the value of the field; never for NaN."""
        return _COMPARISONS[self.comparison](value, self.value)

    def __str__(self) -> str:
        return f"{self.field}{self.comparison}{number_text(self.value)}"


@dataclass(frozen=True, slots=True)
class When:
    """Which messages a fault changes.

    Attributes:
        first: Number of the first message that may be changed, counted from 1.
        start_s: Earliest instant (s): of the flight; of a running graph, since the fault was armed.
        end_s: Latest instant (s).
        sim_time: Whether these instants are in the graph's simulated time (`/clock`).
        condition: The fault begins with the first message for which it holds; None = with any.
        times: Number of changed messages; 0 = without limit.
        every: Of the messages from the first changed one on, only every n-th is changed.
        share: Probability that a message is changed, drawn from the fault's seed and the number of the message.

    Raises:
        BadInputError: A number out of range.
    """

    first: int = 1
    start_s: float = 0.0
    end_s: float = math.inf
    sim_time: bool = False
    condition: Condition | None = None
    times: int = 1
    every: int = 1
    share: float = 1.0

    def __post_init__(self) -> None:
        for key, is_allowed, allowed in (
            ("first", self.first >= 1, "1 or more"),
            ("start_s", 0.0 <= self.start_s < math.inf, "0 or more"),
            ("end_s", self.end_s >= self.start_s, f"{self.start_s:g} or more"),
            ("times", self.times >= 0, "0 (no limit) or more"),
            ("every", self.every >= 1, "1 or more"),
            ("share", 0.0 < self.share <= 1.0, "above 0, to 1"),
        ):
            if not is_allowed:
                raise BadInputError(f"{key}: {getattr(self, key)}: allowed: {allowed}")

    @property
    def counts_messages(self) -> bool:
        """Whether it depends on the number of messages since the start."""
        return self.first > 1 or self.share < 1.0

    def starting_at(self, time_us: int) -> "When":
        """The same messages from an instant on (us; a negative one is that of no site)."""
        start_s = max(time_us, 0) / 1e6
        return replace(self, start_s=start_s, end_s=max(self.end_s, start_s))

    def __str__(self) -> str:
        options = "".join(f":{key}={number_text(value)}" for key, value, default in self._options() if value != default)
        return f"{options}@{self._instant()}"

    def _options(self) -> tuple[tuple[str, float, float], ...]:
        """Key, value and default of what stands before the `@`."""
        default_times = 1
        if math.isfinite(self.end_s) and self.condition is None and self.first == 1:
            default_times = _TIMES_FOR_EVER
        return (("times", self.times, default_times), ("every", self.every, 1), ("share", self.share, 1.0))

    def _instant(self) -> str:
        """What stands behind the `@`."""
        if self.condition is not None:
            return str(self.condition)
        if self.first > 1:
            return f"{_MESSAGE}={self.first}"
        text = number_text(self.start_s)
        if math.isfinite(self.end_s):
            text += f"..{number_text(self.end_s)}"
        if self.sim_time:
            text = f"{_SIM}={text}"
        return text


class Change(NamedTuple):
    """What is done, and when; as text it is what `parse_text` reads.

    Attributes:
        operation: What is done.
        when: To which messages.
        lasts_s: Time from the first changed message on in which others are changed (s); 0 = as long as `when` allows.
    """

    operation: Operation
    when: When
    lasts_s: float = 0.0

    def __str__(self) -> str:
        when = str(self.when)
        if self.operation.name == "freeze":  # for ever, unless the text has a number of times
            when = when.replace(":times=0", "")
            if self.when.times == 1 and ":times=" not in when:
                when = f":times=1{when}"
        if self.lasts_s > 0.0:
            options, at, instant = when.partition("@")
            when = f"{options}:lasts={self.lasts_s}{at}{instant}"
        return f"{self.operation}{when}"

    @property
    def name(self) -> str:
        """The text without the instant: one of the operations of a campaign."""
        return str(self).partition("@")[0]

    # ---- faults hold bit, instant and duration as fields of their own ------------------------------------------------
    def without_fields(self) -> "Change":
        """The change without what faults hold as fields: bit, earliest instant and duration.

        A flight has one time: instants in simulated time are instants of the flight.

        Raises:
            BadInputError: The instant is too late.
        """
        if not self.when.start_s <= LATEST_S:
            raise BadInputError(f"instant {self.when.start_s:g} s; allowed: 0 to {LATEST_S:g}")
        return Change(replace(self.operation, bit=None), replace(self.when, start_s=0.0, sim_time=False))

    def with_fields(self, bit: int | None, time_us: int, lasts_s: float = 0.0) -> "Change":
        """Inverse of `without_fields`."""
        return Change(replace(self.operation, bit=bit), self.when.starting_at(time_us), lasts_s or self.lasts_s)


class ReadsField(Protocol):
    """Reads a number of the current message by its path."""

    def __call__(self, field: str) -> float:
        """Value of the field; NaN if the message lacks it."""


class Schedule(Protocol):
    """Decides, message by message, which ones a fault changes."""

    changed: int

    @property
    def is_over(self) -> bool:
        """Whether no further message will be changed, whatever comes."""

    def due(self, time_s: float, read: ReadsField) -> bool:
        """Whether the next message, at this instant (s), is changed; to be called for each message in order."""

    def take_back(self) -> None:
        """The message that was due cannot be changed: it does not count as a changed one."""


class MessageSchedule:
    """The messages that a `When` selects.

    A C program makes the same decisions inside ROS nodes (`extras/ros/ros2/interposer`).
    """

    def __init__(self, when: When, seed: int = 0, lasts_s: float = 0.0) -> None:
        self.changed = 0
        self._when = when
        self._seed = seed
        self._lasts_us = 1e6 * lasts_s
        self._latest_us = math.inf  # of a change that lasts for some time, from the first changed message on
        self._messages = 0
        self._since_begin = -1  # messages since the first one that could be changed; -1 = it has not come
        self._is_late = False  # whether a message came after the latest instant

    @property
    def is_over(self) -> bool:
        """See `Schedule.is_over`."""
        return self._is_late or (self._when.times != _TIMES_FOR_EVER and self.changed >= self._when.times)

    def due(self, time_s: float, read: ReadsField) -> bool:
        """See `Schedule.due`."""
        when = self._when
        self._messages += 1
        time_us = round(1e6 * time_s)
        self._is_late = self._is_late or time_s > when.end_s or time_us > self._latest_us
        if self.is_over:
            return False
        if self._since_begin < 0:
            if self._messages < when.first or time_s < when.start_s:
                return False
            if when.condition is not None and not when.condition.holds(read(when.condition.field)):
                return False
        self._since_begin += 1
        if self._since_begin % when.every != 0 or not happens(self._seed, self._messages, when.share):
            return False
        self.changed += 1
        if self._lasts_us > 0.0 and self.changed == 1:
            self._latest_us = time_us + self._lasts_us
        return True

    def take_back(self) -> None:
        """See `Schedule.take_back`."""
        self.changed -= 1
        if self.changed == 0:
            self._latest_us = math.inf


def happens(seed: int, message: int, share: float) -> bool:
    """Whether an event of probability `share` happens at a message: a hash of the seed and its number (splitmix64)."""
    if share == 1.0:
        return True
    word = (seed + message * _GAMMA) & _MASK
    word = ((word ^ (word >> 30)) * _MIX[0]) & _MASK
    word = ((word ^ (word >> 27)) * _MIX[1]) & _MASK
    word ^= word >> 31
    return (word >> 11) / 2**53 < share


# ---- values ----------------------------------------------------------------------------------------------------------
class Carrier(Protocol):
    """A value that a fault changes: a field of a state, bytes of a message, an argument of a call."""

    def read(self) -> np.ndarray:
        """The value: an array of shape (1,) of its type, which may be changed."""

    def write(self, word: np.ndarray) -> None:
        """Put another value of the same type in its place."""


class Values(NamedTuple):
    """A value before and after a change."""

    before: Number
    after: Number


class ValueChange:
    """What a fault does to a value each time: it remembers at which bits the value is stuck, or frozen.

    Args:
        operation: What is done; a flip without a bit changes nothing.
        width: Number of adjacent bits that are flipped, starting at the operation's bit.
        is_stuck: Whether flipped bits keep the values that they had after the first flip.
    """

    def __init__(self, operation: Operation, *, width: int = 1, is_stuck: bool = False) -> None:
        self._operation = operation
        self._mask = 0
        if operation.bit is not None:
            self._mask = ((1 << width) - 1) << operation.bit
        self._is_stuck = is_stuck
        self._stuck_bits: int | None = None  # the word after the first flip
        self._frozen: np.ndarray | None = None

    def apply(self, carrier: Carrier) -> Values:
        """Change the value of a carrier."""
        word = carrier.read()
        before = word[0].item()
        self(word)
        carrier.write(word)
        return Values(before, word[0].item())

    def __call__(self, word: np.ndarray) -> None:
        """Change a word, an array of shape (1,), in place."""
        if self._operation.name == "flip":
            self._flip(word)
        elif self._operation.name == "freeze":
            if self._frozen is None:
                self._frozen = word.copy()
            word[:] = self._frozen
        else:
            word[:] = changed_number(self._operation, word[0].item(), word.dtype.str[1:])

    def _flip(self, word: np.ndarray) -> None:
        """Flip the bits, or set them as after the first flip; other bits stay exactly as they are, in NaN as well."""
        bits = int.from_bytes(word.tobytes(), "little")
        if self._stuck_bits is None or not self._is_stuck:
            self._stuck_bits = bits ^ self._mask
            bits = self._stuck_bits
        else:
            bits = (bits & ~self._mask) | (self._stuck_bits & self._mask)
        word[:] = np.frombuffer(bits.to_bytes(word.itemsize, "little"), word.dtype)


class ChangeInjector:
    """Changes the values of a stream of messages as a schedule says.

    Args:
        schedule: Which messages are changed.
        value: What is done to each value.
    """

    def __init__(self, schedule: Schedule, value: ValueChange) -> None:
        self._schedule = schedule
        self.value = value

    @classmethod
    def of(cls, change: Change, seed: int = 0) -> Self:
        """The injector of a change; the seed draws the messages of a share."""
        return cls(MessageSchedule(change.when, seed, change.lasts_s), ValueChange(change.operation))

    def copy(self) -> Self:
        """An independent copy in the same state."""
        other = copy(self)
        other._schedule = copy(self._schedule)
        other.value = copy(self.value)
        return other

    @property
    def changed(self) -> int:
        """Number of changed messages."""
        return self._schedule.changed

    @property
    def is_over(self) -> bool:
        """Whether no further message will be changed, whatever comes."""
        return self._schedule.is_over

    def due(self, time_us: int, read: ReadsField) -> bool:
        """Whether the next message, at this instant (us), is changed; to be called for each message in order."""
        return self._schedule.due(time_us / 1e6, read)

    def take_back(self) -> None:
        """The message that was due has no such value: it does not count as a changed one."""
        self._schedule.take_back()

    def change(self, carrier: Carrier) -> Values:
        """Change the value of a message that is due."""
        return self.value.apply(carrier)


# ---- whole messages --------------------------------------------------------------------------------------------------
Message = TypeVar("Message")


@dataclass(frozen=True, slots=True)
class HeldMessage(Generic[Message]):
    """A message that waits until others have passed: `remaining` of them."""

    message: Message
    remaining: int


class MessageInjector(Generic[Message]):
    """Loses, delays, repeats, freezes or reorders the messages that a change selects.

    Args:
        change: The change of whole messages.
        send: Sends a message at an instant (us), now or later; what is sent now comes right behind this message.
        seed: Draws the messages of a share.
    """

    def __init__(self, change: Change, send: Callable[[Message, int], None], seed: int = 0) -> None:
        self._operation = change.operation
        self._schedule = MessageSchedule(change.when, seed, change.lasts_s)
        self._send = send
        self._frozen: Message | None = None  # what is repeated
        self._held: tuple[HeldMessage[Message], ...] = ()  # messages to be overtaken

    def copy(self) -> Self:
        """An independent copy in the same state."""
        other = copy(self)
        other._schedule = copy(self._schedule)
        return other

    @property
    def changed(self) -> int:
        """Number of changed messages."""
        return self._schedule.changed

    @property
    def is_over(self) -> bool:
        """Whether all further messages pass unchanged; those that come later have been sent."""
        return self._schedule.is_over and not self._held

    def due(self, time_us: int, read: ReadsField) -> bool:
        """Whether the next message, at this instant (us), is changed; sends those that enough others have overtaken."""
        if self._schedule.due(time_us / 1e6, read):
            return True
        self._release(time_us)
        return False

    def change(self, message: Message, time_us: int) -> Message | None:
        """What arrives now in the place of a message that is due; None = nothing does."""
        count = self._operation.count
        match self._operation.name:
            case "delay":  # others may overtake it
                self._send(message, time_us + round(1e6 * (self._operation.value or 0.0)))
            case "duplicate":
                for _ in range(count):
                    self._send(message, time_us)
                return message
            case "freeze":
                if self._frozen is None:
                    self._frozen = message
                return self._frozen
            case "reorder":
                self._release(time_us)
                self._held = (*self._held, HeldMessage(message, count))
        return None  # lost, late, or held

    def _release(self, time_us: int) -> None:
        """Count a further message, and send those that enough of them have overtaken, right behind it."""
        waiting = []
        for held in self._held:
            if held.remaining > 1:
                waiting.append(replace(held, remaining=held.remaining - 1))
            else:
                self._send(held.message, time_us)
        self._held = tuple(waiting)


# ---- text ------------------------------------------------------------------------------------------------------------
def parse_change(parts: list[str], instant: str = "") -> Change:
    """Parse what is done and when.

    Args:
        parts: The operation and its options: `bit=N`, `flip`, `set=VALUE`, `bias=`, `scale=`, `drop`, `delay=S`,
            `duplicate[=N]`, `freeze`, `reorder[=N]`; `times=N` (0: without limit), `every=N`, `share=P`, `lasts=S`.
        instant: What stands behind `@`, see `parse_instant`; "" = from the beginning.

    Raises:
        BadInputError: A part is unknown, occurs twice, or is out of range; the message says what is allowed.
    """
    operation: Operation | None = None
    options: dict[str, Any] = parse_instant(instant)
    lasts_s = 0.0
    keys: set[str] = set()
    for part in parts:
        name, equals, text = part.partition("=")
        name = SYNONYMS.get(name, name)
        key = name
        if name == "bit" or name in OPERATIONS:
            key = "operation"
        if key in keys:
            raise BadInputError(f"{part!r}: allowed: one operation, each option once")
        keys.add(key)
        if key == "operation":
            operation = parse_operation(name, text, has_number=bool(equals))
        elif name in ("times", "every"):
            options[name] = int(read_number(name, text, whole=True))
        elif name == "share":
            options[name] = read_number(name, text)
        elif name == "lasts":
            if not _DURATION.fullmatch(text):
                raise BadInputError(f"lasts: {text!r}: allowed: a number of seconds, or inf")
            lasts_s = float(text)
        else:
            raise BadInputError(not_known(part, ("bit=", *OPERATIONS, "times=", "every=", "share=", "lasts=")))
    if operation is None:
        raise BadInputError(f"no operation; allowed: bit=N, {', '.join(OPERATIONS)}")
    if "times" not in keys and (operation.name == "freeze" or lasts_s > 0.0):
        # Of what is frozen the first message is unchanged, so that one time would be none.
        options["times"] = _TIMES_FOR_EVER
    return Change(operation, When(**options), lasts_s)


def parse_text(text: str) -> Change:
    """Parse what is done and when, e.g. `set=nan:times=3@10`; see `parse_change`."""
    body, _, instant = text.partition("@")
    return parse_change(body.split(":"), instant)


def split_site(text: str) -> tuple[str, str]:
    """The site of a fault, and the text of its change; an instant may follow either."""
    body, at, instant = text.partition("@")
    site, _, what = body.partition(":")
    return site, f"{what}{at}{instant}"


def is_change(text: str) -> bool:
    """Whether the text of a fault in a value has more than the flip of bits from an instant on."""
    _, what = split_site(text)
    options, _, instant = what.partition("@")
    names = {part.partition("=")[0] for part in options.split(":")}
    is_trigger = ".." in instant or _CONDITION.fullmatch(instant) is not None
    return bool(names & {*OPERATIONS, *SYNONYMS, "every"}) or is_trigger


def parse_instant(text: str) -> dict[str, Any]:
    """The arguments of `When` in a text.

    `10`: at or after 10 s; `10..12`: from 10 to 12 s, all messages unless `times` is given; `10..`: from then on;
    `sim=10..12`: in the graph's simulated time; `n=100`: the hundredth message; `linear.x>0.5`: from the first message
    on for which this holds.

    Raises:
        BadInputError: It has none of these forms.
    """
    if not text:
        return {}
    name, equals, rest = text.partition("=")
    if equals and name == _MESSAGE:
        return {"first": int(read_number(_MESSAGE, rest, whole=True))}
    options: dict[str, Any] = {}
    if equals and name == _SIM:
        options["sim_time"] = True
        text = rest
    condition = _CONDITION.fullmatch(text)
    if condition is not None and not options:
        field, comparison, value = condition.groups()
        return {"condition": Condition(field, comparison, read_number(field, value))}
    start, dots, end = text.partition("..")
    options["start_s"] = read_number("instant", start)
    if dots:
        options["times"] = _TIMES_FOR_EVER
        if end:
            options["end_s"] = read_number("instant", end)
            if options["end_s"] < options["start_s"]:
                raise BadInputError(f"instant {text!r}: ends before it starts; allowed: {MEANING['instant']}")
    return options
