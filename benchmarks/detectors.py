"""Cost of detection: time of detectors relative to kernels in the same flights; writes docs/reference/detectors.md.

    N=5 SEEDS=2 ONLY="limits duplicate" python -m benchmarks.detectors

N: repeats of each flight (5).  SEEDS: missions of each setting (2).  ONLY: these detectors; the table is then printed,
not written.  Detectors take turns within a repeat; how they are timed: `mavfi.extras.paper.overheads`.
"""

import os
import statistics
import sys
from collections.abc import Mapping, Sequence
from datetime import date

from mavfi.campaign.fingerprint import processor
from mavfi.extras.paper.overhead_views import ALL
from mavfi.extras.paper.overheads import Cost, cost
from mavfi.flight.compose import with_keys_of
from mavfi.mission import MissionSpec
from tools.markers import DOCS, between, with_others

PAGE = DOCS / "reference" / "detectors.md"
ENVIRONMENTS, AUTOPILOTS = ("dense", "factory"), ("published", "hardened")
DETECTORS = (
    ("recommended", "paper", 2.0),
    ("acceptance", "paper", 2.0),
    ("gaussian", "paper", 6.0),
    ("autoencoder", "paper", 6.0),
    ("gaussian", "tuned", 6.0),
    ("autoencoder", "tuned", 6.0),
    ("limits", "paper", None),
    ("checksum", "paper", None),
    ("duplicate", "paper", None),
)
"""Detector, profile, and the largest share of the kernels' time that is wanted (%); None = none is."""
Key = tuple[str, str, str]
"""Autopilot profile, detector and its profile."""


def row(name: str, profile: str, bar: float | None, costs: Sequence[Sequence[Cost]]) -> str:
    """A row of the table: medians of flights, by autopilot profile."""
    cells = [f"`{name}`, `{profile}`"]
    middles = []
    for of_profile in costs:
        each = statistics.median(1e6 * one.detection[ALL] / one.judged_count for one in of_profile)
        shares = sorted(100 * one.detection[ALL] / one.kernels for one in of_profile)
        middles.append(statistics.median(shares))
        cells += [f"{each:.2f}", f"{middles[-1]:.2f} ({shares[0]:.2f}–{shares[-1]:.2f})"]
    verdict = "–"
    if bar is not None:
        verdict = f"{bar:g}"
        if max(middles) > bar:
            verdict += ", not met"
    return f"| {' | '.join([*cells, verdict])} |"


def table(costs: Mapping[Key, Sequence[Cost]], flights: int, repeats: int) -> str:
    """The table of all detectors and profiles that were measured with each autopilot profile."""
    rows = []
    recomputed = []
    for name, profile, bar in DETECTORS:
        of_detector = [costs.get((autopilot, name, profile), ()) for autopilot in AUTOPILOTS]
        if all(of_detector):
            rows.append(row(name, profile, bar, of_detector))
            shares = [100 * statistics.mean(one.recomputed for one in of_profile) for of_profile in of_detector]
            if any(f"{share:.2f}" != "0.00" for share in shares):
                recomputed.append(f"`{name}`, `{profile}` {' and '.join(f'{share:.2f}' for share in shares)} %")
    recovery = sorted(100 * statistics.median(one.recovery[ALL] / one.kernels for one in own) for own in costs.values())
    kernels = []
    for autopilot in AUTOPILOTS:
        times = [1e3 * one.kernels for key, own in costs.items() if key[0] == autopilot for one in own]
        kernels.append(f"{statistics.median(times):.0f}")
    headings = [f"`{autopilot}`: {heading}" for autopilot in AUTOPILOTS for heading in ("µs", "%")]
    return "\n".join(
        [
            f"Measured on {date.today().isoformat()}: {flights} missions of each autopilot profile "
            f"({' and '.join(ENVIRONMENTS)}), {repeats} repeats, one process, load {os.getloadavg()[0]:.1f}. The "
            f"kernels, their Python included, take {' and '.join(kernels)} ms of a golden flight. µs: per publication; "
            "%: of the kernels' time, median of flights (smallest–largest); both with two clock readings. Recovery, "
            f"which saves the memory of kernels before each step, takes {recovery[0]:.1f} to {recovery[-1]:.1f} %. "
            f"Recomputed, as modelled: {'; '.join(recomputed) or 'nothing'}.",
            "",
            f"| detector | {' | '.join(headings)} | wanted below, % |",
            "|---|" + "---:|" * (len(headings) + 1),
            *rows,
        ]
    )


def mission_of(key: Key, environment: str, seed: int) -> MissionSpec:
    """A mission of a setting."""
    autopilot, name, _ = key
    return with_keys_of(MissionSpec(environment=environment, seed=seed, autopilot=autopilot), name)


def main() -> None:
    """Fly, and write the table."""
    repeats, seeds = int(os.environ.get("N", "5")), int(os.environ.get("SEEDS", "2"))
    only = os.environ.get("ONLY", "").split()
    missions = [(environment, seed) for environment in ENVIRONMENTS for seed in range(seeds)]
    every = [
        (autopilot, name, profile)
        for autopilot in AUTOPILOTS
        for name, profile, _ in DETECTORS
        if not only or name in only
    ]
    costs: dict[Key, list[Cost]] = {key: [] for key in every}
    for repeat in range(-1, repeats):  # repeat -1 compiles, or loads the cache
        for environment, seed in missions if repeat >= 0 else missions[:1]:
            for key in costs:
                found = cost(mission_of(key, environment, seed), *key[1:])
                if repeat >= 0:
                    costs[key].append(found)
        sys.stderr.write(f"\r{repeat + 1} of {repeats} repeats")
    written = table(costs, len(missions), repeats)
    if not only:
        page = PAGE.read_text(encoding="utf-8")
        block = with_others(processor(), written, page, "detector-cost")
        PAGE.write_text(between(page, "detector-cost", block), encoding="utf-8")
    sys.stdout.write(f"\n{written}\n")


if __name__ == "__main__":
    main()
