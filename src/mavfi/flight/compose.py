"""Resolution of names into a scenario and its detector, and of these into a flight that has not started."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.config import (
    SCAN_ENDINGS,
    AutopilotConfig,
    CameraConfig,
    Config,
    EnvironmentConfig,
    LocalizationConfig,
    MapConfig,
    PlannerConfig,
    PlatformConfig,
    WindConfig,
    names,
    parse,
    shipped,
)
from mavfi.detectors.detector import Detector, blind_spots, check_states
from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.registry import Loaded, load_detector, mission_keys
from mavfi.errors import BadInputError
from mavfi.faults.plug_ins import plug_ins_of_spec
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.host import ArmSetup
from mavfi.flight.latencies import latency, stage_latency
from mavfi.flight.loop import CONTROL_PERIOD_US, Loop, Profiler
from mavfi.flight.plant import MakePlant
from mavfi.flight.recovery import DetectorTap, Duplicates
from mavfi.flight.restarts import Restarts
from mavfi.flight.taps import CHECKED_AT_PRODUCER
from mavfi.kernels.perception.state_estimation import Noise
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.functions import PLAIN, FlightFunctions, KernelFunctions
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.pipeline.maps import find_map
from mavfi.pipeline.planners import find_search
from mavfi.pipeline.ppc import build_pipeline, find_kernel
from mavfi.rewriting import rewriter
from mavfi.sim import imu
from mavfi.sim.controller import find_controller
from mavfi.sim.environments import World, environment_for_file, find_generator, scenario_world
from mavfi.sim.environments.registry import SCAN_GENERATOR
from mavfi.sim.imported import ENVIRONMENT_FILES, EnvironmentReader, extensions_of, reader_of
from mavfi.sim.mjcf import find_vehicle
from mavfi.sim.simulator import Simulator
from mavfi.states import INJECTED_KERNEL, PLANNERS, PLUG_INS, REPLACEABLE, Stage, State, states_with

_DEFAULT_V_MAX = 3.0
"""Speed limit where neither mission nor environment has one (m/s)."""
_FILES = (".yaml", ".yml")
"""File name extensions of configurations."""
_NOMINAL_RADIUS = 0.35
"""Collision radius of the vehicle for which the radii of an autopilot profile are specified (m)."""
_LEAST_POSITION_NOISE = 1e-3
"""Noise of position fixes that the estimator assumes at least (m), see `noise_of`."""
_LEAST_HEADING_NOISE = 1e-3
"""Noise of heading fixes that it assumes at least (rad)."""
_AUTOPILOT_KEYS = ("alarm", "epoch_liveness")
"""Keys of an autopilot profile that a mission can override."""
_VOXELS_OFF = 1.0
"""Voxels of the map by which a wall in it can be off."""
_LIMITS = ("arena_lower", "arena_upper", "flight_lower", "flight_upper", "goal")
"""Arrays of a world that the pipeline may know."""


def find_environment(name: str) -> EnvironmentConfig:
    """Find an environment: a shipped name, a YAML file, a scanned map (.bt, .ot), or a file that an extra reads.

    Raises:
        BadInputError: The environment does not exist.
    """
    if name.lower().endswith(SCAN_ENDINGS):
        return environment_for_file(Path(name))
    reader: EnvironmentReader | None = reader_of(ENVIRONMENT_FILES, name)
    if reader is not None:
        environment = reader(Path(name))
        if environment is not None:
            return environment
    endings = chain(SCAN_ENDINGS, extensions_of(ENVIRONMENT_FILES))
    return shipped("environments", EnvironmentConfig, name, endings)


def _with_unknown_space(environment: EnvironmentConfig, unknown: str) -> EnvironmentConfig:
    """The environment of a scanned map with its parameter `unknown`."""
    if environment.generator != SCAN_GENERATOR:
        text = f"environment {environment.name!r} is no scanned map; allowed: with a .bt or .ot file"
        raise BadInputError(f"unknown_space: {unknown}: {text}")
    return environment.model_copy(update={"parameters": {**environment.parameters, "unknown": unknown}})


def find_planner(name: str) -> PlannerConfig:
    """Find a planner: a shipped name, a YAML file, or an entry point or "package:Class" with default parameters."""
    if name.endswith(_FILES) or name in names("planners"):
        return shipped("planners", PlannerConfig, name)
    return PlannerConfig(name=name)


def resolve(spec: MissionSpec) -> Scenario:
    """Resolve a spec to a scenario; unset options default to the environment's values, then to global defaults.

    Raises:
        BadInputError: A name is unknown, a value is out of range, or options are incompatible.
    """
    # The environment, in which the mission may replace the vehicle.
    environment = find_environment(spec.environment)
    if spec.unknown_space != MissionSpec.model_fields["unknown_space"].default:
        environment = _with_unknown_space(environment, spec.unknown_space)
    vehicle_source = spec.environment  # the file that names the vehicle, for messages
    if spec.vehicle is not None:
        environment = environment.model_copy(update={"vehicle": spec.vehicle})
        vehicle_source = ""

    # Options whose default depends on the environment.
    speed = spec.v_max
    if speed is None:
        speed = environment.v_max or _DEFAULT_V_MAX
    if not 0.1 <= speed <= 20.0:
        raise BadInputError(f"v_max: {speed}: must lie between 0.1 and 20 m/s")
    camera = CameraConfig(noise=spec.depth_noise)
    camera_range = spec.camera_range or environment.camera_range
    if camera_range is not None:
        camera = CameraConfig(noise=spec.depth_noise, range=camera_range)
    resolution = spec.map_resolution
    if resolution is None:
        resolution = environment.map_resolution

    # Everything else that is looked up by name.
    protection = None
    if spec.protection:
        protection = rewriter().load(spec.protection)
    planner = find_planner(spec.planner)
    with _read_from(spec.planner, "name"):
        find_search(planner.name)
    with _read_from(spec.environment, "generator"):
        find_generator(environment.generator)
    with _read_from(vehicle_source, "vehicle"):
        vehicle = find_vehicle(environment.vehicle)
    find_controller(spec.flight_controller)
    return Scenario(
        environment=environment,
        seed=spec.seed,
        autopilot=_autopilot(spec),
        vehicle=vehicle,
        platform=_platform(spec, protection),
        planner=planner,
        camera=camera,
        map=_map_config(spec.map, resolution),
        v_max=speed,
        start=spec.start,
        goal=spec.goal,
        wind=parse(WindConfig, {"gust": spec.wind}, "wind"),
        localization=parse(LocalizationConfig, {"kind": spec.localization}, "localization"),
        dead_node=spec.dead_node,
        flight_controller=spec.flight_controller,
        kernels=_own_kernels(spec),
        protection=protection,
        arrival_radius=spec.arrival_radius,
        time_limit_factor=spec.time_limit_factor,
        latency_jitter=spec.latency_jitter,
    )


@contextmanager
def _read_from(source: str, key: str) -> Iterator[None]:
    """Name file and key in a BadInputError about a value that was read from a YAML file."""
    try:
        yield
    except BadInputError as error:
        if not source.endswith(_FILES):
            raise
        raise type(error)(f"{source}: key {key!r}: {error}") from None


def _platform(spec: MissionSpec, protection: Config | None) -> PlatformConfig:
    """The computer, on which a protected kernel takes as much longer as was measured."""
    platform = shipped("platforms", PlatformConfig, spec.platform)
    if spec.planner_latency is not None:
        planner_us = {"planner": round(1e6 * spec.planner_latency)}
        platform = platform.model_copy(update={"latency_us": {**platform.latency_us, **planner_us}})
    if protection is None:
        return platform
    absent = set(PLANNERS) - {find_planner(spec.planner).name}
    present = {kernel: row for kernel, row in INJECTED_KERNEL.items() if kernel not in absent}
    times = {row: rewriter().time_of(protection, kernel) for kernel, row in present.items()}
    for plug_in in plug_ins_of_spec(spec):
        times[PLUG_INS[plug_in.role].kernel] = rewriter().time_of(protection, plug_in.name)
    charged = {kernel: round(us * times.get(kernel, 1.0)) for kernel, us in platform.latency_us.items()}
    return platform.model_copy(update={"latency_us": charged})


def _own_kernels(spec: MissionSpec) -> dict[str, str]:
    """Classes of a user's own, by the kernels in whose place they are, after checking that they can be."""
    kernels = {name: getattr(spec, name) for name in REPLACEABLE if getattr(spec, name)}
    for name, address in kernels.items():
        find_kernel(name, address)
    return kernels


def _autopilot(spec: MissionSpec) -> AutopilotConfig:
    """The autopilot profile with the mission's overrides."""
    overrides = {}
    for key in _AUTOPILOT_KEYS:
        value = getattr(spec, key)
        if value is not None:
            overrides[key] = value
    return shipped("autopilots", AutopilotConfig, spec.autopilot).model_copy(update=overrides)


def _map_config(kind: str, resolution: float | None) -> MapConfig:
    """The map's configuration; resolution (m): None = the default."""
    keys: dict[str, Any] = {"kind": kind}
    if resolution is not None:
        keys["resolution"] = resolution
    find_map(kind)
    return parse(MapConfig, keys, "map")


def pipeline_config(
    scenario: Scenario,
    world: World,
    directions: np.ndarray,
    *,
    rewindable: bool = False,
    functions: KernelFunctions = PLAIN,
) -> PipelineConfig:
    """The pipeline's configuration for a mission.

    Args:
        scenario: The mission.
        world: Its world: only limits and goal are passed on; the pipeline senses obstacles through the camera.
        directions: Ray direction of each pixel. Shape (n, 3).
        rewindable: Whether the flight can be restored to earlier instants.
        functions: Functions that the kernels call.
    """
    autopilot = scenario.autopilot
    growth = scenario.vehicle.collision_radius / _NOMINAL_RADIUS
    # copies: kernels would be compiled a second time for the world's read-only arrays
    limits = {name: getattr(world, name).copy() for name in _LIMITS}
    return PipelineConfig(
        autopilot=autopilot,
        planner=scenario.planner,
        map=scenario.map,
        camera=scenario.camera,
        directions=directions,
        **limits,
        seed=scenario.seed,
        v_max=scenario.v_max,
        a_max=scenario.a_max,
        plan_radius=autopilot.plan_radius * growth,
        check_radius=autopilot.check_radius * growth,
        control_period_us=CONTROL_PERIOD_US,
        tracker_slowdown=scenario.platform.tracker_slowdown,
        map_latency=1e-6 * stage_latency(scenario.platform, Stage.PERCEPTION),
        plan_latency=1e-6 * stage_latency(scenario.platform, Stage.PLANNING),
        velocity_lag=1.0 / scenario.vehicle.velocity_gain,
        noise=noise_of(scenario.localization),
        rewindable=rewindable,
        functions=functions,
        kernels=scenario.kernels,
    )


def noise_of(config: LocalizationConfig) -> Noise | None:
    """Noise parameters of the estimator: the sensors' noise, bounded below by the resolution of its 4 ms steps."""
    if config.kind == "truth":
        return None
    scale = max(config.imu_noise, 1.0)
    return Noise(
        scale * imu.ACCELEROMETER_RANDOM_WALK,
        scale * imu.GYRO_RANDOM_WALK,
        scale * imu.ACCELEROMETER_BIAS_WALK,
        scale * imu.GYRO_BIAS_WALK,
        max(config.position_noise, _LEAST_POSITION_NOISE),
        max(config.heading_noise, _LEAST_HEADING_NOISE),
    )


# ---- assembly of a flight -------------------------------------------------------------------------------------------
MakeKernels = Callable[[PipelineConfig], dict[str, Kernel]]


def new_loop(
    scenario: Scenario,
    *,
    profile: bool = False,
    functions: KernelFunctions = PLAIN,
    rewindable: bool = False,
    make_plant: MakePlant = Simulator,
    make_kernels: MakeKernels = build_pipeline,
) -> Loop:
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
    world = scenario_world(scenario)
    plant = make_plant(world, scenario)
    config = pipeline_config(scenario, world, plant.ray_directions, rewindable=rewindable, functions=functions)
    if world.is_voxels:
        _warn_of_walls(scenario.environment.name, world, config.plan_radius + _VOXELS_OFF * config.map.resolution)
    loop = Loop(scenario, world, plant, partial(make_kernels, config), marks=rewindable)
    if profile:
        loop.profiler = Profiler(states_with(scenario.localization.kind).values())
        loop.taps.recorders.append(loop.profiler)
    if isinstance(functions, FlightFunctions):
        loop.stand_ins = functions.stand_ins
    return loop


def _warn_of_walls(name: str, world: World, distance: float) -> None:
    """Warn of a start or goal that is closer to a wall of a scan than a path keeps from it."""
    for key, point in (("start", world.start), ("goal", world.goal)):
        clearance = float(world.clearance(point)[0])
        if clearance < distance:
            place = ", ".join(f"{value:g}" for value in point)
            _warn_once(
                f"environment {name!r}: {key} ({place}): {clearance:.2f} m from a wall; less than {distance:.2f} m "
                "(the planner's distance and a voxel of the map) often ends in a collision"
            )


@cache
def _warn_once(text: str) -> None:
    """Warn, once in a process: a mission is flown several times."""
    warnings.warn(text, stacklevel=1)


def watch(loop: Loop, detector: Detector | None, recovery: RecoveryPolicy = INLINE) -> None:
    """Attach a detector to a flight that has not started; None = no effect.

    Raises:
        BadInputError: The detector lists a state that does not exist.
    """
    if detector is None:
        return
    check_states(detector)
    loop.marks = True
    install(loop, detector, recovery).begin()


def install(
    loop: Loop, detector: Detector, recovery: RecoveryPolicy, earlier: Iterable[tuple[State, int]] = ()
) -> DetectorTap:
    """Install a detector's tap, and what it asks of the loop; `earlier`: publications so far, see `Restarts`."""
    if recovery.restarts:
        tap = DetectorTap(loop, detector, recovery, Restarts(loop, "readback", earlier).die)
    else:
        tap = DetectorTap(loop, detector, recovery)
    loop.taps.detector = tap
    loop.taps.watched = tap.states
    loop.taps.checked_at_producer = CHECKED_AT_PRODUCER[recovery.detector_place]
    if tap.seals:
        loop.taps.seal = tap.seal
    if recovery.resends:
        loop.taps.answer_loss = tap.lost
    if detector.duplicates:
        loop.verify = Duplicates(loop, detector.duplicates)
    return tap


# ---- the detector of a mission --------------------------------------------------------------------------------------
_ERROR_STEP = 0.6
"""Largest change of the tracker's position error between two control periods (m)."""


def detector_for(
    scenario: Scenario,
    name: str,
    profile: str,
    models_dir: Path | None = None,
    trained_for: str = "",
    options: Mapping[str, Any] | None = None,
) -> Loaded:
    """Load a detector for a mission.

    Args:
        scenario: The mission.
        name: Entry point of the group mavfi.detectors, or "package:Class".
        profile: "paper" or "tuned".
        models_dir: Folder of trained models; None = the shipped models.
        trained_for: "autopilot/platform" whose model is used though it was not trained for this mission; "" = the
            mission's own, which must fit.
        options: Options of the detector, over those of its file and profile.

    Raises:
        BadInputError: The detector, profile or model does not exist.
        SpecMismatchError: The model was trained for a different configuration.
    """
    world = scenario_world(scenario)
    mission = {
        "stack": scenario.autopilot.name,
        "platform": scenario.platform.name,
        "v_max": scenario.v_max,
        "planner": scenario.planner.name,
        "limits": limits_of(scenario, world),
        "seed": scenario.seed,
    }
    return load_detector(name, profile, models_dir, mission, options=options, trained_for=trained_for)


def prepare(
    mission: MissionSpec,
    detector: Detector | str | None,
    profile: str = "paper",
    models: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> ArmSetup:
    """Resolve a mission, and load the detector that watches it: all that its flights need.

    Args:
        mission: The mission.
        detector: The detector or its name; None = no detector.
        profile: Profile of a named detector.
        models: Folder of trained models; None = the shipped ones.
        options: Options of a named detector.

    Raises:
        BadInputError: See `resolve` and `detector_for`.
        SpecMismatchError: The model was trained for a different configuration.
    """
    if detector is None:
        return ArmSetup(resolve(mission), recovery=RecoveryPolicy.of(mission))
    mission = with_keys_of(mission, detector)
    scenario = resolve(mission)
    recovery = RecoveryPolicy.of(mission)
    if not isinstance(detector, str):
        _warn_of_blind_spots(detector, scenario)
        return ArmSetup(scenario, lambda: detector, recovery, label=type(detector).__name__)
    loaded, model = detector_for(scenario, detector, profile, models, mission.trained_for, options)
    _warn_of_blind_spots(loaded, scenario)
    label = detector
    if model:
        label += f" ({profile})"
    if model and mission.trained_for:
        label += f", trained for {mission.trained_for}"
    return ArmSetup(scenario, lambda: loaded, recovery, label=label, model=model)


def _warn_of_blind_spots(detector: Detector, scenario: Scenario) -> None:
    """Warn of states that a detector lists and this mission never has: "no alarm" would say nothing of them."""
    text = ""
    if isinstance(detector, Detector):  # what is none is refused later
        check_states(detector)
        text = blind_spots(detector, scenario.localization.kind)
    if text:
        _warn_once(text)


def with_keys_of(spec: MissionSpec, detector: str | Detector) -> MissionSpec:
    """The mission with the detector's recommended keys, apart from those that the user has set.

    Raises:
        BadInputError: A value of these is not allowed.
    """
    recommended = mission_keys(detector)
    chosen = {key: getattr(spec, key) for key in spec.model_fields_set}
    name = detector if isinstance(detector, str) else type(detector).__name__
    return parse(MissionSpec, {**recommended, **chosen}, f"detector {name!r}: recovery")


def limits_of(scenario: Scenario, world: World) -> MissionLimits:
    """Limits of a mission's publications, as rule-based detectors check them."""
    autopilot = scenario.autopilot
    platform = scenario.platform
    period = 1e-6 * CONTROL_PERIOD_US
    slowest = 1.0 + scenario.latency_jitter  # latency / nominal latency, at most; its inverse at least
    # without an estimator there are no fixes to check
    noise = noise_of(scenario.localization)
    fix_noise = None
    if noise is not None:
        fix_noise = (noise.position, noise.heading)
    # The command changes with the error by p, with its integral by i and with its rate by d; the rate may change sign.
    p = max(map(abs, autopilot.gain_p))
    i = max(map(abs, autopilot.gain_i))
    d = max(map(abs, autopilot.gain_d))
    command_step = _ERROR_STEP * (p + i * period + 2.0 * d / period)
    return MissionLimits(
        v_max=scenario.v_max,
        a_max=scenario.a_max,
        arena=(_corner(world.arena_lower), _corner(world.arena_upper)),
        flight=(_corner(world.flight_lower), _corner(world.flight_upper)),
        goal=_corner(world.goal),
        held=autopilot.sampling == "held",
        every_map=autopilot.replanning == "every_map",
        point_period=autopilot.point_period,
        control_period=period,
        look_ahead=autopilot.look_ahead,
        planner_latency=1e-6 * latency(platform, "planner") / slowest,
        plan_latency=1e-6 * stage_latency(platform, Stage.PLANNING) * slowest,
        velocity_lag=1.0 / scenario.vehicle.velocity_gain,
        command_limit=autopilot.command_limit,
        command_step=command_step,
        slowdown_cap=autopilot.slowdown_cap,
        tracker_slowdown=platform.tracker_slowdown,
        camera_range=scenario.camera.range,
        repeated=autopilot.alarm == "repeated",
        fix_noise=fix_noise,
    )


def _corner(values: np.ndarray) -> tuple[float, ...]:
    return tuple(map(float, values))
