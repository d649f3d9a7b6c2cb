"""`mavfi airsim`: programs for AirSim fly our vehicle, with faults in their calls."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
from mavfi.cli.console import check_file, check_name, check_number, check_seed, console, counted, write_json
from mavfi.cli.panels import MISSION
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, MavfiError, writing
from mavfi.extras.airsim.config import IMAGE, VEHICLE, ProgramConfig, pixels
from mavfi.mission import OF_A_DETECTOR, MissionSpec

if TYPE_CHECKING:
    from rich.console import Console

    from mavfi.extras.airsim.boundary import ApiRecording, Boundary, BoundaryFault
    from mavfi.extras.airsim.host import ProgramResult
    from mavfi.extras.airsim.server import AirsimServer
    from mavfi.flight.mission_flights import LocalHost
    from mavfi.levels.sensor.fault import SensorFault

HELP_PANEL = "Other programs"
_CLOCKS = ("real", "steps")
_OF_THE_PIPELINE = (
    "autopilot",
    "planner",
    "trajectory",
    "waypoint",
    "pid",
    "platform",
    "map",
    "map_resolution",
    "camera_range",
    "arrival_radius",
    "time_limit_factor",
    "latency_jitter",
    "depth_noise",
    "localization",
    "dead_node",
    "alarm",
    "epoch_liveness",
    "protection",
    *OF_A_DETECTOR,
)
"""Mission keys without effect where another program flies the vehicle."""

Fault = Annotated[
    str | None,
    typer.Option(
        metavar="SPEC", help=r"CALL.PATH[:bit=B]\[@SECONDS], e.g. moveByVelocity.vx:bit=62@10; or sensor:gyro:off@9."
    ),
]
FaultSeed = Annotated[int | None, typer.Option(help="Draws the bit that the fault does not name; 0 by default.")]
Image = Annotated[str, typer.Option(metavar="WxH", help="Size of images.")]
VehicleName = Annotated[str, typer.Option(help="Name of the vehicle, unless --settings names vehicles.")]
Settings = Annotated[
    str, typer.Option(metavar="FILE.json", help="AirSim's settings.json: vehicles, cameras, wind; none by default.")
]
FaultVehicle = Annotated[
    str, typer.Option(metavar="NAME", help="Vehicle whose calls are changed and watched; the first one by default.")
]
Detector = Annotated[str, typer.Option(help="Watches the numbers in calls and their answers: gaussian or autoencoder.")]
Profile = Annotated[str, typer.Option(help="Profile of the detector: paper or tuned.")]
Save = Annotated[
    Path | None, typer.Option(metavar="FILE.jsonl", help="Write the numbers in calls and their answers, as they come.")
]
Port = Annotated[int, typer.Option(help="TCP port on 127.0.0.1; 0 = any free one.")]
Clock = Annotated[str, typer.Option(help="real (wall-clock time), or steps (time passes in calls only).")]
Seconds = Annotated[float, typer.Option(help="Simulated time after which the program is stopped.")]
Python = Annotated[
    str, typer.Option(metavar="PYTHON", help="Interpreter with an AirSim client; mavfi's own by default.")
]
Script = Annotated[Path, typer.Argument(metavar="SCRIPT", help="Client program of AirSim; [ARGS] are its own.")]


class WorldOption:
    """The option of `mavfi fly` for a server of AirSim's API as the world."""

    options = {
        "world": Annotated[
            str | None,
            typer.Option(
                metavar="ADDRESS",
                help="A server of AirSim's API as the world, airsim://127.0.0.1:41451.",
                rich_help_panel=MISSION,
            ),
        ]
    }

    @staticmethod
    def chosen(mission: MissionSpec, values: dict[str, Any]) -> tuple[None, LocalHost | None]:
        """See `mavfi.cli.fly.FLY_OPTIONS`; raises `BadInputError` for what does not go with a server."""
        world = values["world"]
        fault = values["fault"] or ""
        if world is None:
            return None, None
        from mavfi.extras.airsim.host import world_address
        from mavfi.extras.airsim.remote import Remote
        from mavfi.flight.mission_flights import LocalHost

        if fault.startswith("instruction:"):
            text = "faults in instructions fork the flight; allowed with --world: state:, memory:, sensor:"
            raise BadInputError(f"--fault: {fault}: {text}")
        default = MissionSpec.model_fields
        if mission.flight_controller != default["flight_controller"].default:
            text = "that of the server flies; allowed: without --world"
            raise BadInputError(f"--flight-controller: {mission.flight_controller}: {text}")
        if mission.depth_noise != default["depth_noise"].default:
            text = "the server's camera has its own noise; allowed: without --world"
            raise BadInputError(f"--depth-noise: {mission.depth_noise:g}: {text}")
        host, port = world_address(world)
        return None, LocalHost(lambda here, scenario: Remote(here, scenario, host, port))


app = typer.Typer(no_args_is_help=True)


@app.callback()
def _airsim() -> None:
    r"""Programs for AirSim fly our vehicle, with faulty calls.

    They are not modified. Needs pip install 'mavfi\[airsim]'.

    Example: [bold]mavfi airsim serve --environment sparse --seed 7 --speed 10[/bold]
    """


@app.command("serve")
@partial(options.with_mission_options, without=_OF_THE_PIPELINE)
def serve(  # noqa: PLR0913 - one parameter per option
    mission: MissionSpec,
    port: Port = 41451,
    clock: Clock = "real",
    speed: Annotated[float, typer.Option(help="Simulated seconds per wall-clock second, with --clock real.")] = 1.0,
    image: Annotated[
        str, typer.Option(metavar="WxH", help=f"Size of images; {IMAGE} by default, with --in-flight that of missions.")
    ] = "",
    vehicle_name: VehicleName = VEHICLE,
    settings: Settings = "",
    in_flight: Annotated[
        bool,
        typer.Option(
            "--in-flight",
            help="Start paused, hovering at the mission's start, with --clock steps, for mavfi fly --world.",
        ),
    ] = False,
    version: Annotated[
        int, typer.Option(help="Version of the API to report: 1 for AirSim 1.8.1, 4 for Cosys-AirSim 3.")
    ] = 1,
    single: Annotated[bool, typer.Option("--single", help="Send numbers as float32, as AirSim does.")] = False,
    once: Annotated[bool, typer.Option("--once", help="End when the last client leaves.")] = False,
    fault: Fault = None,
    fault_seed: FaultSeed = None,
    fault_vehicle: FaultVehicle = "",
    save: Save = None,
) -> None:
    """Serve AirSim's API on loopback, until Ctrl-C; then print time, collision, digest, fault, refused calls.

    Example: [bold]mavfi airsim serve --environment sparse --seed 7 --speed 10[/bold]
    """
    check_name("--clock", clock, _CLOCKS)
    check_number("--speed", speed, 0.01, 1000.0)
    check_number("--port", port, 0, 65535)
    check_number("--version", version, 1, 100)
    steps = in_flight or clock == "steps"
    if speed != 1.0 and steps:
        raise BadInputError(f"--speed: {speed:g}: allowed: with --clock real, without --in-flight")
    check_file("--save", save, (".jsonl",))
    from mavfi.extras.airsim.boundary import Boundary
    from mavfi.extras.airsim.server import msgpack
    from mavfi.report.progress import compiling

    msgpack()
    planned = _fault_of(fault, fault_seed)
    if settings and in_flight:
        raise BadInputError("--settings: allowed: without --in-flight, which is the mission's own vehicle")
    _note_unused(settings, image or IMAGE)
    with compiling():
        from mavfi.extras.airsim.host import check_fault_vehicle, make_api
        from mavfi.extras.airsim.server import AirsimServer, RealClock, StepClock

        api = make_api(mission, image, vehicle_name, version, on_ground=not in_flight, settings=settings)
    with _recording(save) as recording:
        boundary = Boundary.of(planned, recording=recording)
        boundary.vehicle = fault_vehicle
        check_fault_vehicle(api.scene, fault_vehicle)
        time: StepClock | RealClock = RealClock(speed)
        if steps:
            time = StepClock()
        _serve(AirsimServer(api, time, boundary, single=single), port, once)


def _note_unused(settings: str, image: str) -> None:
    """Say on stderr which keys of the settings have no effect here."""
    if not settings:
        return
    from mavfi.extras.airsim.settings import FIELD_OF_VIEW, CaptureSize, read_settings

    unused = read_settings(Path(settings), CaptureSize(*pixels(image), FIELD_OF_VIEW)).unused
    if unused:
        typer.echo(f"mavfi: {settings}: without effect here: {', '.join(unused)}", err=True)


def _check_detector(detector: str, profile: str) -> None:
    """Refuse detectors that do not learn from the numbers of any program."""
    from mavfi.detectors.preprocess import PROFILES
    from mavfi.detectors.registry import of_monitored_fields

    check_name("--detector", detector, ("none", *of_monitored_fields()))
    check_name("--profile", profile, PROFILES)


@contextmanager
def _recording(path: Path | None) -> Iterator[ApiRecording | None]:
    """A recording that writes to a file; None without one."""
    from mavfi.extras.airsim.boundary import ApiRecording

    if path is None:
        yield None
        return
    with writing(path):
        file = path.open("w", encoding="utf-8", buffering=1)  # line by line: none is lost
    with file:
        yield ApiRecording(file=file)


def _serve(server: AirsimServer, port: int, once: bool) -> None:
    """Serve until Ctrl-C or, if `once`, until the last client leaves; then print a summary."""
    import asyncio

    out = console()
    spec = server.api.vehicle.spec
    names = ", ".join(server.api.scene.vehicles)
    ports = list[int]()

    def ready(at: int) -> None:
        ports.append(at)
        out.print(f"AirSim API on 127.0.0.1:{at}: {names} in {spec.environment}, seed {spec.seed}", markup=False)

    with stoppable("Stopped."):
        try:
            asyncio.run(server.run(port, ready, once=once))
        finally:
            server.api.scene.close()
            if ports:
                _summarize(server)


def _summarize(server: AirsimServer) -> None:
    """Print what the clients did: time, collision, digest, fault, refused calls."""
    out = console()
    scene = server.api.scene
    collision = "no collision"
    if scene.has_ever_collided:
        collision = "collision"
    out.print(f"{1e-6 * scene.now_us:.3f} s simulated, {collision}, digest {scene.digest()[:16]}", markup=False)
    if server.boundary.faulty:
        out.print(_line(server.boundary), markup=False)
    for text, count in server.errors.items():
        out.print(f"refused {count} x: {text}", markup=False)


def _fault_of(fault: str | None, seed: int | None) -> BoundaryFault | SensorFault | None:
    """Read the fault; None without one."""
    if seed is not None:
        check_seed("--fault-seed", seed)
        if fault is None:
            raise BadInputError(f"--fault-seed: {seed}: no fault to draw; allowed: together with --fault")
    if fault is None:
        return None
    from mavfi.extras.airsim.boundary import parse_fault

    return parse_fault(fault, seed or 0)


@app.command("run", context_settings={"allow_interspersed_args": False})
@partial(options.with_mission_options, without=_OF_THE_PIPELINE)
def run(  # noqa: PLR0913 - one parameter per option
    mission: MissionSpec,
    context: typer.Context,
    script: Script,
    arguments: Annotated[list[str] | None, typer.Argument(metavar="[ARGS]", help="Of the program.")] = None,
    python: Python = "",
    seconds: Seconds = 120.0,
    image: Image = IMAGE,
    vehicle_name: VehicleName = VEHICLE,
    settings: Settings = "",
    fault: Fault = None,
    fault_seed: FaultSeed = None,
    fault_vehicle: FaultVehicle = "",
    detector: Detector = "none",
    profile: Profile = "paper",
    as_json: options.AsJson = False,
) -> None:
    """Run a client program in simulated time, unmodified; with a fault, first without it.

    Options come before the script: what follows it is the program's own.

    Example: [bold]mavfi airsim run --fault moveToPosition.x:bit=54@0 examples/airsim/box.py[/bold]
    """
    # refuse what cannot run, before anything is compiled
    check_number("--seconds", seconds, 0.1, 1e5)
    _hint_at_order(context, arguments or ())
    _check_detector(detector, profile)
    pixels(image)
    planned = _fault_of(fault, fault_seed)
    program = ProgramConfig(
        script=str(script),
        arguments=tuple(arguments or ()),
        python=python,
        seconds=seconds,
        image=image,
        vehicle=vehicle_name,
        settings=settings,
        fault_vehicle=fault_vehicle,
    )
    program.check()
    _note_unused(settings, image)
    from mavfi.extras.airsim.server import msgpack
    from mavfi.report.progress import compiling

    msgpack()

    with compiling():
        from mavfi.extras.airsim.boundary import ApiRecording, Boundary
        from mavfi.extras.airsim.host import ProgramInput, run_program

        # the error-free run, on which a detector is trained
        standard_input = ProgramInput(_input_source())
        recording = None
        if detector != "none":
            recording = ApiRecording()
        golden = run_program(program, mission, Boundary(recording=recording), standard_input)
        watch = None
        if recording is not None and golden.is_sound:
            watch = recording.train(detector, profile)

        # the run that is injected or watched, unless the program does not work without a fault
        injected = None
        if golden.is_sound and (planned is not None or watch is not None):
            injected = run_program(program, mission, Boundary.of(planned, watch=watch), standard_input)
    _report(program, golden, injected, as_json)
    _require_sound(program, golden)


def _input_source() -> int | None:
    """Where the program's standard input comes from; None = nowhere, as nobody is asked for keys at a terminal."""
    try:
        if sys.stdin.isatty():
            return None
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):  # there is none
        return None


def _require_sound(program: ProgramConfig, golden: ProgramResult) -> None:
    """Fail for a program that does not work without a fault.

    Raises:
        BadInputError: Calls were refused.
        MavfiError: It crashed, or hangs.
    """
    if golden.errors:
        refusals = "; ".join(golden.errors)
        raise BadInputError(f"{program.script}: {counted(sum(golden.errors.values()), 'call')} refused: {refusals}")
    if not golden.is_sound:
        raise MavfiError(f"{program.script}: {golden.how} without a fault: {golden.reason}")


def _hint_at_order(context: typer.Context, arguments: Sequence[str]) -> None:
    """Say on stderr which arguments of the program are named like options of this command."""
    option_names = {name for parameter in context.command.params for name in parameter.opts}
    named = [argument for argument in arguments if argument.startswith("--") and argument.split("=")[0] in option_names]
    if named:
        text = f"mavfi: {', '.join(named)}: passed to the program; options of mavfi come before the script"
        typer.echo(text, err=True)


def _report(program: ProgramConfig, golden: ProgramResult, injected: ProgramResult | None, as_json: bool) -> None:
    """Print how a program ended, the effect of a fault first."""
    from mavfi.extras.airsim.host import effect_on, shown

    effect = None
    if injected is not None and injected.boundary.faulty:
        effect = effect_on(golden, injected)
    if as_json:
        injected_data = None
        if injected is not None:
            injected_data = shown(injected)
        write_json({"script": program.script, "golden": shown(golden), "injected": injected_data, "effect": effect})
        return

    # the effect of a fault, then each run; the program's output at the end
    out = console()
    if injected is None:
        _print_run(out, "golden", golden)
    elif effect is None:
        _print_run(out, "golden", golden)
        _print_run(out, "watched", injected)
        _print_alarms(out, injected.boundary)
    else:
        out.print(f"effect: {effect}", markup=False)
        out.print(_line(injected.boundary), markup=False)
        _print_run(out, "golden", golden)
        _print_run(out, "injected", injected)
        _print_alarms(out, injected.boundary)
    if injected is not None and injected.output != golden.output:
        out.print("output of the golden run:", markup=False)
        _print_output(out, golden)
        out.print("output of the other run:", markup=False)
    _print_output(out, injected or golden)


def _print_output(out: Console, run: ProgramResult) -> None:
    """Print all that a program wrote to stdout, then to stderr."""
    for mark, text in (("|", run.output), ("!", run.error_output)):
        for line in text.splitlines():
            out.print(f"  {mark} {line}", style="dim", markup=False, emoji=False, soft_wrap=True)


def _print_run(out: Console, label: str, run: ProgramResult) -> None:
    """Print how a run ended, and the calls that were refused."""
    collision = ""
    if run.collided:
        collision = ", collision"
    reason = ""
    if run.reason:
        reason = f" ({run.reason})"
    calls = sum(run.calls.values())
    text = f"{run.how}{collision}{reason}, {run.seconds:.3f} s simulated, {calls} calls, digest {run.digest[:16]}"
    out.print(f"{label}: {text}", markup=False, soft_wrap=True)
    for error, count in run.errors.items():
        out.print(f"  refused {count} x: {error}", markup=False, soft_wrap=True)


def _print_alarms(out: Console, boundary: Boundary) -> None:
    """Print the number of alarms and the first one, if a detector observed."""
    if boundary.watch is not None:
        alarms = boundary.watch.alarms
        first = ""
        if alarms:
            first = f", first at {alarms[0].time_s:.3f} s: {', '.join(alarms[0].fields)}"
        out.print(f"alarms: {len(alarms)}{first}", markup=False)


def _line(boundary: Boundary) -> str:
    """The injection in one line, or that there was none."""
    injection = boundary.injected
    if injection is None:
        if boundary.failure is None:
            reason = "no such number passed the boundary"
        else:
            reason = "nothing changed for its readers"
        return f"fault: not activated: {reason}"
    if boundary.failure is not None:
        return f"{injection.time_s:8.3f} s  fault: {injection.site}: {injection.before} → {injection.after}"
    operation = injection.details.get("operation")
    if operation is not None:
        calls = f"{operation} in {injection.details['calls']} calls, from number {injection.details['number']} on"
        if injection.before is None:
            return f"{injection.time_s:8.3f} s  fault in {injection.site}: {calls}"
        return f"{injection.time_s:8.3f} s  fault in {injection.site}: {calls}: {injection.before} → {injection.after}"
    where = f"{injection.details['call']}.{injection.details['path']}"
    return f"{injection.time_s:8.3f} s  fault in {where} bit {injection.bit}: {injection.before} → {injection.after}"
