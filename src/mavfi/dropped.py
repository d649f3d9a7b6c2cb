"""What earlier versions had and this one refuses: each refusal names what replaced it."""

from collections.abc import Mapping

KEYS: Mapping[str, str] = {}
"""Keys of YAML files and of the Python API, with what to do instead."""

VALUES: Mapping[tuple[str, str], str] = {}
"""Values of keys, by key and value, with the value to use instead."""

NAMES: Mapping[tuple[str, str], str] = {}
"""Shipped names, by kind and name, with what to do instead."""

OPTIONS: Mapping[str, str] = {}
"""Options of the command line, alone or of one command ("states --json"), with what to do instead."""

COMMANDS: Mapping[str, str] = {
    "mavlink": "no replacement: ground stations fly PX4's or ArduPilot's own simulation; fly --mavlink PORT shows ours",
}
"""Commands, with what to do instead."""


def dropped_key(name: str) -> str:
    """The refusal of a key that earlier versions had; "" = none had it."""
    if name in KEYS:
        return f"key {name!r}: dropped; {KEYS[name]}"
    return ""


def dropped_value(key: str, value: object) -> str:
    """The refusal of a value that earlier versions allowed for a key; "" = none did."""
    if not isinstance(value, str) or (key, value) not in VALUES:
        return ""
    return f"key {key!r}: {value!r}: dropped; use {VALUES[key, value]!r}"


def dropped_name(kind: str, name: str) -> str:
    """The refusal of a shipped name of a kind, e.g. "detectors"; "" = no version shipped it."""
    replacement = NAMES.get((kind, name))
    if replacement:
        return f"{kind.rstrip('s')} {name!r}: dropped; {replacement}"
    return ""
