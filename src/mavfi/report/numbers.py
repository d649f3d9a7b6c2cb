"""Numbers of flights as text, without what tables need."""

import math
import struct

from mavfi.record import Injection

ABSENT = "—"


def counted(number: int, noun: str) -> str:
    """A number with its noun, in the plural unless it is 1."""
    if number == 1:
        return f"1 {noun}"
    return f"{number} {noun}s"


def percent(share: float | None, digits: int = 1) -> str:
    """A share as per cent."""
    if share is None:
        return ABSENT
    return f"{100 * share:.{digits}f} %"


def upper_percent(bound: float) -> str:
    """An upper bound as per cent with two digits, rounded up: "0.19 %", "100 %"."""
    percentage = 100 * bound
    if percentage <= 0:
        return "0 %"
    step = 10.0 ** (math.floor(math.log10(percentage)) - 1)
    return f"{min(100.0, math.ceil(round(percentage / step, 6)) * step):.3g} %"


def signed_percent(share: float | None) -> str:
    """A relative change as per cent."""
    if share is None:
        return ABSENT
    return f"{100 * share:+z.1f} %"


def lost(injection: Injection) -> str:
    """What is added to the values of an injection after which a message cannot be read."""
    if injection.details.get("lost"):
        return ", message lost"
    return ""


def corruption(injection: Injection) -> str:
    """What a fault did to a value or a message: "bit 62", "set=nan", "drop"; "" = nothing, or nothing so short."""
    operation = injection.details.get("operation", "")
    if injection.bit is not None:
        return f"bit {injection.bit}"
    return str(operation)


def outcome(injection: Injection, digits: int = 6) -> str:
    """The value before and after an activated injection, or the number of changed messages, if it is in whole ones."""
    if injection.before is None and "publications" in injection.details:
        count = injection.details["publications"]
        if count == 1:
            return "1 publication"
        return f"{count} publications"
    before, after = change(injection.before, injection.after, digits)
    return f"{before} → {after}{lost(injection)}"


def change(before: object, after: object, digits: int = 6) -> tuple[str, str]:
    """Format two values so that they differ: with `digits` digits, else in full, else with their bits."""
    pairs = list(zip(_forms(before, digits), _forms(after, digits), strict=True))
    return next((pair for pair in pairs if pair[0] != pair[1]), pairs[0])


def _forms(value: object, digits: int) -> tuple[str, str, str]:
    """A value rounded, in full, and with its bits, which distinguish NaNs."""
    if isinstance(value, float):
        return f"{value:.{digits}g}", repr(value), f"{value} (0x{struct.pack('>d', value).hex()})"
    return str(value), str(value), str(value)
