"""Cost of detection: time of detectors relative to kernels in the same flights; writes docs/reference/detectors.md.

    N=5 SEEDS=2 MODELS=out/models ONLY="pca duplicate" python -m benchmarks.detectors

N: repeats of each flight (5); one only for detectors that take more than a second of it.  SEEDS: missions of each
setting (2).  MODELS: folder of models of the detectors from other libraries (`mavfi train --baselines`); without it
they are left out.  ONLY: these detectors; the table is then printed, not written.  Detectors take turns within a
repeat; how they are timed: `mavfi.extras.paper.overheads`.
"""

import os
import statistics
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path

from mavfi.campaign.fingerprint import processor
from mavfi.errors import NotInstalledError, SpecMismatchError
from mavfi.extras.paper.overhead_views import ALL
from mavfi.extras.paper.overheads import LONG_S, Cost, cost
from mavfi.flight.compose import detector_for, resolve, with_keys_of
from mavfi.mission import MissionSpec
from mavfi.states import BASELINES
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
    ("autoencoder_all", "paper", None),
    ("checksum", "paper", None),
    ("duplicate", "paper", None),
    *((name, "paper", None) for name in BASELINES),
)
"""Detector, profile, and the largest share of the kernels' time that is wanted (%); None = none is."""
Key = tuple[str, str, str]
"""Autopilot profile, detector and its profile."""


def row(autopilot: str, name: str, profile: str, bar: float | None, costs: list[Cost]) -> str:
    """A row of the table: medians of flights."""
    each = statistics.median(1e6 * one.detection[ALL] / one.judged_count for one in costs)
    shares = sorted(100 * one.detection[ALL] / one.kernels for one in costs)
    middle = statistics.median(shares)
    redone = 100 * statistics.mean(one.recomputed for one in costs)
    kept = 100 * statistics.median(one.recovery[ALL] / one.kernels for one in costs)
    verdict = "–" if bar is None else f"{bar:g}: {'met' if middle <= bar else 'not met'}"
    return (
        f"| `{name}`, `{profile}` | `{autopilot}` | {each:.2f} | {middle:.2f} ({shares[0]:.2f} – {shares[-1]:.2f}) | "
        f"{verdict} | {kept:.2f} | {redone:.2f} |"
    )


def table(costs: Mapping[Key, list[Cost]], flights: int, repeats: int, left_out: Mapping[Key, str]) -> str:
    """The table of all detectors and profiles, and which were not measured."""
    bars = {(name, profile): bar for name, profile, bar in DETECTORS}
    kernels = {
        autopilot: statistics.median(found)
        for autopilot in AUTOPILOTS
        if (found := [1e3 * one.kernels for key, own in costs.items() if key[0] == autopilot for one in own])
    }
    times = ", ".join(f"{value:.0f} ms (`{autopilot}`)" for autopilot, value in kernels.items())
    lines = [
        f"Measured on {date.today().isoformat()}: {flights} missions of each profile ({' and '.join(ENVIRONMENTS)}), "
        f"{repeats} repeats (one where detection takes more than {LONG_S:g} s of a flight), detectors in turn; "
        f"load {os.getloadavg()[0]:.1f}. Golden flights, one process; the kernels take {times} of a flight, their "
        "Python included. Medians of flights, in brackets smallest and largest. Detection is what is wanted below the "
        "bar, and that of `duplicate` the steps that it computes again, per step; recovery is, apart from repeated "
        "steps, the memory of kernels that is saved before each step, whatever the detector, each with the time of two "
        "clock readings.",
        "",
        "| detector | autopilot profile | µs per publication | share of the kernels' time (%) "
        "| wanted (%) | recovery (%) | recomputed, modelled (%) |",
        "|---|---|---|---|---|---|---|",
        *(row(*key, bars[key[1:]], own) for key, own in costs.items()),
    ]
    reasons = {why: [key for key in left_out if left_out[key] == why] for why in left_out.values()}
    notes = [
        f"Not measured: {', '.join(f'`{name}` (`{autopilot}`)' for autopilot, name, _ in keys)}: {why}."
        for why, keys in reasons.items()
    ]
    return "\n".join([*lines, *(f"\n{note}" for note in notes)])


def models_of(name: str, models: Path | None) -> Path | None:
    """The folder of a detector's model; None = the shipped ones."""
    return models if name in BASELINES else None


def mission_of(key: Key, environment: str = ENVIRONMENTS[0], seed: int = 0) -> MissionSpec:
    """A mission of a setting."""
    autopilot, name, _ = key
    return with_keys_of(MissionSpec(environment=environment, seed=seed, autopilot=autopilot), name)


def unmeasured(keys: Iterable[Key], models: Path | None) -> dict[Key, str]:
    """Detectors that cannot fly, with the reason: no library, or no model."""
    found = {}
    for key in keys:
        if key[1] in BASELINES and models is None:
            found[key] = "needs MODELS, a folder of models of `mavfi train --baselines`"
            continue
        try:
            detector_for(resolve(mission_of(key)), *key[1:], models_of(key[1], models))
        except NotInstalledError as error:
            found[key] = str(error)
        except SpecMismatchError:
            found[key] = "there is no model for this autopilot profile"
    return found


def is_due(repeat: int, measured: Sequence[Cost], flights: int) -> bool:
    """Whether a detector flies in a repeat: a slow one only in the first, and in that before, which compiles."""
    return repeat < 1 or len(measured) < flights or measured[-1].detection[ALL] <= LONG_S


def main() -> None:
    """Fly, and write the table."""
    repeats, seeds = int(os.environ.get("N", "5")), int(os.environ.get("SEEDS", "2"))
    models, only = os.environ.get("MODELS"), os.environ.get("ONLY", "").split()
    folder = Path(models) if models else None
    missions = [(environment, seed) for environment in ENVIRONMENTS for seed in range(seeds)]
    every = [
        (autopilot, name, profile)
        for autopilot in AUTOPILOTS
        for name, profile, _ in DETECTORS
        if not only or name in only
    ]
    left_out = unmeasured(every, folder)
    costs: dict[Key, list[Cost]] = {key: [] for key in every if key not in left_out}
    for repeat in range(-1, repeats):  # repeat -1 compiles, or loads the cache
        due = [key for key, own in costs.items() if is_due(repeat, own, len(missions))]
        for environment, seed in missions if repeat >= 0 else missions[:1]:
            for key in due:
                found = cost(mission_of(key, environment, seed), *key[1:], models_of(key[1], folder))
                if repeat >= 0:
                    costs[key].append(found)
        sys.stderr.write(f"\r{repeat + 1} of {repeats} repeats")
    written = table(costs, len(missions), repeats, left_out)
    if not only:
        page = PAGE.read_text(encoding="utf-8")
        block = with_others(processor(), written, page, "detector-cost")
        PAGE.write_text(between(page, "detector-cost", block), encoding="utf-8")
    sys.stdout.write(f"\n{written}\n")


if __name__ == "__main__":
    main()
