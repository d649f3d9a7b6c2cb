"""A MAVLink autopilot with PX4's modes: answers messages, flies tasks, sends telemetry; its owner advances time."""

import math
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator
from enum import Enum, IntEnum, IntFlag
from typing import Any

from mavfi.errors import BadInputError
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
from mavfi.extras.mavlink.tlog import chunks_of, mavlink_dialect
from mavfi.faults.levels.sensor.failures import Failure
from mavfi.faults.levels.sensor.fault import NULL, SensorFault
from mavfi.flight.piloted import TICK_US, Task, Vertical, at_attitude, at_rates, land
from mavfi.numerics.frames import HOME, Triple, euler, geodetic, local


class MavResult(IntEnum):
    """MAV_RESULT, also MAV_MISSION_RESULT of the first member: answers to a command."""

    ACCEPTED = 0
    REJECTED = 1  # temporarily, e.g. while the motors are off
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class MavCommand(IntEnum):
    """MAV_CMD: commands, and items of a mission."""

    WAYPOINT = 16
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    DO_ORBIT = 34
    DO_SET_MODE = 176
    CHANGE_SPEED = 178
    REPOSITION = 192
    MISSION_START = 300
    ARM_DISARM = 400
    INJECT_FAILURE = 420
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_PROTOCOL_VERSION = 519
    REQUEST_CAPABILITIES = 520


# MAV_SEVERITY
INFO = 6
ERROR = 3
UNITS = {0: "gyro", 1: "accelerometer", 2: "compass", 4: "position", 101: "motor"}
"""Units of `SensorFault` by FAILURE_UNIT, which has no depth camera."""
TYPES = dict(enumerate(("ok", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")))
"""Its types by FAILURE_TYPE, which has no drift."""
PROOF_US = 1_000_000
"""Time within which a failure must change a value (us)."""
_AUTOPILOT_VERSION = 148
"""Id of the message AUTOPILOT_VERSION."""
_FORCE = 21_196
"""Second parameter of a command that disarms in flight."""
_BODY_FRAMES = (8, 9, 12)
"""MAV_FRAME: velocities along the heading."""


class FlightMode(Enum):
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


# ---- parameters ------------------------------------------------------------------------------------------------------
_INT32 = 6
_REAL32 = 9
_DEFAULTS: dict[str, float | int] = {
    "COM_RC_IN_MODE": 4,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_XY_CRUISE": 5.0,
    "NAV_DLL_ACT": 0,
    "SYS_AUTOSTART": 4001,
    "SYS_FAILURE_EN": 1,
    "SYS_HITL": 0,
}


class Parameters:
    """Values by name, those of PX4 that client programs ask for."""

    def __init__(self) -> None:
        self._values = dict(_DEFAULTS)

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def answer(self, message: Any, send: Callable[..., None]) -> None:
        """Answer PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; unknown names are ignored."""
        kind = message.get_type()
        if kind == "PARAM_SET" and message.param_id in self._values:
            self._set(message.param_id, message.param_value)
        for name in self._requested(message):
            self._send(name, send)

    def _requested(self, message: Any) -> list[str]:
        """Names of the parameters whose values answer a message."""
        names = list(self._values)
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return names
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            return names[message.param_index : message.param_index + 1]
        if kind in ("PARAM_REQUEST_READ", "PARAM_SET") and message.param_id in self._values:
            return [message.param_id]
        return []

    def _set(self, name: str, value: float) -> None:
        if isinstance(self._values[name], int):
            self._values[name] = _integer_bits(value)
        else:
            self._values[name] = float(value)

    def _send(self, name: str, send: Callable[..., None]) -> None:
        names = list(self._values)
        value = self._values[name]
        if isinstance(value, int):
            send("param_value", name.encode(), _float_bits(value), _INT32, len(names), names.index(name))
        else:
            send("param_value", name.encode(), value, _REAL32, len(names), names.index(name))


def _integer_bits(value: float) -> int:
    """The integer that PARAM_VALUE and PARAM_SET carry in the bits of a float."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def _float_bits(value: int) -> float:
    """Inverse of `_integer_bits`."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


# ---- missions --------------------------------------------------------------------------------------------------------
_RELATIVE_FRAMES = (3, 6)
"""MAV_FRAME: global, relative to home."""
_SCALE = 1e-7  # degrees
_MISSING = 2**31 - 1  # a coordinate that is left out
_MISSION = 0
_ALL_TYPES = 255
"""MAV_MISSION_TYPE."""


def place_of(item: Any) -> Triple:
    """Place (NED, m) of a MISSION_ITEM_INT or COMMAND_INT; NaN where a coordinate is left out."""
    origin = 0.0
    if item.frame in _RELATIVE_FRAMES:
        origin = HOME[2]
    return local(_degrees(item.x), _degrees(item.y), item.z + origin)


def _degrees(coordinate: int) -> float:
    """Latitude or longitude of an item (1e-7 deg) in degrees; NaN if it is left out."""
    if coordinate == _MISSING:
        return math.nan
    return coordinate * _SCALE


class Mission:
    """Items by MAV_MISSION_TYPE; those of a mission are flown, those of fences and rally points are only stored."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._items: defaultdict[int, list[Any]] = defaultdict(list)
        self._expected = 0
        self._current = 0

    def answer(self, message: Any) -> None:
        """Answer a message of the protocol."""
        send = self._autopilot.send
        sender = (message.get_srcSystem(), message.get_srcComponent())
        kind = message.get_type()
        which = getattr(message, "mission_type", _MISSION)
        items = self._items[which]

        # upload: the number of items, then each item, which is asked for
        if kind == "MISSION_COUNT":
            items.clear()
            self._expected = message.count
            self._next(which, sender)
        elif kind == "MISSION_ITEM_INT":
            if message.seq == len(items):  # not one that was sent twice
                items.append(message)
            self._next(which, sender)

        # download
        elif kind == "MISSION_REQUEST_LIST":
            send("mission_count", *sender, len(items), which)
        elif kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and message.seq < len(items):
            item = items[message.seq]
            parameters = item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z
            send(
                "mission_item_int",
                *sender,
                item.seq,
                item.frame,
                item.command,
                0,
                item.autocontinue,
                *parameters,
                which,
            )

        # where to begin, and deletion
        elif kind == "MISSION_SET_CURRENT":
            self._current = message.seq
            send("mission_current", message.seq)
        elif kind == "MISSION_CLEAR_ALL":
            # in place: a mission that is being flown ends
            stored_lists = [items]
            if which == _ALL_TYPES:
                stored_lists = list(self._items.values())
            for stored in stored_lists:
                stored.clear()
            send("mission_ack", *sender, MavResult.ACCEPTED, which)

    def _next(self, which: int, sender: tuple[int, int]) -> None:
        """Ask for the next item, or acknowledge the last one."""
        count = len(self._items[which])
        if count < self._expected:
            self._autopilot.send("mission_request_int", *sender, count, which)
            return
        if which == _MISSION:
            self._current = 0
        self._autopilot.send("mission_ack", *sender, MavResult.ACCEPTED, which)

    def fly(self) -> Task:
        """Fly the items from the current one on, once the motors run."""
        autopilot = self._autopilot
        items = self._items[_MISSION]
        while self._current < len(items):
            while not autopilot.vehicle.sim.armed:
                yield
            autopilot.send("mission_current", self._current)
            yield from self._item(items[self._current])
            autopilot.send("mission_item_reached", self._current)
            self._current += 1
        autopilot.text("Mission finished")
        return True

    def _item(self, item: Any) -> Task:
        """Fly one item."""
        autopilot = self._autopilot
        vehicle = self._autopilot.vehicle
        command = item.command
        target = place_of(item)
        if command == MavCommand.TAKEOFF or (command == MavCommand.WAYPOINT and vehicle.landed):
            yield from climb(vehicle, -target[2])
        if command == MavCommand.WAYPOINT:
            yaw = None
            if not math.isnan(item.param4):
                yaw = math.radians(item.param4)
            yield from go_to(vehicle, target, autopilot.speed, yaw)
        elif command == MavCommand.CHANGE_SPEED and item.param2 > 0:
            autopilot.speed = float(item.param2)
        elif command == MavCommand.RETURN_TO_LAUNCH:
            yield from return_to_launch(vehicle, autopilot.speed)
            vehicle.sim.arm(False)
        elif command == MavCommand.LAND:
            if item.x or item.y:  # PX4: without coordinates it lands where it is
                yield from go_to(vehicle, (target[0], target[1], vehicle.position[2]), autopilot.speed)
            yield from land(vehicle, FOREVER_S)
            vehicle.sim.arm(False)


# ---- the autopilot ---------------------------------------------------------------------------------------------------
class Autopilot:
    """One vehicle with the system id 1.

    Args:
        vehicle: The vehicle.
        link: Packs messages: pymavlink's `MAVLink`, which writes to a file-like object.
    """

    def __init__(self, vehicle: MavVehicle, link: Any) -> None:
        self.vehicle = vehicle
        self._link = link
        self.mode = FlightMode.HOLD
        self.parameters = Parameters()
        self.mission = Mission(self)
        self.speed = 5.0
        self._setpoint: Setpoint | None = None
        self._setpoint_us = 0
        self._task = 0
        self._schedule = Schedule()
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
        ended = list(self.vehicle.ended_tasks)
        self.vehicle.ended_tasks = []
        for task in ended:
            if task.number != self._task:
                continue
            if isinstance(task.result, Exception):
                self.text(f"{self.mode.name.lower()} failed: {task.result}", ERROR)
            if self.mode in (FlightMode.LAND, FlightMode.RETURN):
                self.vehicle.sim.arm(False)
                self.text("Disarmed by landing")
            self.set_mode(FlightMode.HOLD)

    def _start(self, task: Task) -> None:
        self._task = self.vehicle.start(task)
        self.vehicle.ended_tasks = [task for task in self.vehicle.ended_tasks if task.number == self._task]

    def set_mode(self, mode: FlightMode) -> None:
        """Change the mode and start its task."""
        self.mode = mode
        self._schedule.request("heartbeat")
        vehicle = self.vehicle
        tasks: dict[FlightMode, Callable[[], Task]] = {
            FlightMode.TAKEOFF: lambda: climb(vehicle, self.parameters["MIS_TAKEOFF_ALT"]),
            FlightMode.LAND: lambda: land(vehicle, FOREVER_S),
            FlightMode.RETURN: lambda: return_to_launch(vehicle, self.speed),
            FlightMode.MISSION: self.mission.fly,
            FlightMode.OFFBOARD: lambda: offboard(vehicle, self._latest),
        }
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
        text_id = 0
        if len(parts) > 1:
            self._long_texts += 1
            text_id = self._long_texts % 65_535 + 1
        for index, part in enumerate(parts):
            self.send("statustext", severity, part, text_id, index)

    # ---- input ------------------------------------------------------------------------------------------------------
    def handle(self, message: Any) -> None:
        """Answer a message."""
        kind = message.get_type()
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(message)
        elif kind == "SET_MODE":
            self._set_custom_mode(message.custom_mode >> 16 & 255, message.custom_mode >> 24)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._setpoint = position_target(message)
            self._setpoint_us = self.vehicle.now_us
        elif kind == "SET_ATTITUDE_TARGET":
            self._setpoint = self._attitude_target(message)
            self._setpoint_us = self.vehicle.now_us
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
        if handler is None:
            self._acknowledge(message, MavResult.UNSUPPORTED)
            return
        result = handler(self, message)
        if result is not None:
            self._acknowledge(message, result)

    def _acknowledge(self, message: Any, result: int) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        self.send("command_ack", message.command, result, 0, 0, *source)

    def arm(self, message: Any) -> int:
        """MAV_CMD_COMPONENT_ARM_DISARM; disarming in flight needs the magic number of PX4."""
        arms = message.param1 > 0.5
        if not arms and not self.vehicle.landed and message.param2 != _FORCE:
            return MavResult.DENIED
        if arms != self.vehicle.sim.armed:
            self.vehicle.sim.arm(arms)
            if arms:
                self.text("Armed")
            else:
                self.text("Disarmed")
            if self.mode not in (FlightMode.OFFBOARD, FlightMode.MISSION):
                self.set_mode(FlightMode.HOLD)
        self._schedule.request("heartbeat")
        return MavResult.ACCEPTED

    def take_off(self, message: Any) -> int:
        """MAV_CMD_NAV_TAKEOFF; needs motors."""
        if not self.vehicle.sim.armed:
            return MavResult.REJECTED
        self.set_mode(FlightMode.TAKEOFF)
        self.text("Takeoff detected")
        return MavResult.ACCEPTED

    def change_mode(self, mode: FlightMode, text: str) -> int:
        """Change the mode on command."""
        self.set_mode(mode)
        self.text(text)
        return MavResult.ACCEPTED

    def _set_custom_mode(self, main: int, sub: int) -> int:
        for mode in FlightMode:
            if mode.value == (main, sub):
                self.set_mode(mode)
                return MavResult.ACCEPTED
        return MavResult.DENIED

    def do_set_mode(self, message: Any) -> int:
        """MAV_CMD_DO_SET_MODE."""
        return self._set_custom_mode(_integer(message.param2), _integer(message.param3))

    def change_speed(self, message: Any) -> int:
        """MAV_CMD_DO_CHANGE_SPEED."""
        if message.param2 > 0:
            self.speed = float(message.param2)
        return MavResult.ACCEPTED

    def reposition(self, message: Any) -> int:
        """MAV_CMD_DO_REPOSITION."""
        yaw = None
        if not math.isnan(message.param4):
            yaw = message.param4
        self.mode = FlightMode.HOLD
        self._start(self._go_and_hold(self._target(message), yaw))
        return MavResult.ACCEPTED

    def _go_and_hold(self, target: Triple, yaw: float | None) -> Task:
        yield from go_to(self.vehicle, target, self.speed, yaw)
        yield from hold(self.vehicle)

    def do_orbit(self, message: Any) -> int:
        """MAV_CMD_DO_ORBIT; negative radius = counter-clockwise."""
        radius = float(message.param1)
        speed = float(message.param2)
        if not (math.isfinite(radius) and abs(radius) >= 1.0):
            return MavResult.DENIED
        self.set_mode(FlightMode.ORBIT)
        if not math.isfinite(speed) or speed == 0:
            speed = self.speed
        self._start(orbit(self.vehicle, self._target(message), abs(radius), abs(speed), radius > 0))
        return MavResult.ACCEPTED

    def _target(self, message: Any) -> Triple:
        """Place (NED, m) of a command; coordinates that it leaves out are those of the vehicle."""
        if message.get_type() == "COMMAND_INT":
            target = place_of(message)
        else:
            target = local(message.param5, message.param6, message.param7)
        coordinates = []
        for coordinate, here in zip(target, self.vehicle.position, strict=True):
            if math.isfinite(coordinate):
                coordinates.append(coordinate)
            else:
                coordinates.append(here)
        return coordinates[0], coordinates[1], coordinates[2]

    def request_message(self, message: Any) -> int:
        """MAV_CMD_REQUEST_MESSAGE and older forms: AUTOPILOT_VERSION, or any message of the telemetry by its id."""
        if message.command == MavCommand.REQUEST_MESSAGE:
            message_id = _integer(message.param1)
            if message_id != _AUTOPILOT_VERSION:
                return self._repeat(message_id)
        can = 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x40 | 0x80 | 0x2000  # MAV_PROTOCOL_CAPABILITY
        self.send("autopilot_version", can, 0x010E0000, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 42)
        return MavResult.ACCEPTED

    def _repeat(self, message_id: int) -> int:
        """Send a message of the telemetry at once."""
        message_class = mavlink_dialect().mavlink_map.get(message_id)
        if message_class is None:
            return MavResult.DENIED
        name = message_class.msgname.lower()
        if name not in {message.__name__ for _, message in STREAMS}:
            return MavResult.DENIED
        self._schedule.request(name)
        return MavResult.ACCEPTED

    # ---- failures ---------------------------------------------------------------------------------------------------
    def inject_failure(self, message: Any) -> int | None:
        """MAV_CMD_INJECT_FAILURE: acknowledged once a value has changed; failed if none has within a second."""
        # what fails, and how; an instance of 0 = all
        unit = UNITS.get(_integer(message.param1))
        kind = TYPES.get(_integer(message.param2))
        instance = 0
        if not math.isnan(message.param3):
            instance = _integer(message.param3)
        if unit is None or kind is None:
            return MavResult.UNSUPPORTED
        try:
            fault = SensorFault(unit, kind, self.vehicle.now_us, instance=instance, seed=self.vehicle.spec.seed)
        except BadInputError:
            return MavResult.UNSUPPORTED

        # end a failure, or begin one
        if kind == NULL:
            if self.vehicle.failures.end(unit, instance):
                return MavResult.ACCEPTED
            return MavResult.FAILED
        if not self.vehicle.sim.armed:
            return MavResult.REJECTED
        for failure in self.failures:  # a repeated command would change nothing
            if (failure.fault.unit, failure.fault.kind, failure.fault.instance) == (unit, kind, instance):
                if failure.injection is None:
                    return None
                return MavResult.ACCEPTED
        self._pending.append((self.vehicle.failures.begin(fault), message))
        return None

    def _prove_failures(self) -> None:
        """Acknowledge failures that were activated, or were not in time."""
        for failure, message in list(self._pending):
            if failure.injection is not None:
                before = failure.injection.before
                after = failure.injection.after
                self.text(f"fault: {failure.fault.site}: {before:.4g} -> {after:.4g}", ERROR)
                self._acknowledge(message, MavResult.ACCEPTED)
            elif self.vehicle.now_us - failure.fault.time_us >= PROOF_US:
                if failure in self.failures:
                    self.vehicle.failures.remove(failure)
                self._acknowledge(message, MavResult.FAILED)
            else:
                continue
            self._pending.remove((failure, message))


def _integer(value: float) -> int:
    """A whole number in a floating-point parameter; -1 for NaN, which means "not given", and infinities."""
    if math.isfinite(value):
        return int(value)
    return -1


class Ignored(IntFlag):
    """Fields of a set-point that its sender leaves out (POSITION_TARGET_TYPEMASK)."""

    X = 1
    Y = 2
    Z = 4
    VX = 8
    VY = 16
    VZ = 32
    YAW = 1024
    YAW_RATE = 2048


def position_target(message: Any) -> Setpoint:
    """The set-point of a SET_POSITION_TARGET_LOCAL_NED."""

    def unless(ignored: Ignored, value: float) -> float | None:
        if message.type_mask & ignored or not math.isfinite(value):
            return None
        return float(value)

    return Setpoint(
        (unless(Ignored.X, message.x), unless(Ignored.Y, message.y), unless(Ignored.Z, message.z)),
        (unless(Ignored.VX, message.vx), unless(Ignored.VY, message.vy), unless(Ignored.VZ, message.vz)),
        unless(Ignored.YAW, message.yaw),
        unless(Ignored.YAW_RATE, message.yaw_rate),
        message.coordinate_frame in _BODY_FRAMES,
    )


def accept_interval(autopilot: Autopilot, message: Any) -> MavResult:
    """SET_MESSAGE_INTERVAL: all rates are fixed, and high enough."""
    del autopilot, message
    return MavResult.ACCEPTED


_COMMANDS: dict[int, Callable[[Autopilot, Any], int | None]] = {
    MavCommand.ARM_DISARM: Autopilot.arm,
    MavCommand.TAKEOFF: Autopilot.take_off,
    MavCommand.DO_SET_MODE: Autopilot.do_set_mode,
    MavCommand.CHANGE_SPEED: Autopilot.change_speed,
    MavCommand.REPOSITION: Autopilot.reposition,
    MavCommand.DO_ORBIT: Autopilot.do_orbit,
    MavCommand.INJECT_FAILURE: Autopilot.inject_failure,
    MavCommand.REQUEST_MESSAGE: Autopilot.request_message,
    MavCommand.REQUEST_PROTOCOL_VERSION: Autopilot.request_message,
    MavCommand.REQUEST_CAPABILITIES: Autopilot.request_message,
    MavCommand.LAND: lambda autopilot, _: autopilot.change_mode(FlightMode.LAND, "Landing"),
    MavCommand.RETURN_TO_LAUNCH: lambda autopilot, _: autopilot.change_mode(FlightMode.RETURN, "Returning to launch"),
    MavCommand.MISSION_START: lambda autopilot, _: autopilot.change_mode(FlightMode.MISSION, "Mission started"),
    MavCommand.SET_MESSAGE_INTERVAL: accept_interval,
}
"""What answers each command."""


# ---- messages that it sends periodically -----------------------------------------------------------------------------
Arguments = tuple[Any, ...]
_QUADROTOR = 2
_PX4 = 12
_ACTIVE = 4
_STANDBY = 3
_MODE_FLAGS = 1 | 4 | 8 | 16
_DILUTION = 80  # of precision of the position, in 1/100
_SATELLITES = 12
_THROTTLE = 50  # %
_ALL_FIELDS = 0x1FFF  # of HIGHRES_IMU are updated
_ALL_ESTIMATES = 0x3FF  # of ESTIMATOR_STATUS are valid
_ARMED_FLAG = 128
"""MAV_MODE_FLAG: custom mode, auto, guided, stabilize; safety armed."""
_HEALTHY = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x4000 | 0x8000 | 0x10000 | 0x200000 | 0x10000000
"""MAV_SYS_STATUS_SENSOR: gyro, accelerometer, compass, pressure, GPS, controls, motors, receiver, AHRS, pre-arm."""
_SENSORS = {"gyro": 0x1, "accelerometer": 0x2, "compass": 0x4, "position": 0x20, "motor": 0x8000}
_ON_GROUND = 1
_IN_AIR = 2
_TAKING_OFF = 3
_LANDING = 4
_FIX_3D = 3
_NO_FIX = 1
_CENTIVOLTS = 16_000
_PERCENT = 90
_NAN = float("nan")


def _heading(autopilot: Autopilot) -> float:
    """Degrees clockwise from north, 0 to 360."""
    return math.degrees(autopilot.vehicle.yaw) % 360.0


def _above_sea(autopilot: Autopilot) -> float:
    """Altitude above sea level (m)."""
    return HOME[2] - autopilot.vehicle.position[2]


def _scaled(ned: Triple) -> tuple[int, int, int]:
    """Latitude and longitude (1e-7 degrees) and altitude (mm) of a position (m)."""
    latitude, longitude, altitude = geodetic(ned)
    return round(1e7 * latitude), round(1e7 * longitude), round(1e3 * altitude)


def heartbeat(autopilot: Autopilot) -> Arguments:
    """HEARTBEAT."""
    main, sub = autopilot.mode.value
    armed = autopilot.vehicle.sim.armed
    flags = _MODE_FLAGS
    if armed:
        flags |= _ARMED_FLAG
    state = _STANDBY
    if armed and not autopilot.vehicle.landed:
        state = _ACTIVE
    return _QUADROTOR, _PX4, flags, main << 16 | sub << 24, state


def sys_status(autopilot: Autopilot) -> Arguments:
    """SYS_STATUS; sensors that are off are unhealthy."""
    off = sum({_SENSORS[failure.fault.unit] for failure in autopilot.failures if failure.fault.kind == "off"})
    return _HEALTHY, _HEALTHY, _HEALTHY & ~off, 300, _CENTIVOLTS, -1, _PERCENT, 0, 0, 0, 0, 0, 0


def home_position(autopilot: Autopilot) -> Arguments:
    """HOME_POSITION."""
    level = [1.0, 0.0, 0.0, 0.0]
    return *_scaled((0.0, 0.0, 0.0)), 0.0, 0.0, 0.0, level, 0.0, 0.0, 0.0, autopilot.vehicle.now_us


def extended_sys_state(autopilot: Autopilot) -> Arguments:
    """EXTENDED_SYS_STATE."""
    if autopilot.vehicle.landed:
        landed_state = _ON_GROUND
    elif autopilot.mode is FlightMode.TAKEOFF:
        landed_state = _TAKING_OFF
    elif autopilot.mode is FlightMode.LAND:
        landed_state = _LANDING
    else:
        landed_state = _IN_AIR
    return 0, landed_state


def gps_raw_int(autopilot: Autopilot) -> Arguments:
    """GPS_RAW_INT; without a fix while the position is off."""
    fix = _FIX_3D
    if any(failure.fault.unit == "position" and failure.fault.kind == "off" for failure in autopilot.failures):
        fix = _NO_FIX
    north, east, _ = autopilot.vehicle.velocity
    speed = min(65_534, round(100 * math.hypot(north, east)))
    course = round(100 * _heading(autopilot)) % 36_000
    return (
        autopilot.vehicle.now_us,
        fix,
        *_scaled(autopilot.vehicle.position),
        _DILUTION,  # horizontal
        _DILUTION,  # vertical
        speed,
        course,
        _SATELLITES,
    )


def global_position_int(autopilot: Autopilot) -> Arguments:
    """GLOBAL_POSITION_INT."""
    speeds = (max(-32_768, min(32_767, round(100 * value))) for value in autopilot.vehicle.velocity)
    above = round(-1e3 * autopilot.vehicle.position[2])
    return autopilot.ms, *_scaled(autopilot.vehicle.position), above, *speeds, round(100 * _heading(autopilot)) % 36_000


def vfr_hud(autopilot: Autopilot) -> Arguments:
    """VFR_HUD."""
    north, east, down = autopilot.vehicle.velocity
    speed = math.hypot(north, east)
    return speed, speed, round(_heading(autopilot)) % 360, _THROTTLE, _above_sea(autopilot), -down


def altitude(autopilot: Autopilot) -> Arguments:
    """ALTITUDE."""
    above = _above_sea(autopilot)
    height = -autopilot.vehicle.position[2]
    return autopilot.vehicle.now_us, above, above, height, height, _NAN, 0.0


def attitude(autopilot: Autopilot) -> Arguments:
    """ATTITUDE."""
    return autopilot.ms, *euler(autopilot.vehicle.orientation), *autopilot.vehicle.rates


def attitude_quaternion(autopilot: Autopilot) -> Arguments:
    """ATTITUDE_QUATERNION."""
    return autopilot.ms, *autopilot.vehicle.orientation, *autopilot.vehicle.rates


def local_position_ned(autopilot: Autopilot) -> Arguments:
    """LOCAL_POSITION_NED."""
    return autopilot.ms, *autopilot.vehicle.position, *autopilot.vehicle.velocity


def highres_imu(autopilot: Autopilot) -> Arguments:
    """HIGHRES_IMU; constant magnetic field and pressure."""
    x, y, z, roll, pitch, yaw = map(float, autopilot.vehicle.imu())
    field = (0.2, 0.0, 0.4)
    air = (1013.25, 0.0, _above_sea(autopilot), 25.0)
    return autopilot.vehicle.now_us, x, -y, -z, roll, -pitch, -yaw, *field, *air, _ALL_FIELDS


def battery_status(autopilot: Autopilot) -> Arguments:
    """BATTERY_STATUS, constant."""
    del autopilot
    return 0, 0, 0, 2500, [_CENTIVOLTS, *[65_535] * 9], -1, -1, -1, _PERCENT


def estimator_status(autopilot: Autopilot) -> Arguments:
    """ESTIMATOR_STATUS: all estimates are valid."""
    return autopilot.vehicle.now_us, _ALL_ESTIMATES, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.2, 0.2


def system_time(autopilot: Autopilot) -> Arguments:
    """SYSTEM_TIME."""
    return autopilot.vehicle.stamp // 1000, autopilot.ms


STREAMS: tuple[tuple[float, Callable[[Autopilot], Arguments]], ...] = (
    (1.0, heartbeat),
    (1.0, sys_status),
    (1.0, home_position),
    (1.0, battery_status),
    (1.0, estimator_status),
    (1.0, system_time),
    (5.0, extended_sys_state),
    (5.0, gps_raw_int),
    (10.0, global_position_int),
    (10.0, vfr_hud),
    (10.0, altitude),
    (50.0, attitude),
    (50.0, attitude_quaternion),
    (50.0, local_position_ned),
    (50.0, highres_imu),
)
"""Rate (Hz) and content of each message, which has the name of its function."""


class Schedule:
    """Instants at which messages are due."""

    def __init__(self) -> None:
        self._due: dict[str, int] = {}

    def request(self, name: str) -> None:
        """Make a message due at once."""
        self._due[name] = 0

    def due(self, now_us: int) -> Iterator[Callable[[Autopilot], Arguments]]:
        """Messages to send now."""
        for rate, message in STREAMS:
            if now_us >= self._due.get(message.__name__, 0):
                self._due[message.__name__] = now_us + round(1e6 / rate)
                yield message
