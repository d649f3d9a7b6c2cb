"""What a fault does to a number or to a whole message: one vocabulary for flights, ROS graphs, AirSim and MAVLink.

When, and how often, is part of a `mavfi.faults.changes.Change`.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from mavfi.errors import BadInputError, not_known

Number = float | int | bool
"""A value that can be changed."""
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

MEANING = {
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
            raise BadInputError(f"{self.name}: needs a number; allowed: {self.name}={MEANING[self.name]}")
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


# ---- numbers ---------------------------------------------------------------------------------------------------------
def changed_number(operation: Operation, value: Number, dtype: str) -> Number:
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


def flipped(value: Number, bit: int, dtype: str) -> Number:
    """A number with one bit inverted."""
    kind = np.dtype(dtype)
    word = np.array([value]).astype(kind)
    bits = word.view(f"u{kind.itemsize}")
    bits ^= np.array(1 << bit, bits.dtype)
    result: Number = word[0].item()
    return result


# ---- text ------------------------------------------------------------------------------------------------------------
def parse_operation(name: str, text: str, *, has_number: bool) -> Operation:
    """The operation of a text such as `bit=30` or `drop`."""
    if name == "bit":
        return Operation("flip", bit=int(read_number(name, text, whole=True)))
    if not has_number:
        return Operation(name, _DEFAULTS.get(name))  # type: ignore[arg-type] # checked there
    if name not in MEANING or name == "flip":
        raise BadInputError(f"{name}={text}: takes no number; allowed: {name}")
    return Operation(name, read_number(name, text))  # type: ignore[arg-type] # checked there


def read_number(name: str, text: str, *, whole: bool = False) -> float:
    """A number in a text; a BadInputError names its key."""
    allowed = MEANING.get(name, "a number")
    if whole:
        allowed = "a whole number from 0"
    try:
        value = float(_FLAGS.get(text.lower(), text))
    except ValueError:
        raise BadInputError(f"{name}: {text!r}: allowed: {allowed}") from None
    if whole and not (value.is_integer() and value >= 0):
        raise BadInputError(f"{name}: {text!r}: allowed: {allowed}")
    return value


def number_text(value: float) -> str:
    """A number as short text that is read back as the same number."""
    return repr(float(value)).removesuffix(".0")
