"""A value before and after, as short as shows that they differ."""

import struct


def change(before: object, after: object, digits: int = 6) -> tuple[str, str]:
    """Two values as text: short where the short forms differ, in full where not, bits where even those are equal.

    Args:
        before: One value.
        after: The other one.
        digits: Of the short form.
    """
    for form in (lambda value: _short(value, digits), _full, _bits):
        pair = form(before), form(after)
        if pair[0] != pair[1]:
            return pair
    return _short(before, digits), _short(after, digits)


def _short(value: object, digits: int) -> str:
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def _full(value: object) -> str:
    return repr(value) if isinstance(value, float) else str(value)


def _bits(value: object) -> str:
    """NaNs differ by their bits alone."""
    return f"{value} (0x{struct.pack('>d', value).hex()})" if isinstance(value, float) else str(value)
