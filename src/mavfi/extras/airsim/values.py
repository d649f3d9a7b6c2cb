"""The numbers in arguments and return values of a call: how many there are, their paths, and a flipped bit in one.

Numbers are counted in wire order, depth first: floats (64 bits), integers (64), booleans (1), and bytes (8 each).
"""

import struct
from collections.abc import Iterator
from typing import Any

from mavfi.errors import BadInputError

Path = tuple[str | int, ...]
_WORD = 64


def count(value: Any) -> int:
    """Number of numbers in a value."""
    if isinstance(value, (bool, int, float)):
        return 1
    if isinstance(value, bytes):
        return len(value)
    if isinstance(value, dict):
        return sum(map(count, value.values()))
    if isinstance(value, list):
        return sum(map(count, value))
    return 0


def path_of(value: Any, number: int) -> Path | None:
    """Path of the n-th number, from 0; None if there are fewer."""
    if isinstance(value, (bool, int, float)):
        return () if number == 0 else None
    if isinstance(value, bytes):
        return (number,) if number < len(value) else None
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        inside = count(item)
        if number < inside:
            found = path_of(item, number)
            return None if found is None else (key, *found)
        number -= inside
    return None


def leaves(value: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a value with its path; bytes are left out."""
    if isinstance(value, (bool, int, float)):
        yield prefix, float(value)
    elif isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, f"{prefix}.{key}" if prefix else str(key))


def keys_of(text: str) -> Path:
    """A path from text, e.g. "0.x_val"."""
    return tuple(int(part) if part.isdecimal() else part for part in text.split(".") if part)


def make_double(holder: Any, path: Path) -> None:
    """Turn the integer at a path, if there is one, into a double of the same value; in place."""
    *outer, last = path
    try:
        for key in outer:
            holder = holder[key]
        if type(holder[last]) is int:  # a boolean stays one
            holder[last] = float(holder[last])
    except (KeyError, IndexError, TypeError):
        pass


def bits_of(value: Any) -> int:
    """Number of bits of a number; 8 for one of bytes."""
    return 1 if isinstance(value, bool) else _WORD


def flipped(value: Any, bit: int) -> Any:
    """A number with one bit flipped."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        (word,) = struct.unpack("<q", struct.pack("<Q", (value & (2**_WORD - 1)) ^ (1 << bit)))
        return word
    (raw,) = struct.unpack("<Q", struct.pack("<d", value))
    return struct.unpack("<d", struct.pack("<Q", raw ^ (1 << bit)))[0]


def flip(holder: Any, path: Path, bit: int) -> tuple[Any, Any, Any, int]:
    """Flip a bit of the number at a path.

    Returns:
        The value, changed (lists and maps in place), the number before and after, and the bit: the given one modulo
        the width of the number.

    Raises:
        BadInputError: There is no number at this path.
    """
    if not path:
        if not isinstance(holder, (bool, int, float)):
            raise BadInputError("not a number")
        bit %= bits_of(holder)
        after = flipped(holder, bit)
        return after, holder, after, bit
    key, *rest = path
    if isinstance(holder, bytes) and isinstance(key, int) and key < len(holder):
        bit %= 8
        changed = bytearray(holder)
        changed[key] ^= 1 << bit
        return bytes(changed), holder[key], changed[key], bit
    try:
        inner = holder[key]
    except (KeyError, IndexError, TypeError):
        raise BadInputError(f"no number at {key!r}") from None
    holder[key], before, after, bit = flip(inner, tuple(rest), bit)
    return holder, before, after, bit
