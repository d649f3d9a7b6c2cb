"""Draw docs/images/{airsim,mavlink,firmware}.png: flights of other people's programs and firmware, with faults.

Run as `make pictures`. Without a client of AirSim, pymavlink or Betaflight its picture remains unchanged.
"""

from collections.abc import Callable
from unittest.mock import patch

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from mavfi.bridges.airsim import program
from mavfi.bridges.airsim.boundary import Boundary, BoundaryFault, parse_fault
from mavfi.bridges.airsim.config import ProgramConfig
from mavfi.bridges.airsim.vehicle import ApiVehicle
from mavfi.bridges.firmware.flight import fly, register_fault
from mavfi.errors import BadInputError
from mavfi.hosts.loop.compose import resolve
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.reports import style
from mavfi.reports.picture import draw_flight
from tools import drawing
from tools.markers import IMAGES, ROOT

GOLDEN = {"color": style.BLUE, "linewidth": 1.6, "label": "golden run"}
FAULT = {"color": style.ORANGE, "linewidth": 2.4, "linestyle": (0, (4, 1.5)), "label": "with the fault"}
PROGRAM, BIT = "examples/airsim/box.py", "moveToPosition.x:bit=51"
REGISTER_MISSION = MissionSpec(environment="sparse", seed=10_002, flight_controller="betaflight")
REGISTER_TIME_US, REGISTER_SEED = 10_778_872, 10_012
"""A run of the campaign `firmware` that loses control."""
MOTOR, TAKEOFF_S, FAILURE_S, END_S = 101, 1.0, 8.0, 12.0
MOTOR_FAILURES = (
    (None, "no failure", {"color": style.INK, "linewidth": 1.2, "linestyle": ":"}),
    (1, "off", {"color": style.ORANGE, "linewidth": 2.4}),
    (4, "wrong (60 % of the thrust)", {"color": style.BLUE, "linewidth": 1.8, "linestyle": (0, (5, 1.5))}),
    (7, "intermittent", {"color": style.GREEN, "linewidth": 1.8, "linestyle": "-."}),
)
"""MAVLink's FAILURE_TYPE of motor 1, its name, and its look."""


class Tracked(ApiVehicle):
    """A vehicle that keeps its track: time (s), and position in NED (m)."""

    tracks: list[list[tuple[float, ...]]] = []  # noqa: RUF012 - one per vehicle, the last one is that of the last run

    def step(self, until_us: int) -> None:
        """See `ApiVehicle.step`."""
        super().step(until_us)
        self.tracks[-1].append((1e-6 * self.now_us, *self.position))


def airsim() -> None:
    """A client program's flight, from above and over time."""
    script = ProgramConfig(script=str(ROOT / PROGRAM))
    ends, tracks, bit_flip = [], [], parse_fault(BIT)
    assert isinstance(bit_flip, BoundaryFault)
    with patch.object(program, "ApiVehicle", Tracked):
        for boundary in (Boundary(), Boundary(bit_flip)):
            Tracked.tracks.append([])
            ends.append(program.run_program(script, MissionSpec(environment="sparse", seed=7), boundary))
            tracks.append(np.array(Tracked.tracks[-1]))
    effect, fault = program.effect_on(*ends), ends[1].boundary.injection
    assert fault is not None and effect == "deviates"
    figure, (above, over) = plt.subplots(1, 2, figsize=(9.6, 3.9), layout="constrained", width_ratios=(1.0, 1.35))
    for track, look in zip(tracks, (GOLDEN, FAULT), strict=True):
        above.plot(track[:, 2], track[:, 1], **look)
        over.plot(track[:, 0], track[:, 1], **look)
    above.plot(0, 0, "o", color=style.INK, markersize=7, label="start and landing")
    above.set(xlabel="y, east (m)", ylabel="x, north (m)", title="From above")
    above.set_aspect("equal")
    over.axvline(fault.time_s, color=style.GREY, linewidth=0.9)
    over.annotate(
        f"x: {fault.before} → {fault.after}", (fault.time_s, 11.0), (-5, 0), textcoords="offset points", ha="right"
    )
    over.set(xlabel="time (s)", ylabel="x, north (m)", title="Bit 51 of one argument of one call")
    figure.suptitle(f"{PROGRAM} in sparse, seed 7: {BIT.replace(':', ', ').replace('=', ' ')} · {effect}",
                    x=0.01, ha="left", fontweight="bold")  # fmt: skip
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    drawing.save(figure, "airsim.png", IMAGES)


def mavlink() -> None:
    """Height and tilt of a vehicle in hover with failures of a motor."""
    figure, (height, tilt) = plt.subplots(1, 2, figsize=(9.6, 3.7), layout="constrained")
    for kind, name, look in MOTOR_FAILURES:
        times, heights, tilts = np.array(_hover(kind)).T
        height.plot(times, heights, label=name, **look)
        tilt.plot(times, tilts, **look)
    for axes in (height, tilt):
        axes.axvline(FAILURE_S, color=style.GREY, linewidth=0.9)
        axes.set(xlabel="time (s)", xlim=(0.0, END_S))
    height.annotate("failure", (FAILURE_S, 1.0), (-5, 0), textcoords="offset points", ha="right")
    height.set(ylabel="height (m)", title="Height")
    tilt.set(ylabel="angle to the vertical (°)", title="Tilt")
    figure.suptitle("MAV_CMD_INJECT_FAILURE of motor 1 in hover", x=0.01, ha="left", fontweight="bold")
    figure.legend(loc="outside lower center", ncols=4)
    drawing.save(figure, "mavlink.png", IMAGES)


def _hover(kind: int | None) -> list[tuple[float, float, float]]:
    """Time (s), height (m) and tilt (degrees) of a take-off and a hover with a failure of motor 1."""
    from pymavlink.dialects.v20 import common

    from mavfi.bridges.mavlink.autopilot import Autopilot
    from mavfi.bridges.mavlink.flying import MavVehicle

    class Nobody:
        def write(self, data: bytes) -> None:
            """Telemetry that nobody reads."""

    vehicle = MavVehicle(MissionSpec(environment="farm", seed=7))
    autopilot = Autopilot(vehicle, common.MAVLink(Nobody(), srcSystem=1, srcComponent=1))
    sender, parser = common.MAVLink(None, srcSystem=245), common.MAVLink(None)
    commands = [(0.0, 400, (1.0, 0.0, 0.0)), (TAKEOFF_S, 22, (0.0, 0.0, 0.0))]
    if kind is not None:
        commands.append((FAILURE_S, 420, (MOTOR, kind, 1.0)))
    track = []
    for tick in range(round(END_S / 0.02)):
        for at, number, given in commands:
            if tick == round(at / 0.02):
                message = common.MAVLink_command_long_message(1, 1, number, 0, *given, 0, 0, 0, 0)
                for parsed in parser.parse_buffer(message.pack(sender)):
                    autopilot.handle(parsed)
        autopilot.step(vehicle.now_us + 20_000)
        _, x, y, _ = vehicle.sim.odometry[6:10]
        up = np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)
        track.append((1e-6 * vehicle.now_us, vehicle.sim.height, float(np.degrees(np.arccos(up)))))
    vehicle.sim.close()
    return track


def firmware() -> None:
    """A mission of Betaflight, golden and with a register fault that loses control."""
    scenario = resolve(REGISTER_MISSION)
    flight = fly(scenario, register_fault(REGISTER_TIME_US, REGISTER_SEED))
    if flight.log.status is MissionStatus.SUCCESS or flight.log.kernel is not None:
        raise ValueError("this build of the firmware has no loss of control there: choose another run of the campaign")
    path = IMAGES / "firmware.png"
    draw_flight(path, flight, fly(scenario))
    with Image.open(path) as image:
        drawing.compress(image, path)


def main() -> None:
    """Draw all three."""
    pictures: tuple[Callable[[], None], ...] = (airsim, mavlink, firmware)
    for draw in pictures:
        with style.house_style():
            try:
                draw()
            except (BadInputError, ImportError) as error:
                print(f"docs/images/{draw.__name__}.png is left as it is: {error}")


if __name__ == "__main__":
    main()
