"""Strata of a word's bits, from which faults are drawn.

The paper finds sign and exponent decisive (section III-C); among all bits of a float64 they are 12 of 64.  So bits are
drawn per stratum, and each draw has the weight that restores the whole-word rate.
"""

from typing import Protocol

from mavfi.errors import BadInputError, not_known

WORD_BITS = {"f8": 64, "f4": 32, "i8": 64, "i4": 32, "i2": 16, "u8": 64, "u4": 32, "u1": 8, "?": 1}
"""Bits of a word by its type; a flag has one, and flipping it inverts the flag."""


class HasType(Protocol):
    """A field of a state, or a word of a memory."""

    @property
    def dtype(self) -> str:
        """NumPy type string, a key of `WORD_BITS`."""


_CLASSES: dict[str, dict[str, range]] = {
    "f8": {"sign": range(63, 64), "exponent": range(52, 63), "mantissa": range(52)},
    "f4": {"sign": range(31, 32), "exponent": range(23, 31), "mantissa": range(23)},
    "i8": {"sign": range(63, 64), "other": range(63)},
    "i4": {"sign": range(31, 32), "other": range(31)},
    "i2": {"sign": range(15, 16), "other": range(15)},
    "u8": {"other": range(64)},
    "u4": {"length": range(32)},
    "u1": {"other": range(8)},
    "?": {"flag": range(1)},
}
"""Classes of the bits of a word, by its type; the classes of floating-point numbers are those of IEEE 754."""

WHOLE_WORD = "word"
"""Stratum of all bits of a word."""
EACH_CLASS = "classes"
"""Stratum of all bits of a word, of which a class is drawn first: one of `CLASS_STRATA`."""
CLASS_STRATA = ("sign", "exponent_field", "mantissa")
"""The classes of the published injector."""

STRATA: dict[str, tuple[str, ...]] = {
    "sign_exponent": ("sign", "exponent", "flag"),
    "mantissa": ("mantissa", "other"),
    "sign": ("sign", "flag"),
    "exponent": ("exponent",),
    "length": ("length",),
    "exponent_field": ("exponent", "other", "flag"),
    WHOLE_WORD: ("sign", "exponent", "flag", "mantissa", "other"),
    EACH_CLASS: ("sign", "exponent", "flag", "mantissa", "other"),
}
"""Bit classes of each stratum.  The first two partition every word; headline figures use the first.  Integers have sign
and other bits, unsigned ones other bits only; a flag's single bit counts with the headline.  The length of a list in a
message is none of these.  `exponent_field` is class 2 of the published injector: bits 52 to 62 of a float64, 0 to
30 of an integer.  `word` draws from all bits alike, `classes` from sign, exponent field and mantissa alike."""

HEADLINE = "sign_exponent"
"""Stratum of the headline figures."""
WORDS = {HEADLINE: "sign + exponent", "length": "lengths of lists"}
"""Strata that tables name otherwise."""
SIGN_EXPONENT = (HEADLINE, "sign", "exponent")
"""Strata of the headline's bits, together or apart."""


def bits_of(field: HasType, stratum: str) -> range:
    """Bits of a field in a stratum, empty if its type has none; a BadInputError for an unknown stratum."""
    if stratum not in STRATA:
        raise BadInputError(f"stratum {not_known(stratum, STRATA)}")
    ranges = [bits for name, bits in _CLASSES[field.dtype].items() if name in STRATA[stratum]]
    if not ranges:
        return range(0)
    return range(min(bits.start for bits in ranges), max(bits.stop for bits in ranges))


def bit_class(field: HasType, bit: int) -> str:
    """Class of one bit: "sign", "exponent", "mantissa", "other" (integers) or "flag"."""
    return next(name for name, bits in _CLASSES[field.dtype].items() if bit in bits)


def word_share(field: HasType, stratum: str) -> float:
    """Share of the field's bits in the stratum."""
    return len(bits_of(field, stratum)) / WORD_BITS[field.dtype]
