"""What a fault does to values and messages, and when: one vocabulary for flights, ROS graphs and AirSim programs.

As text, behind the site of a fault and separated by colons (on a command line for ROS also by spaces):

    bit=30@10            set=nan@10..12          bias=0.5:every=5@10..
    drop@n=100           delay=0.2:times=20@n=1  scale=1.1:share=0.1@linear.x>0.5

First what is done, then how often, then from when on; see `parse_change`.
"""

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np

from mavfi.errors import BadInputError, not_known

ValueOperation = Literal["flip", "set", "bias", "scale", "freeze"]
"""What can be done to one number of a message."""
MessageOperation = Literal["drop", "delay", "duplicate", "freeze", "reorder"]
"""What can be done to a whole message."""
OperationName = Literal["flip", "set", "bias", "scale", "drop", "delay", "duplicate", "freeze", "reorder"]
VALUE_OPERATIONS: tuple[str, ...] = get_args(ValueOperation)
MESSAGE_OPERATIONS: tuple[str, ...] = get_args(MessageOperation)
OPERATIONS: tuple[str, ...] = get_args(OperationName)
SYNONYMS = {"value": "set"}
"""Other names of operations: faults in instructions have a `value=`, too."""

_MEANING = {
    "flip": "0 = least significant; drawn if not given",
    "set": "a number, nan, inf or -inf",
    "bias": "what is added",
    "scale": "a factor",
    "delay": "seconds",
    "duplicate": "how many copies more",
    "reorder": "how many messages later",
    "instant": "10, 10..12, 10.. (s), sim=10, n=100, or a condition such as linear.x>0.5",
}
"""Meaning of the number behind the name of an operation; the others take none."""
_FLAGS = {"true": "1", "false": "0"}
_DEFAULTS = {"duplicate": 1.0, "reorder": 1.0}
"""Numbers of operations that need not be written."""
_COMPARISONS: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
}
_CONDITION = re.compile(r"([A-Za-z_][\w.\[\]]*)(>=|<=|>|<|=)(.+)")
_MESSAGE = "n"
_SIM = "sim"
_TIMES_FOR_EVER = 0

# Constants of splitmix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, OOPSLA 2014).
_GAMMA = 0x9E3779B97F4A7C15
_MIX = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
_MASK = (1 << 64) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Operation:
    """What a fault does.

    Attributes:
        name: One of `OPERATIONS`.
        value: Number of the operation: value (set), summand (bias), factor (scale), seconds (delay), additional copies
            (duplicate), messages (reorder); None = it takes none.
        bit: Bit that `flip` inverts, 0 = least significant; None = drawn.

    Raises:
        BadInputError: The operation lacks its number, or the number is out of range.
    """

    name: OperationName = "flip"
    value: float | None = None
    bit: int | None = None

    def __post_init__(self) -> None:
        if self.name not in OPERATIONS:
            raise BadInputError(f"operation: {not_known(self.name, OPERATIONS)}")
        if self.value is None and self.name in ("set", "bias", "scale", "delay"):
            raise BadInputError(f"{self.name}: needs a number; allowed: {self.name}={_MEANING[self.name]}")
        if self.name in ("bias", "scale") and not math.isfinite(self.value or 0.0):
            raise BadInputError(f"{self.name}: {self.value}: allowed: finite numbers")
        if self.name == "delay" and not 0.0 < (self.value or 0.0) <= 3600.0:
            raise BadInputError(f"delay: {self.value}: allowed: above 0, to 3600 s")
        if self.name in _DEFAULTS and self.value is not None and not 1 <= self.value <= 1000:
            raise BadInputError(f"{self.name}: {self.value:g}: allowed: 1 to 1000")

    def __eq__(self, other: object) -> bool:
        """Whether both do the same; two `set=nan` do, although NaN equals nothing."""
        return isinstance(other, Operation) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash(str(self))

    @property
    def count(self) -> int:
        """Number of additional copies (duplicate), or of messages (reorder)."""
        if self.value is None:
            return 1
        return int(self.value)

    def __str__(self) -> str:
        if self.name == "flip":
            if self.bit is None:
                return "flip"
            return f"bit={self.bit}"
        if self.value is None:
            return self.name
        return f"{self.name}={number_text(self.value)}"


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


class PlannedChange(NamedTuple):
    """What is done, and when; as text it is what `parse_text` reads."""

    operation: Operation
    when: When

    def __str__(self) -> str:
        when = str(self.when)
        if self.operation.name == "freeze":  # for ever, unless the text has a number of times
            when = when.replace(":times=0", "")
            if self.when.times == 1 and ":times=" not in when:
                when = f":times=1{when}"
        return f"{self.operation}{when}"

    @property
    def name(self) -> str:
        """The text without the instant: one of the operations of a campaign."""
        return str(self).partition("@")[0]


class ReadsField(Protocol):
    """Reads a number of the current message by its path."""

    def __call__(self, field: str) -> float:
        """Value of the field; NaN if the message lacks it."""


class MessageSchedule:
    """Decides, message by message, which ones a fault changes.

    A C program makes the same decisions inside ROS nodes (`extras/ros/ros2/interposer`).
    """

    def __init__(self, when: When, seed: int = 0) -> None:
        self.changed = 0
        self._when = when
        self._seed = seed
        self._messages = 0
        self._since_begin = -1  # messages since the first one that could be changed; -1 = it has not come
        self._is_late = False  # whether a message came after the latest instant

    @property
    def is_over(self) -> bool:
        """Whether no further message will be changed, whatever comes."""
        return self._is_late or (self._when.times != _TIMES_FOR_EVER and self.changed >= self._when.times)

    def due(self, time_s: float, read: ReadsField) -> bool:
        """Whether the next message, at this instant (s), is changed; to be called for each message in order."""
        when = self._when
        self._messages += 1
        self._is_late = self._is_late or time_s > when.end_s
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
        return True

    def take_back(self) -> None:
        """The message that was due cannot be changed: it does not count as a changed one."""
        self.changed -= 1

    def copy(self) -> "MessageSchedule":
        """An independent copy in the same state."""
        other = MessageSchedule(self._when, self._seed)
        other.changed = self.changed
        other._messages = self._messages
        other._since_begin = self._since_begin
        other._is_late = self._is_late
        return other


def happens(seed: int, message: int, share: float) -> bool:
    """Whether an event of probability `share` happens at a message: a hash of the seed and its number (splitmix64)."""
    if share == 1.0:
        return True
    word = (seed + message * _GAMMA) & _MASK
    word = ((word ^ (word >> 30)) * _MIX[0]) & _MASK
    word = ((word ^ (word >> 27)) * _MIX[1]) & _MASK
    word ^= word >> 31
    return (word >> 11) / 2**53 < share


# ---- numbers ---------------------------------------------------------------------------------------------------------
def changed_number(operation: Operation, value: float | int | bool, dtype: str) -> float | int | bool:
    """A number after `flip`, `set`, `bias` or `scale`.

    Results in integers are rounded to the nearest, and limited to the range of the type.

    Args:
        operation: With a bit, if it is `flip`.
        value: The number before.
        dtype: NumPy's name of its type: "f8", "f4", "i4", "u1", "?", ...

    Raises:
        BadInputError: The type has no such bit, or cannot hold the value.
    """
    check_number_operation(operation, dtype)
    if operation.name == "flip":
        assert operation.bit is not None  # drawn before
        return flipped(value, operation.bit, dtype)
    operand = operation.value
    assert operand is not None  # these operations need one
    result = operand
    if operation.name == "bias":
        result = value + operand
    elif operation.name == "scale":
        result = value * operand
    kind = np.dtype(dtype)
    if kind.kind == "f":
        with np.errstate(over="ignore"):
            return float(np.array(result).astype(kind))
    if kind.kind == "b":
        return bool(result)
    limits = np.iinfo(kind)
    return int(min(max(round(result), limits.min), limits.max))


def check_number_operation(operation: Operation, dtype: str) -> None:
    """Check that a number of this type can be changed so; else raise a BadInputError."""
    if operation.name not in ("flip", "set", "bias", "scale"):
        raise BadInputError(f"{operation.name}: changes no single number; allowed: flip, set, bias, scale")
    kind = np.dtype(dtype)
    bits = 8 * kind.itemsize
    if kind.kind == "b":
        bits = 1
    if operation.bit is not None and not 0 <= operation.bit < bits:
        raise BadInputError(f"bit {operation.bit}: allowed: 0 to {bits - 1}")
    if kind.kind == "f" or operation.name == "flip":
        return
    if kind.kind == "b":
        if operation.name in ("bias", "scale") or (operation.name == "set" and operation.value not in (0.0, 1.0)):
            raise BadInputError(f"{operation}: it is a flag; allowed: flip, set=0, set=1")
        return
    if operation.name == "set":
        limits = np.iinfo(kind)
        value = operation.value
        if value is None or not value.is_integer() or not limits.min <= value <= limits.max:
            raise BadInputError(f"{operation}: allowed: whole numbers from {limits.min} to {limits.max}")


def flipped(value: float | int | bool, bit: int, dtype: str) -> float | int | bool:
    """A number with one bit inverted."""
    kind = np.dtype(dtype)
    word = np.array([value]).astype(kind)
    bits = word.view(f"u{kind.itemsize}")
    bits ^= np.array(1 << bit, bits.dtype)
    result: float | int | bool = word[0].item()
    return result


# ---- text ------------------------------------------------------------------------------------------------------------
def parse_change(parts: list[str], instant: str = "") -> PlannedChange:
    """Parse what is done and when.

    Args:
        parts: The operation and its options: `bit=N`, `flip`, `set=VALUE`, `bias=`, `scale=`, `drop`, `delay=S`,
            `duplicate[=N]`, `freeze`, `reorder[=N]`; `times=N` (0: without limit), `every=N`, `share=P`.
        instant: What stands behind `@`, see `parse_instant`; "" = from the beginning.

    Raises:
        BadInputError: A part is unknown, occurs twice, or is out of range; the message says what is allowed.
    """
    operation: Operation | None = None
    options: dict[str, Any] = parse_instant(instant)
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
            operation = _operation(name, text, has_number=bool(equals))
        elif name in ("times", "every"):
            options[name] = int(_number(name, text, whole=True))
        elif name == "share":
            options[name] = _number(name, text)
        else:
            raise BadInputError(not_known(part, ("bit=", *OPERATIONS, "times=", "every=", "share=")))
    if operation is None:
        raise BadInputError(f"no operation; allowed: bit=N, {', '.join(OPERATIONS)}")
    if operation.name == "freeze" and "times" not in keys:
        options["times"] = _TIMES_FOR_EVER  # the first message, which is unchanged, is all that one time would be
    return PlannedChange(operation, When(**options))


def parse_text(text: str) -> PlannedChange:
    """Parse what is done and when, e.g. `set=nan:times=3@10`; see `parse_change`."""
    body, _, instant = text.partition("@")
    return parse_change(body.split(":"), instant)


def is_trigger(instant: str) -> bool:
    """Whether an instant in text form is more than a number of seconds."""
    return ".." in instant or _CONDITION.fullmatch(instant) is not None


def number_text(value: float) -> str:
    """A number as short text that is read back as the same number."""
    return repr(float(value)).removesuffix(".0")


def _operation(name: str, text: str, *, has_number: bool) -> Operation:
    """The operation of a text such as `bit=30` or `drop`."""
    if name == "bit":
        return Operation("flip", bit=int(_number(name, text, whole=True)))
    if not has_number:
        return Operation(name, _DEFAULTS.get(name))  # type: ignore[arg-type] # checked there
    if name not in _MEANING or name == "flip":
        raise BadInputError(f"{name}={text}: takes no number; allowed: {name}")
    return Operation(name, _number(name, text))  # type: ignore[arg-type] # checked there


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
        return {"first": int(_number(_MESSAGE, rest, whole=True))}
    options: dict[str, Any] = {}
    if equals and name == _SIM:
        options["sim_time"] = True
        text = rest
    condition = _CONDITION.fullmatch(text)
    if condition is not None and not options:
        field, comparison, value = condition.groups()
        return {"condition": Condition(field, comparison, _number(field, value))}
    start, dots, end = text.partition("..")
    options["start_s"] = _number("instant", start)
    if dots:
        options["times"] = _TIMES_FOR_EVER
        if end:
            options["end_s"] = _number("instant", end)
            if options["end_s"] < options["start_s"]:
                raise BadInputError(f"instant {text!r}: ends before it starts; allowed: {_MEANING['instant']}")
    return options


def _number(name: str, text: str, *, whole: bool = False) -> float:
    """A number in a text; a BadInputError names its key."""
    allowed = _MEANING.get(name, "a number")
    if whole:
        allowed = "a whole number from 0"
    try:
        value = float(_FLAGS.get(text.lower(), text))
    except ValueError:
        raise BadInputError(f"{name}: {text!r}: allowed: {allowed}") from None
    if whole and not (value.is_integer() and value >= 0):
        raise BadInputError(f"{name}: {text!r}: allowed: {allowed}")
    return value
