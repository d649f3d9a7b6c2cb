"""Cost of detection: time of detectors relative to kernels in the same flights; writes docs/models.md.

    N=5 SEEDS=2 python -m benchmarks.detectors

N: repeats of each flight (5).  SEEDS: missions of each setting (2).  Detectors take turns within a repeat; how they are
timed: `mavfi.campaign.overheads`.
"""

import os
import statistics
import sys

from mavfi.campaign.overheads import ALL, Cost, cost
from mavfi.hosts.watching import with_keys_of
from mavfi.mission import MissionSpec
from tools.markers import DOCS, between
from tools.processors import with_others

PAGE = DOCS / "models.md"
ENVIRONMENTS, AUTOPILOTS = ("dense", "factory"), ("published", "hardened")
DETECTORS = (
    ("recommended", "paper", 1.0), ("acceptance", "paper", 1.0), ("gaussian", "paper", 5.0),
    ("autoencoder", "paper", 5.0), ("gaussian", "tuned", 5.0), ("autoencoder", "tuned", 5.0), ("limits", "paper", 5.0),
    ("autoencoder_all", "paper", 5.0), ("cusum", "paper", 5.0), ("conformal", "paper", 5.0),
    ("checksum", "paper", None),
)  # fmt: skip
"""Detector, profile, and the largest share of the kernels' time that is wanted (%); None = none is."""


def row(autopilot: str, name: str, profile: str, bar: float | None, costs: list[Cost]) -> str:
    """A row of the table: medians of flights."""
    each = statistics.median(1e6 * one.detection[ALL] / one.shown for one in costs)
    shares = sorted(100 * one.detection[ALL] / one.kernels for one in costs)
    middle = statistics.median(shares)
    redone = 100 * statistics.mean(one.recomputed for one in costs)
    kept = 100 * statistics.median(one.recovery[ALL] / one.kernels for one in costs)
    verdict = "–" if bar is None else f"{bar:g}: {'met' if middle <= bar else 'not met'}"
    return (
        f"| `{name}`, `{profile}` | `{autopilot}` | {each:.2f} | {middle:.2f} ({shares[0]:.2f} – {shares[-1]:.2f}) | "
        f"{verdict} | {kept:.2f} | {redone:.2f} |"
    )


def table(costs: dict[tuple[str, str, str], list[Cost]], flights: int, repeats: int) -> str:
    """The table of all detectors and profiles."""
    bars = {(name, profile): bar for name, profile, bar in DETECTORS}
    kernels = {
        autopilot: statistics.median(
            1e3 * one.kernels for key, own in costs.items() if key[0] == autopilot for one in own
        )
        for autopilot in AUTOPILOTS
    }
    times = ", ".join(f"{value:.0f} ms (`{autopilot}`)" for autopilot, value in kernels.items())
    lines = [
        f"{flights} missions of each profile ({' and '.join(ENVIRONMENTS)}), {repeats} repeats, detectors in turn; "
        f"load {os.getloadavg()[0]:.1f}. Golden flights, one process; the kernels take {times} of a flight, their "
        "Python included. Medians of flights, in brackets smallest and largest. Detection is what is wanted below the "
        "bar; recovery is, apart from repeated steps, the memory of kernels that is saved before each step, whatever "
        "the detector, each with the time of two clock readings.",
        "",
        "| detector | autopilot profile | µs per publication | share of the kernels' time (%) "
        "| wanted (%) | recovery (%) | recomputed, modelled (%) |",
        "|---|---|---|---|---|---|---|",
    ]
    return "\n".join([*lines, *(row(*key, bars[key[1:]], own) for key, own in costs.items())])


def main() -> None:
    """Fly, and write the table."""
    repeats, seeds = int(os.environ.get("N", "5")), int(os.environ.get("SEEDS", "2"))
    missions = [(environment, seed) for environment in ENVIRONMENTS for seed in range(seeds)]
    costs: dict[tuple[str, str, str], list[Cost]] = {
        (autopilot, name, profile): [] for autopilot in AUTOPILOTS for name, profile, _ in DETECTORS
    }
    for repeat in range(-1, repeats):  # repeat -1 compiles, or loads the cache
        for environment, seed in missions if repeat >= 0 else missions[:1]:
            for autopilot, name, profile in costs:
                mission = with_keys_of(MissionSpec(environment=environment, seed=seed, autopilot=autopilot), name)
                found = cost(mission, name, profile)
                if repeat >= 0:
                    costs[autopilot, name, profile].append(found)
        sys.stderr.write(f"\r{repeat + 1} of {repeats} repeats")
    written = table(costs, len(missions), repeats)
    page = PAGE.read_text(encoding="utf-8")
    block = with_others(written, page, "detector-cost")
    PAGE.write_text(between(page, "detector-cost", block), encoding="utf-8")
    sys.stdout.write(f"\n{written}\n")


if __name__ == "__main__":
    main()
