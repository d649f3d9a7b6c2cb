"""Assembly of a flight: world, plant, kernels and loop."""

from collections.abc import Callable
from functools import partial

from mavfi.detectors.detector import Detector, check_states
from mavfi.flight.compose import pipeline_config
from mavfi.flight.duplicate import Duplicates
from mavfi.flight.loop import Loop
from mavfi.flight.plant import MakePlant
from mavfi.flight.policy import INLINE, Recovery
from mavfi.flight.recovery import DetectorTap
from mavfi.flight.restarts import Restarts
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.pipeline.ppc import build_pipeline
from mavfi.sim.environments import build_world
from mavfi.sim.simulator import Simulator

MakeKernels = Callable[[PipelineConfig], dict[str, Kernel]]


def new_loop(
    scenario: Scenario, *, profile: bool = False, functions: KernelFunctions = PLAIN, rewindable: bool = False,
    make_plant: MakePlant = Simulator, make_kernels: MakeKernels = build_pipeline,
) -> Loop:  # fmt: skip
    """Build a flight in its initial state, without taps.

    Args:
        scenario: The mission.
        profile: Whether to record the publication times of each state.
        functions: Functions that kernels call: compiled or instrumented.
        rewindable: Whether the flight can be restored to earlier instants (`flight.checkpoints`): maps keep an
            undo log, and kernels are marked even without a detector.
        make_plant: Constructs the plant.
        make_kernels: Constructs the kernels; they may be proxies of remote ones.

    Raises:
        BadInputError: The scenario cannot be flown, e.g. the start lies in an obstacle.
    """
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    plant = make_plant(world, scenario)
    config = pipeline_config(scenario, world, plant.ray_directions, rewindable, functions)
    make = partial(make_kernels, config)
    return Loop(scenario, world, plant, make, want_profile=profile, marks=rewindable)


def watch(loop: Loop, detector: Detector | None, recovery: Recovery = INLINE) -> None:
    """Attach a detector to a flight that has not started; None = no effect.

    Raises:
        BadInputError: The detector lists a state that does not exist.
    """
    if detector is None:
        return
    check_states(detector)
    loop.marks = True
    install(loop, detector, recovery, restarts_for(loop, recovery)).begin()


def restarts_for(loop: Loop, recovery: Recovery) -> Restarts | None:
    """What restarts nodes for a recovery policy, from what it sees from now on; None = the policy restarts none."""
    return Restarts(loop, "readback") if recovery.restarts else None


def install(loop: Loop, detector: Detector, recovery: Recovery, restarts: Restarts | None) -> DetectorTap:
    """Install a detector's tap, and what it asks of the loop, in the place of those of another one."""
    if restarts is None:
        tap = DetectorTap(loop, detector, recovery)
    else:
        tap = DetectorTap(loop, detector, recovery, restarts.die)
    loop.taps.detector = tap
    loop.taps.watched = tap.states
    loop.taps.seal = tap.seal if tap.seals else None
    loop.taps.again = tap.lost if recovery.resends else None
    loop.verify = Duplicates(loop, detector.duplicates) if detector.duplicates else None
    return tap
