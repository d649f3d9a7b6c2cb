"""What earlier versions had and this one refuses: each refusal names what replaced it."""

from collections.abc import Mapping

KEYS: Mapping[str, str] = {
    **dict.fromkeys(
        ("studied", "certified"), "make the plan again with mavfi harden, which writes its proof beside it"
    ),
}
"""Keys of YAML files and of the Python API, with what to do instead."""

NAMES: Mapping[tuple[str, str], str] = {
    ("hosts", "ros1"): "use ros2; recordings of ROS 1 (.bag) are still read and written",
    ("campaigns", "ros1_smoke"): "use mavfi ros fly, or host: ros2 in a campaign of your own",
    ("studies", "assumptions"): "use python -m studies.assumptions, in a clone of the repository",
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
    "ros fly --ros": "no replacement: nodes are those of ROS 2",
    **dict.fromkeys(
        ("harden --certify", "harden --faults"),
        "fly the campaign that mavfi harden writes beside the plan; its exit code is 3 if the plan does not hold",
    ),
    "harden --html": "use --json, or mavfi vulnerability DIR --html for the source lines",
    "--baselines": "no replacement: a model of a library becomes a detector as docs/how-to/extending.md shows",
}
"""Options of the command line, alone or of one command ("states --json"), with what to do instead."""

COMMANDS: Mapping[str, str] = {
    "mavlink serve": (
        "no replacement: ground stations fly PX4's or ArduPilot's own simulation; fly --mavlink PORT shows ours"
    ),
}
"""Commands, with what to do instead."""


def dropped_key(name: str) -> str:
    """The refusal of a key that earlier versions had; "" = none had it."""
    if name in KEYS:
        return f"key {name!r}: dropped; {KEYS[name]}"
    return ""


def dropped_name(kind: str, name: str) -> str:
    """The refusal of a shipped name of a kind, e.g. "detectors"; "" = no version shipped it."""
    replacement = NAMES.get((kind, name))
    if replacement:
        singular = kind.removesuffix("s")
        if kind == "studies":
            singular = "study"
        return f"{singular} {name!r}: dropped; {replacement}"
    return ""
