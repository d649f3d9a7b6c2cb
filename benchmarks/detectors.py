"""What detection costs: wall time of detectors and of kernels in the same flights; writes docs/models.md.

    N=5 SEEDS=2 python -m benchmarks.detectors

N: repeats of each flight (5).  SEEDS: missions of each setting (2).  Detectors take turns within a repeat, so that
whatever else the machine does meets all of them.  What a timer itself takes is measured next to it, and taken off.
"""

import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from benchmarks.rows import processor
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.watching import detector_for
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.ppc import build_pipeline
from tools.markers import DOCS, between

PAGE = DOCS / "models.md"
ENVIRONMENTS, STACKS = ("dense", "factory"), ("published", "hardened")
DETECTORS = (
    ("acceptance", "paper", 1.0), ("gaussian", "paper", 5.0), ("autoencoder", "paper", 5.0), ("gaussian", "tuned", 5.0),
    ("autoencoder", "tuned", 5.0),
)  # fmt: skip
"""Detector, profile, and the largest share of the kernels' time that is wanted (%)."""
_CALLS = 20_000


class Timer:
    """Adds up the wall time of calls."""

    def __init__(self) -> None:
        self.ns, self.calls = 0, 0

    def around(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, timed."""
        clock = time.perf_counter_ns

        def timed(*arguments: Any) -> Any:
            start = clock()
            result = function(*arguments)
            self.ns += clock() - start
            self.calls += 1
            return result

        return timed

    def seconds(self, own_ns: float) -> float:
        """Time of all calls (s), without what the timer takes of each (ns)."""
        return 1e-9 * (self.ns - self.calls * own_ns)


def own_time() -> float:
    """What a timer adds to the time of a call (ns)."""

    def nothing(state: object, now: int) -> None:
        """As short as a call can be."""

    timer = Timer()
    timed = timer.around(nothing)
    for _ in range(_CALLS):
        timed(None, 0)
    plain = time.perf_counter_ns()
    for _ in range(_CALLS):
        nothing(None, 0)
    return (timer.ns - (time.perf_counter_ns() - plain)) / _CALLS


class Cost(NamedTuple):
    """One flight with a detector.

    Attributes:
        kernels: Wall time of all kernels, what they do with their inputs included (s).
        detector: Wall time of `check` and `accept` (s).
        tap: Wall time of the tap: the detector, and what the host does to show it states (s).
        shown: Publications that the detector was shown.
        redone: Recomputations / computations, both in the platform's modelled time.
    """

    kernels: float
    detector: float
    tap: float
    shown: int
    redone: float


def cost(scenario: Scenario, name: str, profile: str) -> Cost:
    """Fly a mission with a detector, first with timers around kernels and detector, then around kernels and tap."""
    found: list[tuple[float, float, int, float]] = []
    for whole in (False, True):
        kernels, watching = Timer(), Timer()

        def build(config: Any, kernels: Timer = kernels) -> Any:
            built: dict[str, Any] = build_pipeline(config)
            for kernel in built.values():
                kernel.step, kernel.receive = kernels.around(kernel.step), kernels.around(kernel.receive)
            return built

        detector: Any = detector_for(scenario, name, profile)[0]
        loop = new_loop(scenario, make_kernels=build)
        watch(loop, detector)
        assert loop.taps.detector is not None  # just attached
        if whole:
            loop.taps.detector = watching.around(loop.taps.detector)
        else:
            detector.check, detector.accept = watching.around(detector.check), watching.around(detector.accept)
        meta = loop.fly().log.meta
        own = own_time()
        redone = sum(meta["recompute_us"].values()) / sum(meta["compute_us"].values())
        found.append((kernels.seconds(own), watching.seconds(own), watching.calls, redone))
    (kernels_s, detector_s, _, redone), (other_s, tap_s, shown, _) = found
    return Cost(kernels_s, detector_s, tap_s * kernels_s / other_s, shown, redone)


def row(stack: str, name: str, profile: str, bar: float, costs: list[Cost]) -> str:
    """A row of the table: medians of flights."""
    each = statistics.median(1e6 * one.detector / one.shown for one in costs)
    shares = sorted(100 * one.detector / one.kernels for one in costs)
    middle, tap = statistics.median(shares), statistics.median(100 * one.tap / one.kernels for one in costs)
    redone = 100 * statistics.mean(one.redone for one in costs)
    verdict = "met" if middle <= bar else "not met"
    return (
        f"| `{name}`, `{profile}` | `{stack}` | {each:.2f} | {middle:.2f} ({shares[0]:.2f} – {shares[-1]:.2f}) | "
        f"{tap:.2f} | {bar:g}: {verdict} | {redone:.2f} |"
    )


def table(costs: dict[tuple[str, str, str], list[Cost]], flights: int, repeats: int) -> str:
    """The table of all detectors and stacks."""
    bars = {(name, profile): bar for name, profile, bar in DETECTORS}
    kernels = {
        stack: statistics.median(1e3 * one.kernels for key, own in costs.items() if key[0] == stack for one in own)
        for stack in STACKS
    }
    times = ", ".join(f"{value:.0f} ms (`{stack}`)" for stack, value in kernels.items())
    lines = [
        f"{flights} missions of each profile ({' and '.join(ENVIRONMENTS)}), {repeats} repeats, detectors in turn; "
        f"{processor()}. Golden flights, one process; the kernels take {times} of a flight, with their share of the "
        "host's Python. Medians of flights, in brackets smallest and largest.",
        "",
        "| detector | autopilot profile | µs per publication | share of the kernels' time (%) | with the tap (%) "
        "| wanted (%) | recomputed, modelled (%) |",
        "|---|---|---|---|---|---|---|",
    ]
    return "\n".join([*lines, *(row(*key, bars[key[1:]], own) for key, own in costs.items())])


def main() -> None:
    """Fly, write the table."""
    repeats, seeds = int(os.environ.get("N", "5")), int(os.environ.get("SEEDS", "2"))
    missions = [(environment, seed) for environment in ENVIRONMENTS for seed in range(seeds)]
    costs: dict[tuple[str, str, str], list[Cost]] = {
        (stack, name, profile): [] for stack in STACKS for name, profile, _ in DETECTORS
    }
    for repeat in range(-1, repeats):  # the first one compiles, or reads the cache
        for environment, seed in missions if repeat >= 0 else missions[:1]:
            for stack, name, profile in costs:
                scenario = resolve(MissionSpec(environment=environment, seed=seed, autopilot=stack))
                found = cost(scenario, name, profile)
                if repeat >= 0:
                    costs[stack, name, profile].append(found)
        sys.stderr.write(f"\r{repeat + 1} of {repeats} repeats")
    written = table(costs, len(missions), repeats)
    PAGE.write_text(between(PAGE.read_text(encoding="utf-8"), "detector-cost", written), encoding="utf-8")
    sys.stdout.write(f"\n{written}\n")


if __name__ == "__main__":
    main()
