"""Predictions of `mavfi harden` from small ledgers, and how many of them hold on fresh missions.

    python -m benchmarks.hardening        # 20 ledgers, about 15 minutes

    LEDGERS=5 SEED=1 python -m benchmarks.hardening

A ledger has 6 to 10 missions in `sparse`, with random seeds from 700,000, a random part of the kernels and a random
budget.  Its plan is made as by `mavfi harden`, and the coverage of each protected function is measured in the missions
from which its certificate would be made, with more faults.  A prediction holds if the measured coverage lies within the
interval, which is that of two further missions measured without error; the last line adds the error of the measurement,
as verdicts do.

On 30 November 2026: 42 functions, 2 refused; half-width 10 points (median); 92.5 % within the interval, 100 % with the
error of the measurement.
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavfi.analysis.statistics import Rate, wilson
from mavfi.cli.commands import run
from mavfi.extras.hardening.advise import HardeningStudy, advise, every_choice, plan_of
from mavfi.extras.hardening.battery import SDC, Battery
from mavfi.extras.hardening.certify import bounds_of, coverage, difference, pairs_of, rate_of
from mavfi.extras.hardening.observed import merged, observe
from mavfi.extras.hardening.report import interval
from mavfi.faults.sampling import stream

FIRST_SEED = 700_000
KERNELS = ("point_cloud", "octomap", "collision_check", "rrt_connect", "pid")
BUDGETS = (1e-4, 0.2)
"""Smallest and largest budget: from one at which a part of a small kernel is protected."""
FRACTIONS = (0.25, 0.5, 0.75, 1.0)
"""Steps of a function: to build more of them takes most of the time."""
MAX_FAULTS = 600
MAX_INSTRUCTIONS = 2e9
"""Faults in each of plain and protected code, and the dynamic instructions that they may execute together."""
CAMPAIGN = """
name: small
environments: [sparse]
first_seed: {seed}
missions: {missions}
faults: 1
sampling: {{level: instruction, kernels: [{kernels}], which: all, model: one_bit, restart_s: 0.57}}
mission: {{autopilot: published, platform: i9-9940x, planner: rrt_connect}}
"""


class Comparison(NamedTuple):
    """A prediction for a function, not known if it was refused, and what was measured."""

    function: str
    predicted: Rate
    measured: Rate

    @property
    def half_width(self) -> float:
        """Of the predicted interval."""
        _, low, high = bounds_of(self.predicted)
        return (high - low) / 2

    @property
    def holds(self) -> bool:
        """Whether the measured coverage lies within the predicted interval."""
        _, low, high = bounds_of(self.predicted)
        return low <= bounds_of(self.measured).rate <= high

    @property
    def agrees(self) -> bool:
        """The same with the error of the measurement."""
        low, high = difference(self.measured, self.predicted)
        return low <= 0 <= high


def small_ledger(random: np.random.Generator, directory: Path) -> HardeningStudy:
    """Fly a random campaign."""
    kernels = random.choice(KERNELS, size=random.integers(1, 3), replace=False)
    missions = random.integers(6, 11)
    seed = FIRST_SEED + random.integers(200_000)
    text = CAMPAIGN.format(seed=seed, missions=missions, kernels=", ".join(kernels))
    print(f"{missions} missions from seed {seed}: {', '.join(kernels)}", flush=True)
    (directory / "small.yaml").write_text(text, encoding="utf-8")
    run(["campaign", "run", str(directory / "small.yaml"), "--out", str(directory / "out"), "--workers", "1"])
    return HardeningStudy.open(directory / "out")


def compare(study: HardeningStudy, budget: float) -> Iterator[Comparison]:
    """Predict, and measure in the next missions."""
    (advice,) = advise(study, budget, workers=1, seconds=0.05, choices=lambda target: every_choice(target, FRACTIONS))
    plan = plan_of(study, [advice])
    ((planner, _),) = study.by_planner().items()
    seen = []
    for scenario in study.fresh(planner):
        for functions in observe(scenario, study.kernels).values():
            seen += functions
    for pair in pairs_of(merged(seen), plan):
        random = stream(0, "benchmark", pair.planned.function)
        before = silent(pair.plain, random)
        after = silent(pair.protected, random)
        measured = coverage(before, after, pair.growth)
        if measured.rate is not None:
            yield Comparison(pair.seen.entry, rate_of(pair.planned.predicted), measured)


def silent(battery: Battery, random: np.random.Generator) -> Rate:
    """Silent corruptions per fault."""
    faults = int(min(MAX_FAULTS, MAX_INSTRUCTIONS / battery.counts.mean()))
    effects = battery.run(battery.draw(random, faults))
    return wilson(effects.count(SDC), faults)


def main() -> None:
    """Entry point."""
    random = np.random.default_rng(int(os.environ.get("SEED", "0")))
    comparisons = []
    for _ in range(int(os.environ.get("LEDGERS", "20"))):
        with tempfile.TemporaryDirectory() as directory:
            study = small_ledger(random, Path(directory))
            for comparison in compare(study, float(np.exp(random.uniform(*np.log(BUDGETS))))):
                comparisons.append(comparison)
                told = interval(comparison.predicted)
                print(f"  {comparison.function:18} {told:24} measured {interval(comparison.measured)}", flush=True)

    known = [comparison for comparison in comparisons if comparison.predicted.rate is not None]
    print(f"{len(comparisons)} predictions, {len(comparisons) - len(known)} refused")
    print(f"median half-width: {np.median([comparison.half_width for comparison in known]):.1%}")
    print(f"within the predicted interval: {np.mean([comparison.holds for comparison in known]):.1%}")
    print(f"with the error of the measurement: {np.mean([comparison.agrees for comparison in known]):.1%}")


if __name__ == "__main__":
    main()
