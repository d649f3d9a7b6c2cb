"""A MAVLink autopilot with PX4's modes: answers messages, flies tasks, sends telemetry; its owner advances time."""

import math
from collections.abc import Callable
from enum import Enum
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.airsim.attitude import Vertical, at_attitude, at_rates
from mavfi.extras.airsim.tasks import land
from mavfi.extras.airsim.vehicle import TICK_US, Task
from mavfi.extras.logs.tlog import mavlink_dialect
from mavfi.extras.mavlink import telemetry
from mavfi.extras.mavlink.flying import (
    FOREVER_S,
    MavVehicle,
    Setpoint,
    climb,
    go_to,
    hold,
    offboard,
    orbit,
    return_to_launch,
)
from mavfi.extras.mavlink.mission import Mission, place_of
from mavfi.extras.mavlink.parameters import Parameters
from mavfi.faults.levels.sensor.failures import Failure
from mavfi.faults.levels.sensor.fault import NULL, SensorFault
from mavfi.numerics.frames import Triple, euler, local
from mavfi.report.export.lines import chunks_of

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
"""MAV_RESULT; 1 = temporarily rejected."""
INFO, ERROR = 6, 3
UNITS = {0: "gyro", 1: "accelerometer", 2: "compass", 4: "position", 101: "motor"}
"""Units of `SensorFault` by FAILURE_UNIT, which has no depth camera."""
TYPES = dict(enumerate(("ok", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")))
"""Its types by FAILURE_TYPE, which has no drift."""
PROOF_US = 1_000_000
"""Time within which a failure must change a value (us)."""
_FORCE = 21_196
_BODY_FRAMES = (8, 9, 12)


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
        self._pending: list[tuple[Failure, Any]] = []
        self._long_texts = 0
        self._start(hold(vehicle))

    # ---- state ------------------------------------------------------------------------------------------------------
    @property
    def ms(self) -> int:
        """Time since start (ms), 32 bits."""
        return self.vehicle.now_us // 1000 & 0xFFFFFFFF

    @property
    def failures(self) -> list[Failure]:
        """Active failures."""
        return self.vehicle.failures.active

    # ---- time -------------------------------------------------------------------------------------------------------
    def step(self, until_us: int) -> None:
        """Let time pass up to an instant (us), a multiple of 20 ms, and send what is due."""
        while self.vehicle.now_us < until_us:
            self.vehicle.step(min(until_us, self.vehicle.now_us + TICK_US))
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
        self._schedule.request("heartbeat")
        vehicle = self.vehicle
        tasks: dict[Mode, Callable[[], Task]] = {
            Mode.TAKEOFF: lambda: climb(vehicle, self.parameters["MIS_TAKEOFF_ALT"]),
            Mode.LAND: lambda: land(vehicle, FOREVER_S), Mode.RETURN: lambda: return_to_launch(vehicle, self.speed),
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
        """Send a STATUSTEXT, a longer text in chunks that share an id."""
        parts = chunks_of(text)
        self._long_texts += len(parts) > 1
        own = 0 if len(parts) == 1 else self._long_texts % 65_535 + 1
        for place, part in enumerate(parts):
            self.send("statustext", severity, part, own, place)

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
        handler = _COMMANDS.get(message.command)
        result = UNSUPPORTED if handler is None else handler(self, message)
        if result is not None:
            self._acknowledge(message, result)

    def _acknowledge(self, message: Any, result: int) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        self.send("command_ack", message.command, result, 0, 0, *source)

    def arm(self, message: Any) -> int:
        """MAV_CMD_COMPONENT_ARM_DISARM; disarming in flight needs the magic number of PX4."""
        on = message.param1 > 0.5
        if not on and not self.vehicle.landed and message.param2 != _FORCE:
            return DENIED
        if on != self.vehicle.sim.armed:
            self.vehicle.sim.arm(on)
            self.text("Armed" if on else "Disarmed")
            if self.mode not in (Mode.OFFBOARD, Mode.MISSION):
                self.set_mode(Mode.HOLD)
        self._schedule.request("heartbeat")
        return ACCEPTED

    def take_off(self, message: Any) -> int:
        """MAV_CMD_NAV_TAKEOFF; needs motors."""
        if not self.vehicle.sim.armed:
            return REJECTED
        self.set_mode(Mode.TAKEOFF)
        self.text("Takeoff detected")
        return ACCEPTED

    def change_mode(self, mode: Mode, text: str) -> int:
        """Change the mode on command."""
        self.set_mode(mode)
        self.text(text)
        return ACCEPTED

    def _set_custom_mode(self, main: int, sub: int) -> int:
        found = next((mode for mode in Mode if mode.value == (main, sub)), None)
        if found is None:
            return DENIED
        self.set_mode(found)
        return ACCEPTED

    def do_set_mode(self, message: Any) -> int:
        """MAV_CMD_DO_SET_MODE."""
        return self._set_custom_mode(_integer(message.param2), _integer(message.param3))

    def change_speed(self, message: Any) -> int:
        """MAV_CMD_DO_CHANGE_SPEED."""
        if message.param2 > 0:
            self.speed = float(message.param2)
        return ACCEPTED

    def reposition(self, message: Any) -> int:
        """MAV_CMD_DO_REPOSITION."""
        yaw = None if math.isnan(message.param4) else message.param4
        self.mode = Mode.HOLD
        self._start(self._go_and_hold(self._target(message), yaw))
        return ACCEPTED

    def _go_and_hold(self, place: Triple, yaw: float | None) -> Task:
        yield from go_to(self.vehicle, place, self.speed, yaw)
        yield from hold(self.vehicle)

    def do_orbit(self, message: Any) -> int:
        """MAV_CMD_DO_ORBIT; negative radius = counter-clockwise."""
        radius, speed = float(message.param1), float(message.param2)
        if not (math.isfinite(radius) and abs(radius) >= 1.0):
            return DENIED
        self.set_mode(Mode.ORBIT)
        speed = speed if math.isfinite(speed) and speed != 0 else self.speed
        self._start(orbit(self.vehicle, self._target(message), abs(radius), abs(speed), radius > 0))
        return ACCEPTED

    def _target(self, message: Any) -> Triple:
        """Place (NED, m) of a command; coordinates that it leaves out are those of the vehicle."""
        if message.get_type() == "COMMAND_INT":
            place = place_of(message)
        else:
            place = local(message.param5, message.param6, message.param7)
        x, y, z = (
            given if math.isfinite(given) else here for given, here in zip(place, self.vehicle.position, strict=True)
        )
        return x, y, z

    def request_message(self, message: Any) -> int:
        """MAV_CMD_REQUEST_MESSAGE and older forms: AUTOPILOT_VERSION, or any message of the telemetry by its id."""
        wanted = _integer(message.param1) if message.command == 512 else 148
        if wanted != 148:
            return self._repeat(wanted)
        can = 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x40 | 0x80 | 0x2000  # MAV_PROTOCOL_CAPABILITY
        self.send("autopilot_version", can, 0x010E0000, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 42)
        return ACCEPTED

    def _repeat(self, wanted: int) -> int:
        known = mavlink_dialect().mavlink_map.get(wanted)
        name = "" if known is None else known.msgname.lower()
        if name not in {message.__name__ for _, message in telemetry.STREAMS}:
            return DENIED
        self._schedule.request(name)
        return ACCEPTED

    # ---- failures ---------------------------------------------------------------------------------------------------
    def inject_failure(self, message: Any) -> int | None:
        """MAV_CMD_INJECT_FAILURE: acknowledged once a value has changed; failed if none has within a second."""
        unit, kind = UNITS.get(_integer(message.param1)), TYPES.get(_integer(message.param2))
        instance = 0 if math.isnan(message.param3) else _integer(message.param3)
        if unit is None or kind is None:
            return UNSUPPORTED
        try:
            fault = SensorFault(unit, kind, self.vehicle.now_us, instance=instance, seed=self.vehicle.spec.seed)
        except BadInputError:
            return UNSUPPORTED
        if kind == NULL:
            return ACCEPTED if self.vehicle.failures.end(unit, instance) else FAILED
        if not self.vehicle.sim.armed:
            return REJECTED
        for same in self.failures:  # a repeated command, which would change nothing
            if (same.fault.unit, same.fault.kind, same.fault.instance) == (unit, kind, instance):
                return None if same.injection is None else ACCEPTED
        self._pending.append((self.vehicle.failures.begin(fault), message))
        return None

    def _prove_failures(self) -> None:
        """Acknowledge failures that were activated, or were not in time."""
        for failure, message in list(self._pending):
            if failure.injection is not None:
                before, after = failure.injection.before, failure.injection.after
                self.text(f"fault: {failure.fault.site}: {before:.4g} -> {after:.4g}", ERROR)
                self._acknowledge(message, ACCEPTED)
            elif self.vehicle.now_us - failure.fault.time_us >= PROOF_US:
                if failure in self.failures:
                    self.vehicle.failures.remove(failure)
                self._acknowledge(message, FAILED)
            else:
                continue
            self._pending.remove((failure, message))


def _integer(value: float) -> int:
    """A whole number in a floating-point parameter; -1 for NaN, which means "not given", and infinities."""
    return int(value) if math.isfinite(value) else -1


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


_COMMANDS: dict[int, Callable[[Autopilot, Any], int | None]] = {
    400: Autopilot.arm, 22: Autopilot.take_off, 176: Autopilot.do_set_mode, 178: Autopilot.change_speed,
    192: Autopilot.reposition, 34: Autopilot.do_orbit, 420: Autopilot.inject_failure,
    512: Autopilot.request_message, 519: Autopilot.request_message, 520: Autopilot.request_message,
    21: lambda autopilot, _: autopilot.change_mode(Mode.LAND, "Landing"),
    20: lambda autopilot, _: autopilot.change_mode(Mode.RETURN, "Returning to launch"),
    300: lambda autopilot, _: autopilot.change_mode(Mode.MISSION, "Mission started"),
    511: lambda *_: ACCEPTED,  # message intervals: all rates are fixed, and high enough
}  # fmt: skip
"""By MAV_CMD."""
