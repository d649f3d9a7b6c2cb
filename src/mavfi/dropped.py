"""What earlier versions had and this one refuses: each refusal names what replaced it."""

from collections.abc import Mapping

KEYS: Mapping[str, str] = {
    "copies": "no replacement: one copy of a detector brings back as many missions as two or three",
    "until_halfwidth": "no replacement: a campaign flies the number of missions that it states; set missions",
    "stack": "use autopilot",
    "node": "use stack, with host ros2_stack",
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
    ("views", "golden_against_faults"): "the first finding of a report has the same test; use success and recovery",
    ("views", "golden_flights"): "use flight_times, or Runs.golden in Python",
    ("views", "outcomes_by_stage"): "use outcomes, or by_stage",
    ("views", "by_every_field"): "use by_field",
    **{
        ("views", f"by_{key}_and_environment"): f"use by_{key}, or mavfi runs DIR --csv"
        for key in ("stage", "target", "state", "failure", "bits", "field", "every_field")
    },
    ("views", "overheads"): "use overheads_as_in_the_paper",
    ("views", "unmonitored_failures"): "use detections, which tells monitored fields from others",
    ("views", "acted_on"): "no replacement; mavfi states says which publications consumers act on",
    ("views", "instructions_by_stage"): "use instructions_as_in_the_paper and kernel_effects",
    ("views", "instruction_alarms"): "use schemes_instructions",
    ("views", "kernel_missions"): "use kernels_as_in_the_paper; mavfi vulnerability has both policies for dead nodes",
    ("views", "kernel_errors"): "mavfi explain DIR RUN_ID names the first value that differs",
    ("views", "kernel_instructions"): "use failures_per_hour, which has the instructions of each kernel",
    **{
        ("views", f"kernel_effects_by_{column}"): f"use kernel_effects, or mavfi runs DIR --csv with its {stored}"
        for column, stored in (("value_class", "value_class"), ("bit", "stratum"))
    },
    **{
        ("views", f"register_{name}"): "use register_effects and mavfi runs DIR"
        for name in ("functions", "corruptions")
    },
    ("views", "boundary_calls"): "use boundary_effects, or mavfi runs DIR --csv with its column state",
    ("figures", "sites"): "use kernels or states, the paper's Fig. 3 and 4, or the tables by_state and by_target",
    ("campaigns", "replicas"): "use detector_instructions: copies of a detector made no difference",
    ("campaigns", "ros_robot_state_publisher"): "use examples/ros2/limiter.yaml with a stack of your own",
    ("campaigns", "recovery_memory"): "use detector_memory: no fault in the memory of recovery lost a mission",
    ("campaigns", "recovery_instructions"): "use detector_instructions: no fault in recovery lost a mission",
    **{
        (kind, name): "use limits: it brings back as many missions"
        for kind in ("detectors", "kernels")
        for name in (
            "autoencoder_all",
            "gradient_boosting",
            "half_space_trees",
            "isolation_forest",
            "mahalanobis",
            "matrix_profile",
            "pca",
        )
    },
}
"""Shipped names, by kind and name, with what to do instead."""

OPTIONS: Mapping[str, str] = {
    "--copies": KEYS["copies"],
    "--free-running": "use --pace 1: the flight in lock-step, paced by the wall clock",
    "--new-interpreters": "no replacement: nodes are processes forked from their supervisor",
    "--point-cloud-node": "no replacement: attach with mavfi ros inject or mavfi inject --ros-node",
    "--stack": "use --autopilot",
    "--strike": "use --register-fault",
    "--strike-seed": "use --register-seed",
    "--strike-registers": "use --registers",
    "--forking": "use --fast-forward",
    "--no-forking": "use --no-fast-forward",
    "--instants": "no replacement: the smallest fault is searched for at the instant of the given one",
    "--until-halfwidth": "use --scale, or set missions in the campaign: their number does not depend on results",
    "--draw-run": "use mavfi explain DIR RUN_ID --picture FILE.png",
    "--no-draw-run": "a report draws no flight any more; mavfi explain DIR RUN_ID --picture FILE.png does",
    "--monitored": "no replacement: the marked fields are those of paper-13, which all detectors of the paper watch",
    "--where": "use mavfi runs DIR --csv, the filters of mavfi report DIR --html, or Runs.where in Python",
    "--sort": "use mavfi runs DIR --csv, or Runs.frame in Python",
    "states --json": "use mavfi.states.STATES in Python",
    "shrink --json": "its last line is the command that flies the smallest fault",
    "redundancy --json": "use mavfi report DIR --view redundancy --json",
    "redundancy --csv": "use mavfi report DIR --view redundancy --csv",
    "failures --json": "use mavfi report DIR --view failures_per_hour --json",
    "failures --csv": "use mavfi report DIR --view failures_per_hour --csv",
    "--watch": "use watch -n 2 mavfi campaign status DIR",
    "--every": "use watch -n 2 mavfi campaign status DIR",
    "ros watch --alarm-topic": "no replacement: alarms are published on /mavfi/alarm",
    "inject --thread": "no replacement: the busiest thread is injected, or the first to call --symbol",
    "inject --interval": "no replacement: injections follow each other",
    **dict.fromkeys(
        ("airsim serve --detector", "airsim serve --profile", "airsim serve --train"),
        "use mavfi airsim run --detector, or --save and mavfi watch FILE.jsonl --train CALLS.jsonl",
    ),
    "campaign run --dry-run": "no replacement: names are checked before the first flight, campaign status counts runs",
    "vulnerability --lines": "use mavfi vulnerability DIR --json, which has every line",
    "fly --live-port": "no replacement: --live serves at port 8765",
    "--baselines": "no replacement: a model of a library becomes a detector as docs/how-to/extending.md shows",
    "--machine": "use make bench NAME=machine_level, which flips bits of registers in plain and in protected code",
}
"""Options of the command line, alone or of one command ("states --json"), with what to do instead."""

_A_FOLDER = "copy the campaign's folder: its ledger is one file, which mavfi campaign verify checks"
COMMANDS: Mapping[str, str] = {
    "campaign pack": _A_FOLDER,
    "campaign unpack": _A_FOLDER,
    "ros corrupt": "use mavfi ros inject; --at n=10 means message 10, --times 0 --share 0.01 means --rate 0.01",
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
