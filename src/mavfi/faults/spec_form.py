"""Forms of faults as text, and the part that is wrong in one of another form."""

import re
from collections.abc import Mapping, Sequence

from mavfi.errors import hint
from mavfi.faults.levels.sensor.fault import FAILING

_FORMS = {
    "null": "null",
    "state": "state:STATE[.FIELD][[ELEMENT]][:bit=N][:width=N][:times=N][:lasts=S][:share=P][@SECONDS]",
    "memory": "memory:KERNEL[.FIELD][[INDEX]][:bit=N][@SECONDS]",
    "sensor": "sensor:UNIT[NUMBER]:TYPE[:lasts=S][@SECONDS]",
    "instruction": "instruction:KERNEL[:which=CLASS][:model=MODEL], or one instruction as printed by mavfi shrink",
}
_WHOLE, _SECONDS = (r"\d+", "a whole number"), (r"inf|\d+(\.\d*)?", "a number of seconds, or inf")
_OPTIONS = {
    "state": {
        "bit": _WHOLE, "width": _WHOLE, "times": _WHOLE, "lasts": _SECONDS,
        "share": (r"\d+(\.\d*)?", "a number above 0, to 1"),
    },
    "memory": {"bit": _WHOLE},
    "sensor": {"lasts": _SECONDS},
    "instruction": {"which": (".+", "a class of instructions"), "model": (r"\w+", "a model")},
}  # fmt: skip
"""By level: names of options in their order, with pattern and words of their values."""
_OF_WHOLE_KERNELS, _OF_A_TYPE = ("instruction",), ("sensor",)
"""Levels whose options are of whole kernels, without an instant; levels with a type of failure before the options."""
_INSTANT = r"(\d+(\.\d*)?([eE][+-]?\d+)?)?"


def wrong_part(level: str, rest: str) -> str:
    """What is wrong with a fault of a level, given by its text after the level, and what is allowed."""
    if level not in _OPTIONS:
        return f"not understood; allowed: {', '.join(_FORMS.values())}"
    body, at, instant = rest.partition("@")
    path, *parts = body.split(":")
    general = f"not understood; allowed: {_FORMS[level]}"
    if not path or (level in _OF_WHOLE_KERNELS and (at or "." in path)):
        return general
    if level in _OF_A_TYPE:
        if not parts or "=" in parts[0]:
            return f"no type of failure; allowed: sensor:{path}:TYPE, with TYPE one of {', '.join(FAILING)}"
        parts = parts[1:]
    wrong = _wrong_option(_OPTIONS[level], parts)
    if not wrong and not re.fullmatch(_INSTANT, instant):
        wrong = f"instant {instant!r}: allowed: a number of seconds from 0 on, e.g. @12.5"
    return wrong or general


def _wrong_option(options: Mapping[str, tuple[str, str]], parts: Sequence[str]) -> str:
    for part in parts:
        name, _, value = part.partition("=")
        if name not in options:
            return f"{name!r}: not known{hint(name, options)}; allowed: {', '.join(f'{one}=' for one in options)}"
        pattern, words = options[name]
        if not re.fullmatch(pattern, value):
            return f"{name}: {value!r}: allowed: {words}"
    return ""
