"""Cost of detection: time of detectors relative to kernels in the same flights; writes docs/models.md.

    N=5 SEEDS=2 python -m benchmarks.detectors

N: repeats of each flight (5).  SEEDS: missions per setting (2).  Detectors alternate within a repeat.  The publications
of a flight are replayed to its detector several times, in blocks, as a timer around each call would take longer than
the call itself.
"""

import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from benchmarks.rows import processor
from mavfi.detectors.detector import Detector
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.watching import detector_for
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.ppc import build_pipeline
from mavfi.states import State
from tools.markers import DOCS, between

PAGE = DOCS / "models.md"
ENVIRONMENTS, STACKS = ("dense", "factory"), ("published", "hardened")
DETECTORS = (
    ("acceptance", "paper", 1.0), ("gaussian", "paper", 5.0), ("autoencoder", "paper", 5.0), ("gaussian", "tuned", 5.0),
    ("autoencoder", "tuned", 5.0),
)  # fmt: skip
"""Detector, profile, and target for its share of the kernels' time (%)."""
_REPLAYS, _BLOCK = 5, 16


class Cost(NamedTuple):
    """One flight with a detector.

    Attributes:
        kernels: Time of all kernels, including their input processing (s).
        detector: Time of `check` and `accept` (s).
        shown: Number of publications that the detector checked.
        redone: Recomputation time / computation time, both modelled for the platform.
    """

    kernels: float
    detector: float
    shown: int
    redone: float


def cost(scenario: Scenario, name: str, profile: str) -> Cost:
    """Fly a mission with a detector, and replay the same publications to it."""
    wall, clock = [0.0], time.perf_counter

    def timed(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            start = clock()
            result = function(*arguments)
            wall[0] += clock() - start
            return result

        return call

    def build(config: Any) -> Any:
        built: dict[str, Any] = build_pipeline(config)
        for kernel in built.values():
            kernel.step, kernel.receive = timed(kernel.step), timed(kernel.receive)
        return built

    detector = detector_for(scenario, name, profile)[0]
    loop = new_loop(scenario, make_kernels=build)
    watch(loop, detector)
    states, shown = loop.taps.watched, list[tuple[State, int]]()
    loop.taps.recorders.append(lambda state, now: shown.append((state, now)))
    meta = loop.fly().log.meta
    watched = [(state, now) for state, now in shown if states is None or state.spec.name in states]
    seconds = statistics.median(replay(detector, watched) for _ in range(_REPLAYS))
    redone = sum(meta["recompute_us"].values()) / sum(meta["compute_us"].values())
    return Cost(wall[0], seconds, len(watched), redone)


def replay(detector: Detector, publications: list[tuple[State, int]]) -> float:
    """Wall time (s) of checking and accepting publications.

    In a flight a publication has just been written; to emulate this, each block is read once before it is timed.
    """
    detector.start()
    spent, clock = 0.0, time.perf_counter
    for first in range(0, len(publications), _BLOCK):
        block = publications[first : first + _BLOCK]
        for state, _ in block:
            state.header.tobytes()
        start = clock()
        for state, now in block:
            detector.check(state, now)
            detector.accept(state, now)
        spent += clock() - start
    return spent


def row(stack: str, name: str, profile: str, bar: float, costs: list[Cost]) -> str:
    """A row of the table: medians over flights."""
    each = statistics.median(1e6 * one.detector / one.shown for one in costs)
    shares = sorted(100 * one.detector / one.kernels for one in costs)
    middle = statistics.median(shares)
    redone = 100 * statistics.mean(one.redone for one in costs)
    verdict = "met" if middle <= bar else "not met"
    return (
        f"| `{name}`, `{profile}` | `{stack}` | {each:.2f} | {middle:.2f} ({shares[0]:.2f} – {shares[-1]:.2f}) | "
        f"{bar:g}: {verdict} | {redone:.2f} |"
    )


def table(costs: dict[tuple[str, str, str], list[Cost]], flights: int, repeats: int) -> str:
    """The table of all detectors and profiles."""
    bars = {(name, profile): bar for name, profile, bar in DETECTORS}
    kernels = {
        stack: statistics.median(1e3 * one.kernels for key, own in costs.items() if key[0] == stack for one in own)
        for stack in STACKS
    }
    times = ", ".join(f"{value:.0f} ms (`{stack}`)" for stack, value in kernels.items())
    lines = [
        f"{flights} missions of each profile ({' and '.join(ENVIRONMENTS)}), {repeats} repeats, detectors in turn; "
        f"{processor()}, load {os.getloadavg()[0]:.1f}. Golden flights, one process; the kernels take "
        f"{times} of a flight, their Python included. Medians of flights, in brackets smallest and largest.",
        "",
        "| detector | autopilot profile | µs per publication | share of the kernels' time (%) "
        "| wanted (%) | recomputed, modelled (%) |",
        "|---|---|---|---|---|---|",
    ]
    return "\n".join([*lines, *(row(*key, bars[key[1:]], own) for key, own in costs.items())])


def main() -> None:
    """Fly, and write the table."""
    repeats, seeds = int(os.environ.get("N", "5")), int(os.environ.get("SEEDS", "2"))
    missions = [(environment, seed) for environment in ENVIRONMENTS for seed in range(seeds)]
    costs: dict[tuple[str, str, str], list[Cost]] = {
        (stack, name, profile): [] for stack in STACKS for name, profile, _ in DETECTORS
    }
    for repeat in range(-1, repeats):  # repeat -1 compiles, or loads the cache
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
