"""A MAVLink autopilot with PX4's modes: answers messages, flies tasks, sends telemetry; its owner advances the time."""

import math
from collections.abc import Callable
from enum import Enum
from typing import Any

import numpy as np

from mavfi.bridges.airsim.attitude import Vertical, at_attitude, at_rates
from mavfi.bridges.airsim.frames import Triple
from mavfi.bridges.airsim.tasks import land
from mavfi.bridges.airsim.vehicle import Task
from mavfi.bridges.mavlink import telemetry
from mavfi.bridges.mavlink.failures import TYPES, UNITS, Failure
from mavfi.bridges.mavlink.flying import MavVehicle, Setpoint, climb, go_to, hold, offboard, orbit, return_to_launch
from mavfi.bridges.mavlink.mission import Mission
from mavfi.bridges.mavlink.parameters import Parameters
from mavfi.flight_logs.ned import euler, local

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
"""MAV_RESULT; 1 = temporarily rejected."""
INFO, ERROR = 6, 3
PROOF_US = 1_000_000
"""Time within which a failure must change a value (us)."""
LONGEST_TEXT = 50
_FORCE = 21_196
_BODY_FRAMES = (8, 9, 12)
_INT_SCALE = 1e-7


class Mode(Enum):
    """PX4's custom modes: main mode and sub-mode."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    READY = (4, 1)
    TAKEOFF = (4, 2)
    HOLD = (4, 3)
    MISSION = (4, 4)
    RETURN = (4, 5)
    LAND = (4, 6)
    ORBIT = (3, 1)
    OFFBOARD = (6, 0)


class Autopilot:
    """One vehicle with the system id 1.

    Args:
        vehicle: The vehicle.
        link: Packs messages: pymavlink's `MAVLink`, which writes to a file-like object.
    """

    def __init__(self, vehicle: MavVehicle, link: Any) -> None:
        self.vehicle, self._link = vehicle, link
        self.mode = Mode.HOLD
        self.parameters = Parameters()
        self.mission = Mission(self)
        self.speed = 5.0
        self._setpoint: Setpoint | None = None
        self._setpoint_us = 0
        self._task = 0
        self._schedule = telemetry.Schedule()
        self._pending: list[tuple[Failure, Callable[[int], None]]] = []
        self._start(hold(vehicle))

    # ---- state ------------------------------------------------------------------------------------------------------
    @property
    def ms(self) -> int:
        """Time since start (ms)."""
        return self.vehicle.now_us // 1000

    @property
    def failures(self) -> list[Failure]:
        """Active failures."""
        failing = self.vehicle.failing
        return [] if failing is None else failing.failures

    def place(self, ned: Triple | None = None) -> np.ndarray:
        """Position of the vehicle, or the given one (NED, m). Shape (3,)."""
        return np.array(self.vehicle.position if ned is None else ned)

    # ---- time -------------------------------------------------------------------------------------------------------
    def step(self, until_us: int) -> None:
        """Let time pass up to an instant (us), a multiple of 20 ms, and send what is due."""
        while self.vehicle.now_us < until_us:
            self.vehicle.step(min(until_us, self.vehicle.now_us + 20_000))
            self._end_tasks()
            self._prove_failures()
            for message in self._schedule.due(self.vehicle.now_us):
                self.send(message.__name__, *message(self))

    def _end_tasks(self) -> None:
        """Change the mode when its task has ended by itself."""
        ended, self.vehicle.ended = list(self.vehicle.ended), []
        for task in ended:
            if task.number != self._task:
                continue
            if isinstance(task.result, Exception):
                self.text(f"{self.mode.name.lower()} failed: {task.result}", ERROR)
            if self.mode in (Mode.LAND, Mode.RETURN):
                self.vehicle.sim.arm(False)
                self.text("Disarmed by landing")
            self.set_mode(Mode.HOLD)

    def _start(self, task: Task) -> None:
        self._task = self.vehicle.start(task)
        self.vehicle.ended = [task for task in self.vehicle.ended if task.number == self._task]

    def set_mode(self, mode: Mode) -> None:
        """Change the mode and start its task."""
        self.mode = mode
        self._schedule.hurry("heartbeat")
        vehicle = self.vehicle
        tasks: dict[Mode, Callable[[], Task]] = {
            Mode.TAKEOFF: lambda: climb(vehicle, self.parameters["MIS_TAKEOFF_ALT"]),
            Mode.LAND: lambda: land(vehicle, 1e5), Mode.RETURN: lambda: return_to_launch(vehicle, self.speed),
            Mode.MISSION: self.mission.fly, Mode.OFFBOARD: lambda: offboard(vehicle, self._latest),
        }  # fmt: skip
        self._start(tasks.get(mode, lambda: hold(vehicle))())

    def _latest(self) -> tuple[Setpoint | None, int]:
        return self._setpoint, self._setpoint_us

    # ---- output -----------------------------------------------------------------------------------------------------
    def send(self, name: str, *arguments: Any) -> None:
        """Send a message, by its name in small letters."""
        getattr(self._link, f"{name}_send")(*arguments)

    def text(self, text: str, severity: int = INFO) -> None:
        """Send a STATUSTEXT; longer texts are cut off."""
        self.send("statustext", severity, text.encode("ascii", "replace")[:LONGEST_TEXT])

    # ---- input ------------------------------------------------------------------------------------------------------
    def handle(self, message: Any) -> None:
        """Answer a message."""
        kind = message.get_type()
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(message)
        elif kind == "SET_MODE":
            self._set_custom_mode(message.custom_mode >> 16 & 255, message.custom_mode >> 24)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._setpoint, self._setpoint_us = position_target(message), self.vehicle.now_us
        elif kind == "SET_ATTITUDE_TARGET":
            self._setpoint, self._setpoint_us = self._attitude_target(message), self.vehicle.now_us
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.send("timesync", 1000 * self.vehicle.now_us, message.ts1)
        elif kind.startswith("PARAM_"):
            self.parameters.answer(message, self.send)
        elif kind.startswith("MISSION_"):
            self.mission.answer(message)

    def _attitude_target(self, message: Any) -> Setpoint:
        vertical = Vertical(throttle=float(message.thrust))
        roll, pitch, yaw = euler(message.q)
        if message.type_mask & 0x80:  # attitude is ignored: body rates
            rates = message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate
            return Setpoint(rotors=at_rates(self.vehicle, *rates, vertical))
        return Setpoint(rotors=at_attitude(self.vehicle, roll, pitch, yaw, None, vertical))

    # ---- commands ---------------------------------------------------------------------------------------------------
    def _command(self, message: Any) -> None:
        asked = message.get_srcSystem(), message.get_srcComponent()

        def acknowledge(result: int) -> None:
            self.send("command_ack", message.command, result, 0, 0, *asked)

        handler = _COMMANDS.get(message.command)
        result = UNSUPPORTED if handler is None else handler(self, message, acknowledge)
        if result is not None:
            acknowledge(result)

    def arm(self, message: Any, _: Callable[[int], None]) -> int:
        """MAV_CMD_COMPONENT_ARM_DISARM; disarming in flight needs the magic number of PX4."""
        on = message.param1 > 0.5
        if not on and not self.vehicle.landed and round(message.param2) != _FORCE:
            return DENIED
        if on != self.vehicle.sim.armed:
            self.vehicle.sim.arm(on)
            self.text("Armed" if on else "Disarmed")
            if self.mode not in (Mode.OFFBOARD, Mode.MISSION):
                self.set_mode(Mode.HOLD)
        self._schedule.hurry("heartbeat")
        return ACCEPTED

    def take_off(self, message: Any, _: Callable[[int], None]) -> int:
        """MAV_CMD_NAV_TAKEOFF; needs motors."""
        if not self.vehicle.sim.armed:
            return REJECTED
        self.set_mode(Mode.TAKEOFF)
        self.text("Takeoff detected")
        return ACCEPTED

    def into(self, mode: Mode, words: str) -> int:
        """Change the mode on command."""
        self.set_mode(mode)
        self.text(words)
        return ACCEPTED

    def _set_custom_mode(self, main: int, sub: int) -> int:
        found = next((mode for mode in Mode if mode.value == (main, sub)), None)
        if found is None:
            return DENIED
        self.set_mode(found)
        return ACCEPTED

    def do_set_mode(self, message: Any, _: Callable[[int], None]) -> int:
        """MAV_CMD_DO_SET_MODE."""
        return self._set_custom_mode(int(message.param2), int(message.param3))

    def change_speed(self, message: Any, _: Callable[[int], None]) -> int:
        """MAV_CMD_DO_CHANGE_SPEED."""
        if message.param2 > 0:
            self.speed = float(message.param2)
        return ACCEPTED

    def reposition(self, message: Any, _: Callable[[int], None]) -> int:
        """MAV_CMD_DO_REPOSITION."""
        yaw = None if math.isnan(message.param4) else message.param4
        self.mode = Mode.HOLD
        self._start(self._go_and_hold(target_of(message), yaw))
        return ACCEPTED

    def _go_and_hold(self, place: Triple, yaw: float | None) -> Task:
        yield from go_to(self.vehicle, place, self.speed, yaw)
        yield from hold(self.vehicle)

    def do_orbit(self, message: Any, _: Callable[[int], None]) -> int:
        """MAV_CMD_DO_ORBIT; negative radius = counter-clockwise."""
        radius, speed = float(message.param1), float(message.param2)
        if not (math.isfinite(radius) and abs(radius) >= 1.0):
            return DENIED
        self.set_mode(Mode.ORBIT)
        speed = speed if math.isfinite(speed) and speed != 0 else self.speed
        place = target_of(message)
        here = self.vehicle.position
        centre = tuple(b if math.isnan(a) else a for a, b in zip(place, here, strict=True))
        self._start(orbit(self.vehicle, (centre[0], centre[1], centre[2]), abs(radius), abs(speed), radius > 0))
        return ACCEPTED

    def request_message(self, message: Any, _: Callable[[int], None]) -> int:
        """MAV_CMD_REQUEST_MESSAGE and older forms: AUTOPILOT_VERSION, or any message of the telemetry by its id."""
        wanted = int(message.param1) if message.command == 512 else 148
        if wanted != 148:
            return self._repeat(wanted)
        can = 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x40 | 0x80 | 0x2000  # MAV_PROTOCOL_CAPABILITY
        self.send("autopilot_version", can, 0x010E0000, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 42)
        return ACCEPTED

    def _repeat(self, wanted: int) -> int:
        from pymavlink.dialects.v20 import common

        known = common.mavlink_map.get(wanted)
        name = "" if known is None else known.msgname.lower()
        if name not in {message.__name__ for _, message in telemetry.STREAMS}:
            return DENIED
        self._schedule.hurry(name)
        return ACCEPTED

    # ---- failures ---------------------------------------------------------------------------------------------------
    def inject_failure(self, message: Any, acknowledge: Callable[[int], None]) -> int | None:
        """MAV_CMD_INJECT_FAILURE: acknowledged once a value has changed; failed if none has within a second."""
        unit, kind = UNITS.get(int(message.param1)), TYPES.get(int(message.param2))
        instance = int(message.param3) if math.isfinite(message.param3) else 0
        if unit is None or kind is None or not 0 <= instance <= (4 if unit == "motor" else 0):
            return UNSUPPORTED
        if kind == "ok":
            failing = self.vehicle.failing
            return ACCEPTED if failing is not None and failing.clear(unit, instance) else FAILED
        if not self.vehicle.sim.armed:
            return REJECTED
        failure = Failure(unit, kind, instance, self.vehicle.now_us)
        self.vehicle.fail(failure)
        self._pending.append((failure, acknowledge))
        return None

    def _prove_failures(self) -> None:
        """Acknowledge failures that were activated, or were not in time."""
        for failure, acknowledge in list(self._pending):
            if failure.activated_us is not None:
                self.text(f"fault: {failure.site}: {failure.before:.4g} -> {failure.after:.4g}", ERROR)
                acknowledge(ACCEPTED)
            elif self.vehicle.now_us - failure.since_us >= PROOF_US:
                failing = self.vehicle.failing
                if failing is not None:
                    failing.clear(failure.unit, failure.instance)
                acknowledge(FAILED)
            else:
                continue
            self._pending.remove((failure, acknowledge))


def target_of(message: Any) -> Triple:
    """The place (NED, m) of a command in degrees and metres above sea level, or above home for relative frames."""
    if message.get_type() == "COMMAND_INT":
        latitude, longitude, altitude = message.x * _INT_SCALE, message.y * _INT_SCALE, message.z
    else:
        latitude, longitude, altitude = message.param5, message.param6, message.param7
    return local(latitude, longitude, altitude)


def position_target(message: Any) -> Setpoint:
    """The set-point of a SET_POSITION_TARGET_LOCAL_NED."""
    mask = message.type_mask

    def unless(bit: int, value: float) -> float | None:
        return None if mask & bit or not math.isfinite(value) else float(value)

    return Setpoint(
        (unless(1, message.x), unless(2, message.y), unless(4, message.z)),
        (unless(8, message.vx), unless(16, message.vy), unless(32, message.vz)),
        unless(1024, message.yaw), unless(2048, message.yaw_rate), message.coordinate_frame in _BODY_FRAMES,
    )  # fmt: skip


_COMMANDS: dict[int, Callable[[Autopilot, Any, Callable[[int], None]], int | None]] = {
    400: Autopilot.arm, 22: Autopilot.take_off, 176: Autopilot.do_set_mode, 178: Autopilot.change_speed,
    192: Autopilot.reposition, 34: Autopilot.do_orbit, 420: Autopilot.inject_failure,
    512: Autopilot.request_message, 519: Autopilot.request_message, 520: Autopilot.request_message,
    21: lambda autopilot, *_: autopilot.into(Mode.LAND, "Landing"),
    20: lambda autopilot, *_: autopilot.into(Mode.RETURN, "Returning to launch"),
    300: lambda autopilot, *_: autopilot.into(Mode.MISSION, "Mission started"),
    511: lambda *_: ACCEPTED,  # message intervals: all rates are fixed, and high enough
}  # fmt: skip
"""By MAV_CMD."""
