"""`mavfi mavlink`: our vehicle as a MAVLink autopilot."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
from mavfi.cli.console import check_number, console, write_json
from mavfi.cli.panels import OUTPUT
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, not_known
from mavfi.mission import OF_THE_PIPELINE, MissionSpec

if TYPE_CHECKING:
    from mavfi.extras.mavlink.server import MavlinkServer
    from mavfi.extras.mavlink.tlog import Telemetry

HELP_PANEL = "Other programs"
_MAX_DURATION_S = 7 * 86_400.0
_MAX_PORT = 65_535


class GroundStationOption:
    """The option of `mavfi fly` that sends the running flight to a ground station; see `mavfi.observers`."""

    options = {
        "mavlink": Annotated[
            int | None,
            typer.Option(
                metavar="PORT",
                help="Send the flight to a ground station's UDP port on loopback, 14550.",
                rich_help_panel=OUTPUT,
            ),
        ]
    }

    @staticmethod
    def chosen(values: dict[str, Any]) -> bool:
        """Whether the option is set; raises `BadInputError` for a value that is not allowed."""
        check_number("--mavlink", values["mavlink"], 1, _MAX_PORT)
        return values["mavlink"] is not None

    @staticmethod
    def build(values: dict[str, Any]) -> tuple[Telemetry, str]:
        """The observer, and a line of text that says where the flight can be seen."""
        from mavfi.extras.mavlink.tlog import HOST, Telemetry

        port = values["mavlink"]
        return Telemetry(port), f"sending the flight to udp://{HOST}:{port}"


app = typer.Typer(no_args_is_help=True)


@app.callback()
def _mavlink() -> None:
    r"""Programs for MAVLink autopilots fly our vehicle.

    Failures are injected on command. Needs pip install 'mavfi\[mavlink]'.

    Example: [bold]mavfi mavlink serve --environment farm --seed 7[/bold]
    """


@app.command("serve")
@partial(options.with_mission_options, without=(*OF_THE_PIPELINE, "goal"))
def serve(
    mission: MissionSpec,
    port: Annotated[int, typer.Option(help="UDP port of the autopilot on 127.0.0.1; 0 = any free one.")] = 14580,
    speed: Annotated[float, typer.Option(help="Simulated time per wall time.")] = 1.0,
    dialect: Annotated[str, typer.Option(help="Autopilot: px4 or ardupilot.")] = "px4",
    seconds: options.Duration = None,
    as_json: options.AsJson = False,
) -> None:
    """Serve a vehicle with the modes of PX4 or ArduCopter to ground stations and programs, in wall time.

    Telemetry goes to the UDP ports 14540 and 14550 of this machine, and to every sender of a message.  Failures are
    injected by MAV_CMD_INJECT_FAILURE.  What a client sends and nothing executes or answers is printed once.

    Example: [bold]mavfi mavlink serve --environment farm --seed 7[/bold]
    """
    check_number("--port", port, 0, _MAX_PORT)
    check_number("--speed", speed, 0.1, 100.0)
    check_number("--seconds", seconds, 0.0, _MAX_DURATION_S)
    from mavfi.extras.mavlink.server import DIALECTS, MavlinkServer

    if dialect not in DIALECTS:
        raise BadInputError(f"--dialect: {not_known(dialect, DIALECTS)}")
    server = MavlinkServer(mission, port, speed=speed, dialect=dialect, tell=_tell)
    if not as_json:
        console().print(f"autopilot at udp://127.0.0.1:{server.port}, telemetry to 14540 and 14550", markup=False)
    if seconds is None:
        seconds = _MAX_DURATION_S
    with stoppable("Stopped."):
        try:
            server.run(seconds)
        finally:
            _show(server, as_json)
            server.close()


def _tell(what: str) -> None:
    """Print what a client sends in vain."""
    console(error=True).print(f"not supported: {what}", markup=False, soft_wrap=True)


def _show(server: MavlinkServer, as_json: bool) -> None:
    """Print the final state."""
    vehicle = server.vehicle
    autopilot = server.autopilot
    state = {
        "time_s": 1e-6 * vehicle.now_us,
        "mode": autopilot.mode_name,
        "landed": vehicle.landed,
        "armed": vehicle.sim.armed,
        "collided": vehicle.has_collided,
        "messages": server.received,
        "not_supported": autopilot.not_supported,
        "position": [round(value, 3) for value in vehicle.position],
        "digest": vehicle.digest(),
    }
    if as_json:
        write_json(state)
        return

    # the same as a sentence
    north, east, down = vehicle.position
    whereabouts = "in the air"
    if vehicle.landed:
        whereabouts = "on the ground"
    motors = "disarmed"
    if vehicle.sim.armed:
        motors = "armed"
    collision = "without"
    if vehicle.has_collided:
        collision = "after a"
    console().print(
        f"{state['time_s']:.1f} s simulated, {server.received} messages received: the vehicle is {whereabouts}, "
        f"{north:z.1f} m north, {east:z.1f} m east and {-down:z.1f} m above its start, in mode {state['mode']}, "
        f"{motors}, {collision} collision; "
        f"digest {vehicle.digest()[:16]}",
        markup=False,
        soft_wrap=True,
    )
