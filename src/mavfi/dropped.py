"""What earlier versions had and this one refuses: each refusal names what replaced it."""

from collections.abc import Mapping

KEYS: Mapping[str, str] = {
    "copies": "no replacement: one copy of a detector brings back as many missions as two or three",
    "until_halfwidth": "no replacement: a campaign flies the number of missions that it states; set missions",
    "stack": "use autopilot",
    "hull_radius": "use collision_radius",
    "scheme": "no replacement: instruction faults are drawn uniformly over dynamic instructions",
}
"""Keys of YAML files and of the Python API, with what to do instead."""

VALUES: Mapping[tuple[str, str], str] = {
    **{("dead_node", policy): "readback" for policy in ("latched", "recompute", "checkpoint", "standby")},
    **{("degraded", mode): "hold" for mode in ("hover", "back")},
    ("dead_node", "restart"): "fresh",
    **{("kind", repetition): "duplicate" for repetition in ("rerun", "vote")},
}
"""Values of keys, by key and value, with the value to use instead."""

NAMES: Mapping[tuple[str, str], str] = {
    **{("detectors", f"rule_{number}"): f"use acceptance, options: {{rules: [{number}]}}" for number in range(1, 6)},
    ("detectors", "conformal"): "use limits: it brings back the same missions with fewer false alarms",
    ("detectors", "cusum"): "use limits: it brings back more missions",
    ("detectors", "checksum_large"): "use checksum, options: {large: true}",
    **{("kernels", name): "use limits: the detector is gone" for name in ("conformal", "cusum")},
    ("kernels", "recovery"): "no fault in recovery lost a mission; inject a detector, e.g. acceptance",
    ("campaigns", "replicas"): "use detector_instructions: copies of a detector made no difference",
    ("campaigns", "recovery_memory"): "use detector_memory: no fault in the memory of recovery lost a mission",
    ("campaigns", "recovery_instructions"): "use detector_instructions: no fault in recovery lost a mission",
}
"""Shipped names, by kind and name, with what to do instead."""

OPTIONS: Mapping[str, str] = {
    "--copies": KEYS["copies"],
    "--free-running": "use --pace 1: the flight in lock-step, paced by the wall clock",
    "--new-interpreters": "no replacement: nodes are processes forked from their supervisor",
    "--point-cloud-node": "no replacement: attach with mavfi ros corrupt or mavfi inject --ros-node",
    "--stack": "use --autopilot",
    "--strike": "use --register-fault",
    "--strike-seed": "use --register-seed",
    "--strike-registers": "use --registers",
    "--forking": "use --fast-forward",
    "--no-forking": "use --no-fast-forward",
    "--instants": "no replacement: the smallest fault is searched for at the instant of the given one",
    "--until-halfwidth": "use --scale, or set missions in the campaign: their number does not depend on results",
    "--watch": "use watch -n 2 mavfi campaign status DIR",
    "--every": "use watch -n 2 mavfi campaign status DIR",
    "--machine": "use make bench NAME=machine_level, which flips bits of registers in plain and in protected code",
}
"""Options of the command line, with what to do instead."""

COMMANDS: Mapping[str, str] = {}
"""Commands ("ros mirror"), with what to do instead."""


def dropped_key(name: str) -> str:
    """The refusal of a key that earlier versions had; "" = none had it."""
    return f"key {name!r}: dropped; {KEYS[name]}" if name in KEYS else ""


def dropped_value(key: str, value: object) -> str:
    """The refusal of a value that earlier versions allowed for a key; "" = none did."""
    replacement = VALUES.get((key, value)) if isinstance(value, str) else None
    return f"key {key!r}: {value!r}: dropped; use {replacement!r}" if replacement else ""


def dropped_name(kind: str, name: str) -> str:
    """The refusal of a shipped name of a kind, e.g. "detectors"; "" = no version shipped it."""
    replacement = NAMES.get((kind, name))
    return f"{kind.rstrip('s')} {name!r}: dropped; {replacement}" if replacement else ""
