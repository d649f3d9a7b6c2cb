"""Cost of the observer's delay: the same faults with the detector as gate and as observer; writes docs/how-to/ros2.md.

    N=40 python benchmarks/coupling.py

N: missions (40).  Each gets one fault in the sign or exponent of a monitored field of planning or control.
"""

import os
import sys
from pathlib import Path

import numpy as np

from mavfi.flight.compose import detector_for, resolve, with_keys_of
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from mavfi.flight.host import Flight
from mavfi.levels.state.drawing import draw, stage_target
from mavfi.mission import MissionSpec, MissionStatus
from tools.markers import between

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "ros2.md"
FIRST_SEED = 10_000
ENVIRONMENT, AUTOPILOT = "dense", "published"
ARMS = (
    "none",
    *(f"{name} {how}" for name in ("gaussian", "autoencoder", "recommended") for how in ("inline", "observer")),
)


def peak(flight: Flight, golden: Flight) -> float:
    """Maximum distance from the golden flight at equal instants (m), while both are in flight."""
    count = min(len(flight.log.rows), len(golden.log.rows))
    apart = flight.log.columns("x", "y", "z")[:count] - golden.log.columns("x", "y", "z")[:count]
    return float(np.linalg.norm(apart, axis=1).max())


def pair(seed: int) -> dict[str, tuple[bool, float, float]]:
    """One mission with one fault in every arm: success, flight time (s), maximum distance from its golden run (m)."""
    bare = MissionSpec(environment=ENVIRONMENT, seed=seed, autopilot=AUTOPILOT)
    profile = fly(resolve(bare), profile=True).profile
    assert profile is not None
    stage = ("planning", "control")[seed % 2]
    fault = draw(stage_target(stage, AUTOPILOT, "paper-13"), "sign_exponent", profile, seed, ENVIRONMENT, 0)
    found = {}
    for arm in ARMS:
        name, _, coupling = arm.partition(" ")
        mission = bare if name == "none" else with_keys_of(bare.model_copy(update={"coupling": coupling}), name)
        scenario = resolve(mission)
        detector = None if name == "none" else detector_for(scenario, name, "paper")[0]
        golden, flight = (
            fly(scenario, planned, detector, recovery=RecoveryPolicy.of(mission)) for planned in (None, fault)
        )
        success = flight.log.status is MissionStatus.SUCCESS
        found[arm] = success, float(flight.log.column("time")[-1]), peak(flight, golden)
    return found


def table(pairs: list[dict[str, tuple[bool, float, float]]]) -> str:
    """The table of all arms."""
    lines = [
        f"{len(pairs)} missions in `{ENVIRONMENT}`, autopilot profile `{AUTOPILOT}`, seeds from {FIRST_SEED}, one "
        "fault each in the sign or exponent of a monitored field of planning or control, profile `paper`; the same "
        "faults in every arm. Distances are the largest ones from the golden run at the same instant; times are of "
        "missions that arrive in every arm.",
        "",
        "| detector | arrived | distance from golden (m): median | p90 | flight time (s) |",
        "|---|---|---|---|---|",
    ]
    arrived = [found for found in pairs if all(found[arm][0] for arm in ARMS)]
    for arm in ARMS:
        apart = sorted(found[arm][2] for found in pairs)
        middle, high = np.percentile(apart, [50, 90])
        time = np.mean([found[arm][1] for found in arrived]) if arrived else float("nan")
        count = sum(found[arm][0] for found in pairs)
        lines.append(f"| {arm} | {count} / {len(pairs)} | {middle:.2f} | {high:.2f} | {time:.2f} |")
    return "\n".join(lines)


def main() -> None:
    """Fly all arms and write the table."""
    pairs = []
    for seed in range(FIRST_SEED, FIRST_SEED + int(os.environ.get("N", "40"))):
        pairs.append(pair(seed))
        sys.stderr.write(f"\r{len(pairs)} missions")
    written = between(PAGE.read_text(encoding="utf-8"), "coupling", table(pairs))
    PAGE.write_text(written, encoding="utf-8")
    sys.stdout.write(f"\n{table(pairs)}\n")


if __name__ == "__main__":
    main()
