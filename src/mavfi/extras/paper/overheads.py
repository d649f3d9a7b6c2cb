"""Time of detection and recovery relative to that of the kernels, measured on this machine in one process.

The paper's Table II.  The time of detection is also divided by the compute time that the platform's latencies give the
pipeline, as if the detector were as fast on the platform as here (docs/reference/models.md).

The publications that a detector checks are recorded in flight and replayed to it afterwards, several times and in
blocks, since a timer around each call would take longer than the call.
"""

import json
import statistics
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mavfi.campaign.config import Campaign
from mavfi.campaign.fingerprint import processor
from mavfi.campaign.resolve import resolve as resolve_campaign
from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError, write_text
from mavfi.extras.paper.overhead_views import ALL, FILE
from mavfi.flight.compose import detector_for, new_loop, resolve, watch
from mavfi.flight.decide import SCANNING, Action, RecoveryPolicy
from mavfi.mission import MissionSpec
from mavfi.pipeline.ppc import build_pipeline
from mavfi.states import KERNELS, PPC_STAGES, Stage, State

STAGES = (*map(str, PPC_STAGES), ALL)
_REPLAYS = 5
"""Number of replays, of whose times the median is taken."""
_BLOCK = 16
"""Publications that are timed at once: few enough to stay in the CPU cache, see `replay`."""
LONG_S = 1.0
"""Time of a replay from which on it is not repeated: the clock is fine enough for one."""


class Cost(NamedTuple):
    """Times of one flight with a detector, by stage and, under `ALL`, in total.

    Attributes:
        kernels: Time of all kernels, including the reception of their inputs (s).
        detection: Time of `check` and `accept`, by stage of the publications, and of steps that are computed again for
            comparison (s).
        recovery: Time of repeated steps, and of saving and restoring memory for them (s).
        judged_count: Number of publications that the detector checked, and of steps that were computed again.
        recomputed: Recomputations / computations, both in the platform's modelled time.
        compute: Compute time of the pipeline with the platform's latencies, without recomputations (s).
    """

    kernels: float
    detection: Mapping[str, float]
    recovery: Mapping[str, float]
    judged_count: int
    recomputed: float
    compute: float


Verify = Callable[[Any, list[State], int], tuple[list[State], int]]


class _Clock:
    """Wall time (s) and calls by kernel and method; verification of steps, by stage, is apart."""

    def __init__(self) -> None:
        self.seconds: defaultdict[tuple[str, str], float] = defaultdict(float)
        self.calls: Counter[tuple[str, str]] = Counter()
        self.verification_seconds: defaultdict[str, float] = defaultdict(float)
        self.verification_count = 0

    def timed(self, kernel: Any, method: str) -> None:
        """Wrap a method of a kernel in a timer."""
        function = getattr(kernel, method)
        key = (kernel.name, method)
        clock = time.perf_counter

        def call(*arguments: Any) -> Any:
            start = clock()
            result = function(*arguments)
            self.seconds[key] += clock() - start
            self.calls[key] += 1
            return result

        setattr(kernel, method, call)

    def timed_verification(self, verify: Verify) -> Verify:
        """Wrap a function that computes steps again: its time, by stage, is not that of kernels."""

        def call(kernel: Any, states: list[State], now: int) -> tuple[list[State], int]:
            seconds = self.seconds.copy()
            calls = self.calls.copy()
            start = time.perf_counter()
            result = verify(kernel, states, now)
            self.verification_seconds[str(kernel.stage)] += time.perf_counter() - start
            self.seconds = seconds
            self.calls = calls
            self.verification_count += 1
            return result

        return call

    def step(self, kernel: str) -> float:
        """Mean time of a step (s)."""
        key = kernel, "step"
        if self.calls[key]:
            return self.seconds[key] / self.calls[key]
        return 0.0


def cost(
    mission: MissionSpec,
    name: str,
    profile: str,
    models_dir: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> Cost:
    """Fly a golden mission with a detector, then replay its publications to the detector.

    Raises:
        BadInputError: The mission cannot be flown, or the detector or its model does not exist.
    """
    # a pipeline whose kernels are timed
    clock = _Clock()

    def build(config: Any) -> Any:
        kernels: dict[str, Any] = build_pipeline(config)
        for kernel in kernels.values():
            for method in ("step", "receive", "mark", "rollback"):
                clock.timed(kernel, method)
        return kernels

    scenario = resolve(mission)
    detector = detector_for(scenario, name, profile, models_dir, mission.trained_for, options).detector
    loop = new_loop(scenario, make_kernels=build)
    watch(loop, detector, RecoveryPolicy.of(mission))
    if loop.verify is not None:
        loop.verify = clock.timed_verification(loop.verify)

    # count the steps that a recovery repeats: they are timed with all other steps of their kernels
    repeated: Counter[tuple[str, str]] = Counter()
    recompute = loop.recompute

    def count_and_recompute(action: Action, now: int) -> None:
        kernels: Sequence[str] = (action.kernel,)
        if action.kernel in SCANNING:
            kernels = SCANNING
        for kernel in kernels:
            repeated[str(action.stage), kernel] += 1
        recompute(action, now)

    loop.recompute = count_and_recompute  # type: ignore[method-assign]

    # record what the detector checks, for the replay
    watched = loop.taps.watched
    publications = list[tuple[State, int]]()
    loop.taps.recorders.append(lambda state, now: publications.append((state, now)))
    meta = loop.fly().log.meta
    recompute_us = sum(meta["recompute_us"].values())
    compute_us = sum(meta["compute_us"].values())
    if not compute_us > recompute_us:
        raise BadInputError(f"platform {scenario.platform.name}: latency_us: all are 0; allowed: one above 0 at least")

    # replay them
    judged = [(state, now) for state, now in publications if watched is None or state.spec.name in watched]
    seconds_of_kernels = sum(spent for (_, method), spent in clock.seconds.items() if method in ("step", "receive"))
    return Cost(
        seconds_of_kernels,
        _detection(detector, judged, clock.verification_seconds),
        _recovery(clock, repeated),
        len(judged) + clock.verification_count,
        recompute_us / compute_us,
        1e-6 * (compute_us - recompute_us),
    )


def _detection(
    detector: Detector, publications: Sequence[tuple[State, int]], verification_seconds: Mapping[str, float]
) -> dict[str, float]:
    """Time of a detector by stage (s), with that of steps that were computed again for it."""

    def seconds_of(part: Sequence[tuple[State, int]]) -> float:
        if not part:
            return 0.0
        times = [replay(detector, part)]
        while times[0] < LONG_S and len(times) < _REPLAYS:
            times.append(replay(detector, part))
        return statistics.median(times)

    by_stage = {}
    for stage in PPC_STAGES:
        of_stage = [(state, now) for state, now in publications if state.spec.stage is stage]
        by_stage[str(stage)] = seconds_of(of_stage) + verification_seconds.get(str(stage), 0.0)
    return {**by_stage, ALL: seconds_of(publications) + sum(verification_seconds.values())}


def _recovery(clock: _Clock, repeated: Mapping[tuple[str, str], int]) -> dict[str, float]:
    """Time of recovery by stage (s): saving and restoring memory, and repeated steps at the mean time of a step."""
    by_stage = dict.fromkeys(STAGES, 0.0)
    for (kernel, method), spent in clock.seconds.items():
        if method in ("mark", "rollback") and KERNELS[kernel].stage is not Stage.SENSOR:
            by_stage[str(KERNELS[kernel].stage)] += spent
    for (stage, kernel), times in repeated.items():
        by_stage[stage] += times * clock.step(kernel)
    return {**by_stage, ALL: sum(by_stage.values())}


def replay(detector: Detector, publications: Sequence[tuple[State, int]]) -> float:
    """Wall time (s) of a detector over publications, which it receives, and may seal, as in flight.

    In flight a publication has just been written, so each block is read once before timing to warm the CPU cache.
    The time of the loop itself is subtracted: that of the same loop without the detector.
    """
    detector.start()
    spent = 0.0
    clock = time.perf_counter
    for first in range(0, len(publications), _BLOCK):
        block = publications[first : first + _BLOCK]
        for state, _ in block:  # into the cache
            state.header.tobytes(), state.elements.tobytes()
        timed_publications: Iterable[tuple[State, int]] = block
        if detector.seals:
            timed_publications = _sealed(block, detector.seal)
        start = clock()
        for state, now in timed_publications:
            detector.check(state, now)  # after a false alarm, the value is assumed to be published, too
            detector.accept(state, now)
        middle = clock()
        for state, now in block:  # noqa: B007 - as above
            pass
        spent += 2.0 * middle - start - clock()  # (middle - start) - (clock() - middle)
    return spent


def _sealed(
    publications: Iterable[tuple[State, int]], seal: Callable[[State, int], None]
) -> Iterator[tuple[State, int]]:
    for state, now in publications:
        seal(state, now)
        yield state, now


def measure(
    campaign: Campaign,
    missions: int,
    models_dir: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Measure every detector of a campaign on golden flights in each of its environments.

    Args:
        campaign: Environments, mission and arms.
        missions: Flights per environment and arm; an additional warm-up flight precedes them.
        models_dir: Folder of trained models; None = the shipped ones.
        progress: Called with the numbers of completed and of all flights.

    Returns:
        `processor`, `missions`, and `rows`: environment, arm, stage, and medians over flights of `detection` and
        `recovery` as shares of the kernels' time, and of `detection_modelled`, the time of detection as a share of the
        modelled compute time; `flights` has the three of each flight, in order of seed.

    Raises:
        BadInputError: No arm has a detector, or a mission cannot be flown.
    """
    # the flights: each seed in each environment with each detector
    arms = [arm for arm in resolve_campaign(campaign).arms if arm.detector]
    if not arms:
        raise BadInputError(f"campaign {campaign.name}: arms: none has a detector; needed: one at least")
    seeds = range(campaign.first_seed, campaign.first_seed + missions)
    total = len(campaign.environments) * len(arms) * missions
    done = 0

    # fly them one after the other; rows have medians over the seeds
    rows: list[dict[str, Any]] = []
    for environment in campaign.environments:
        for arm in arms:
            flights = [campaign.spec(environment, seed, arm.overrides) for seed in seeds]
            if not rows:  # warm-up: compiles, or reads the cache
                cost(flights[0], arm.detector, arm.profile, models_dir, arm.options)
            costs = []
            for mission in flights:
                costs.append(cost(mission, arm.detector, arm.profile, models_dir, arm.options))
                done += 1
                progress(done, total)
            rows += [
                {"environment": environment, "arm": arm.name, "stage": stage, **_shares(costs, stage)}
                for stage in STAGES
            ]
    return {"processor": processor(), "missions": missions, "rows": rows}


def _shares(costs: Iterable[Cost], stage: str) -> dict[str, Any]:
    """Cells of a row: medians of the shares over flights, and the shares of each flight."""
    shares = [
        (
            flight.detection[stage] / flight.kernels,
            flight.recovery[stage] / flight.kernels,
            flight.detection[stage] / flight.compute,
        )
        for flight in costs
    ]
    medians = map(statistics.median, zip(*shares, strict=True))
    return dict(zip(("detection", "recovery", "detection_modelled"), medians, strict=True)) | {"flights": shares}


def save(measured: Mapping[str, Any], directory: Path) -> Path:
    """Write measured overheads to the folder of a campaign, from which its views read them."""
    path = directory / FILE
    write_text(path, json.dumps(measured, indent=1) + "\n")
    return path
