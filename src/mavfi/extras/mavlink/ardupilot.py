"""ArduCopter's modes: how it arms, takes off, is guided and returns.

Source: ArduCopter's GCS_MAVLink_Copter.cpp, mode.cpp and mode_guided.cpp, and
https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from typing import Any, ClassVar

from mavfi.extras.mavlink.autopilot import COMMANDS, MESSAGES, Autopilot, CommandHandler, MessageHandler
from mavfi.extras.mavlink.failures import FIX_3D
from mavfi.extras.mavlink.flying import (
    FOREVER_S,
    Setpoint,
    climb,
    hold,
    offboard,
    orbit,
    pilot,
    pilot_attitude,
    return_to,
    yaw_of_condition,
)
from mavfi.extras.mavlink.parameters import ARDUCOPTER_DEFAULTS, Number
from mavfi.extras.mavlink.setpoints import attitude_target, completed
from mavfi.extras.mavlink.telemetry import ALL_GROUPS, ARDUPILOT_STREAMS, STREAM_GROUPS, Content
from mavfi.extras.mavlink.vocabulary import (
    GLOBAL_FRAMES,
    Command,
    CoordinateFrame,
    MavCommand,
    MavResult,
    MissionResult,
    Severity,
    UnsupportedError,
    whole,
)
from mavfi.flight.piloted import EndedTask, Task, Vertical, from_body, land
from mavfi.numerics.frames import Triple

_CUSTOM_MODE = 1
_STABILIZE_FLAG = 16
_MANUAL_INPUT = 64
_GUIDED_FLAG = 8
"""MAV_MODE_FLAG."""
_ARM = 1
_DISARM = 0
_COMMAND_INT_ONLY = 8
"""MAV_RESULT."""
_GUIDED_ITEM = 2
_HEIGHT_ITEM = 3
"""Field `current` of a MISSION_ITEM that is a target of mode GUIDED, or its height."""
_CHANGE_MODE = 1
"""Flag of MAV_CMD_DO_REPOSITION: change to GUIDED."""
_SET_MODE_MESSAGE = 11
"""Id of SET_MODE, as which ArduPilot acknowledges it."""
_CENTIMETRES = 0.01
_CENTRED = 1500
_HALF_RANGE = 500.0
_RELEASED = 0
_UNCHANGED = 65_535
"""Values of RC_CHANNELS_OVERRIDE."""
_OVERRIDE_CHANNELS = 8
_OVERRIDE_US = 3_000_000
"""Time after which overridden channels are released (us): RC_OVERRIDE_TIME."""
_THRUST_AS_THRUST = 8
"""Bit of GUID_OPTIONS: the thrust of SET_ATTITUDE_TARGET is a thrust, not a climb rate."""
_CLIMB_GAIN = 1.5
"""Climb rate (1/s) per error of height, by which `Vertical` reaches a height."""
_CONE_SLOPE = 3.0
"""RTL_CONE_SLOPE: height of a return per distance from home."""
_LEAST_RETURN = 2.0
"""Least height of a return (m)."""


class CopterMode(IntEnum):
    """ArduCopter's modes, those of which this vehicle flies."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    CIRCLE = 7
    LAND = 9
    POSHOLD = 16
    BRAKE = 17
    GUIDED_NOGPS = 20  # attitudes only


_ARMABLE = (
    CopterMode.STABILIZE,
    CopterMode.ALT_HOLD,
    CopterMode.GUIDED,
    CopterMode.LOITER,
    CopterMode.POSHOLD,
    CopterMode.GUIDED_NOGPS,
)
_PILOTED = (CopterMode.STABILIZE, CopterMode.ALT_HOLD, CopterMode.LOITER, CopterMode.POSHOLD)
_NEEDS_POSITION = (CopterMode.GUIDED, CopterMode.LOITER, CopterMode.POSHOLD)
_AUTONOMOUS = (CopterMode.AUTO, CopterMode.GUIDED, CopterMode.RTL, CopterMode.CIRCLE, CopterMode.LAND)


class ArduCopter(Autopilot):
    """One vehicle with ArduCopter's modes, at the place of ArduPilot's simulation."""

    kind: ClassVar[int] = 3
    origin: ClassVar[Triple] = (-35.363262, 149.165237, 584.0)
    defaults: ClassVar[dict[str, Number]] = ARDUCOPTER_DEFAULTS
    integers_bytewise: ClassVar[bool] = False
    streams: ClassVar[dict[Content, float]] = ARDUPILOT_STREAMS
    version: ClassVar[int] = 0x040500FF
    capabilities: ClassVar[int] = 0x1 | 0x2 | 0x4 | 0x8 | 0x40 | 0x80 | 0x100 | 0x800 | 0x2000 | 0x20000
    long_frame: ClassVar[CoordinateFrame] = CoordinateFrame.RELATIVE
    answers_all_components: ClassVar[bool] = True
    ignores_mission_yaw: ClassVar[bool] = True
    home_is_item: ClassVar[bool] = True
    set_mode_number: ClassVar[int] = _SET_MODE_MESSAGE

    def __init__(self, *arguments: Any) -> None:
        self.mode = CopterMode.STABILIZE
        self.is_taking_off_now = False
        self._target: Triple | None = None  # of mode GUIDED, while it flies to a place
        self._overrides = [_CENTRED] * _OVERRIDE_CHANNELS
        super().__init__(*arguments)

    # ---- state ------------------------------------------------------------------------------------------------------
    @property
    def mode_name(self) -> str:
        """See `Autopilot.mode_name`."""
        return self.mode.name.lower()

    @property
    def mode_flags(self) -> int:
        """See `Autopilot.mode_flags`."""
        flags = _CUSTOM_MODE | _STABILIZE_FLAG | _MANUAL_INPUT
        if self.mode in _AUTONOMOUS:
            flags |= _GUIDED_FLAG
        return flags

    @property
    def custom_mode(self) -> int:
        """See `Autopilot.custom_mode`."""
        return self.mode

    @property
    def is_taking_off(self) -> bool:
        """See `Autopilot.is_taking_off`."""
        return self.is_taking_off_now

    @property
    def is_landing(self) -> bool:
        """See `Autopilot.is_landing`."""
        return self.mode is CopterMode.LAND

    @property
    def is_in_mission_mode(self) -> bool:
        """See `Autopilot.is_in_mission_mode`."""
        return self.mode is CopterMode.AUTO

    @property
    def default_speed(self) -> float:
        """See `Autopilot.default_speed`."""
        return _CENTIMETRES * self.parameters["WPNAV_SPEED"]

    @property
    def channels(self) -> list[int]:
        """See `Autopilot.channels`."""
        return self._overrides

    @property
    def followed(self) -> tuple[str, ...]:
        """See `Autopilot.followed`."""
        if self.mode in (CopterMode.GUIDED, CopterMode.GUIDED_NOGPS):
            return ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
        if self.mode in _PILOTED:
            return ("MANUAL_CONTROL", "RC_CHANNELS_OVERRIDE")
        return ()

    def parameter_changed(self, name: str, value: Number) -> None:
        """See `Autopilot.parameter_changed`."""
        if name == "WPNAV_SPEED" and value > 0:
            self.speed = _CENTIMETRES * float(value)

    # ---- modes ------------------------------------------------------------------------------------------------------
    def set_mode(self, mode: CopterMode) -> None:
        """Change the mode and start its task."""
        self.mode = mode
        self.is_taking_off_now = False
        self._target = None
        self._setpoint = None
        self.schedule.request("heartbeat")
        vehicle = self.vehicle
        tilt = math.radians(_CENTIMETRES * self.parameters["ANGLE_MAX"])
        rise = _CENTIMETRES * self.parameters["PILOT_SPEED_UP"]
        sideways = _CENTIMETRES * self.parameters["LOIT_SPEED"]
        tasks: dict[CopterMode, Callable[[], Task]] = {
            CopterMode.STABILIZE: lambda: pilot_attitude(vehicle, lambda: self.sticks, tilt, rise, holds_height=False),
            CopterMode.ALT_HOLD: lambda: pilot_attitude(vehicle, lambda: self.sticks, tilt, rise, holds_height=True),
            CopterMode.LOITER: lambda: pilot(vehicle, lambda: self.sticks, sideways, rise),
            CopterMode.POSHOLD: lambda: pilot(vehicle, lambda: self.sticks, sideways, rise),
            CopterMode.AUTO: self.mission.fly,
            CopterMode.RTL: self.return_home,
            CopterMode.LAND: lambda: land(vehicle, FOREVER_S),
            CopterMode.CIRCLE: self._circle,
        }
        self._start(tasks.get(mode, lambda: hold(vehicle))())

    def set_custom_mode(self, custom_mode: int) -> int:
        """See `Autopilot.set_custom_mode`."""
        if custom_mode not in set(CopterMode):
            self.text(f"Mode change to {custom_mode} failed: not supported", Severity.WARNING)
            return MavResult.FAILED
        mode = CopterMode(custom_mode)
        if mode is CopterMode.AUTO and self.mission.is_empty:
            self.text("Mode change to AUTO failed: no mission", Severity.WARNING)
            return MavResult.FAILED
        if mode is not self.mode:
            self.set_mode(mode)
        return MavResult.ACCEPTED

    def task_ended(self, task: EndedTask) -> None:
        """See `Autopilot.task_ended`: the mode stays."""
        del task
        if self.mode in (CopterMode.LAND, CopterMode.RTL):
            self.switch_motors(on=False)
        self.is_taking_off_now = False
        self._target = None
        self._start(hold(self.vehicle))

    def restart_mission(self) -> None:
        """See `Autopilot.restart_mission`."""
        if self.mode is CopterMode.AUTO:
            self._start(self.mission.fly())

    def return_home(self) -> Task:
        """See `Autopilot.return_home`: at RTL_ALT, lower near home."""
        home = self.geography.home
        north, east, _ = self.vehicle.position
        distance = math.hypot(north - home[0], east - home[1])
        height = min(_CENTIMETRES * self.parameters["RTL_ALT"], max(_CONE_SLOPE * distance, _LEAST_RETURN))
        return return_to(self.vehicle, home, height, self.speed)

    def _circle(self) -> Task:
        """Circle around a place ahead, CIRCLE_RADIUS away, at CIRCLE_RATE."""
        radius = _CENTIMETRES * self.parameters["CIRCLE_RADIUS"]
        rate = math.radians(self.parameters["CIRCLE_RATE"])
        ahead = from_body(self.vehicle, radius, 0.0)
        north, east, down = self.vehicle.position
        centre = (north + ahead[0], east + ahead[1], down)
        return orbit(self.vehicle, centre, radius, abs(rate) * radius, rate > 0.0)

    # ---- mode GUIDED ------------------------------------------------------------------------------------------------
    def _go(self, target: Triple, yaw: float | None) -> None:
        """Fly to a place (NED, m), with the nose along the way unless a yaw (rad) is given."""
        self._setpoint = None
        self._target = target
        self.is_taking_off_now = False
        self._start(self._go_and_hold(target, yaw))

    def follow(self, setpoint: Setpoint, message: Any) -> None:
        """See `Autopilot.follow`: a position is flown to; velocities count for GUID_TIMEOUT."""
        self._check_guided(message)
        if self.vehicle.landed:
            raise UnsupportedError(f"{message.get_type()} on the ground: take off first")
        moves = any(value is not None for value in setpoint.velocity)
        if not moves and any(value is not None for value in setpoint.position):
            self._go(completed(self.vehicle, setpoint.position), setpoint.yaw)
            return
        self._fly_setpoint(setpoint)

    def _fly_setpoint(self, setpoint: Setpoint) -> None:
        is_new = self._setpoint is None
        self._target = None
        self.is_taking_off_now = False
        self.set_setpoint(setpoint)
        if is_new:
            self._start(offboard(self.vehicle, self._latest, 1e6 * self.parameters["GUID_TIMEOUT"]))

    def follow_attitude(self, message: Any) -> None:
        """See `Autopilot.follow_attitude`: the thrust is a climb rate, 0.5 = none, unless GUID_OPTIONS has bit 3."""
        self._check_guided(message, CopterMode.GUIDED_NOGPS)
        if round(self.parameters["GUID_OPTIONS"]) & _THRUST_AS_THRUST:
            vertical = Vertical(throttle=float(message.thrust))
        else:
            rate = (2.0 * message.thrust - 1.0) * _CENTIMETRES * self.parameters["WPNAV_SPEED_UP"]
            vertical = Vertical(z=self.vehicle.position[2] - rate / _CLIMB_GAIN)
        self._fly_setpoint(attitude_target(message, self.vehicle, vertical))

    def _check_guided(self, message: Any, *others: CopterMode) -> None:
        if self.mode not in (CopterMode.GUIDED, *others):
            raise UnsupportedError(f"{message.get_type()} in mode {self.mode.name}: allowed: GUIDED")

    def answer_stray_item(self, message: Any) -> None:
        """See `Autopilot.answer_stray_item`: a target of mode GUIDED, as DroneKit's simple_goto sends it."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        result = MissionResult.ERROR
        if self.mode is CopterMode.GUIDED and message.current in (_GUIDED_ITEM, _HEIGHT_ITEM):
            result = MissionResult.UNSUPPORTED_FRAME
            if message.frame in GLOBAL_FRAMES:
                result = MissionResult.ACCEPTED
                self._go_to_item(message)
        self.mission.acknowledge(sender, result, message.mission_type)

    def _go_to_item(self, message: Any) -> None:
        latitude = math.nan
        longitude = math.nan
        if message.current == _GUIDED_ITEM:
            latitude = message.x
            longitude = message.y
            if message.get_type() == "MISSION_ITEM_INT":
                latitude *= 1e-7
                longitude *= 1e-7
        target = completed(self.vehicle, self.geography.place(latitude, longitude, message.z, message.frame))
        if self.vehicle.landed:
            self.text("GUIDED: on the ground; take off first", Severity.WARNING)
            return
        self._go(target, None)

    # ---- commands ---------------------------------------------------------------------------------------------------
    def arm_or_disarm(self, command: Command) -> int:
        """See `Autopilot.arm_or_disarm`."""
        action = whole(command[1])
        if action not in (_ARM, _DISARM):
            return MavResult.UNSUPPORTED
        reason = ""
        if self.mode not in _ARMABLE:
            reason = f"{self.mode.name} mode not armable"
        elif self.mode in _NEEDS_POSITION and self.failures.fix_type < FIX_3D:
            reason = "need position estimate"
        if reason and action == _ARM and not self.vehicle.sim.armed:
            self.text(f"Arm: {reason}", Severity.ERROR)
            return MavResult.FAILED
        if action == _DISARM and not self._disarm_is_allowed(command):
            return MavResult.FAILED
        changes = self.vehicle.sim.armed != (action == _ARM)
        self.switch_motors(on=action == _ARM)
        if changes and action == _ARM:
            self.set_mode(self.mode)
        return MavResult.ACCEPTED

    def take_off(self, command: Command) -> int:
        """MAV_CMD_NAV_TAKEOFF: to a height above home; in GUIDED, armed and on the ground."""
        frame = command.frame
        if frame is None:
            frame = CoordinateFrame.RELATIVE
        reason = ""
        if self.mode is not CopterMode.GUIDED:
            reason = f"mode {self.mode.name}; allowed: GUIDED"
        elif not self.vehicle.sim.armed:
            reason = "not armed"
        elif not self.vehicle.landed:
            reason = "in the air"
        elif not math.isfinite(command[7]):
            reason = "no altitude"
        if reason:
            self.text(f"Takeoff failed: {reason}", Severity.WARNING)
            return MavResult.FAILED
        down = self.geography.place(math.nan, math.nan, command[7], frame)[2]
        if down >= self.vehicle.position[2]:
            self.text("Takeoff failed: below the vehicle", Severity.WARNING)
            return MavResult.FAILED
        self._setpoint = None
        self._target = None
        self.is_taking_off_now = True
        self._start(climb(self.vehicle, -down, _CENTIMETRES * self.parameters["WPNAV_SPEED_UP"]))
        return MavResult.ACCEPTED

    def do_set_mode(self, command: Command) -> int:
        """MAV_CMD_DO_SET_MODE."""
        if not whole(command[1]) & _CUSTOM_MODE:
            return MavResult.DENIED
        return self.set_custom_mode(whole(command[2]))

    def start_mission(self, command: Command) -> int:
        """MAV_CMD_MISSION_START."""
        del command
        return self.set_custom_mode(CopterMode.AUTO)

    def turn(self, command: Command) -> int:
        """MAV_CMD_CONDITION_YAW: on the way, with the present velocity, or on the spot."""
        if self.mode is not CopterMode.GUIDED or self.vehicle.landed or not math.isfinite(command[1]):
            return MavResult.FAILED
        yaw = yaw_of_condition(self.vehicle, command.parameters)
        if self._setpoint is not None:
            self._setpoint = replace(self._setpoint, yaw=yaw, yaw_rate=None)
        elif self._target is not None:
            self._go(self._target, yaw)
        else:
            self._start(hold(self.vehicle, yaw))
        return MavResult.ACCEPTED

    def reposition(self, command: Command) -> int:
        """MAV_CMD_DO_REPOSITION, as a COMMAND_INT."""
        if command.frame is None:
            return _COMMAND_INT_ONLY
        target = self.place_of(command)
        if self.mode is not CopterMode.GUIDED:
            if not whole(command[2]) & _CHANGE_MODE:
                return MavResult.DENIED
            self.set_mode(CopterMode.GUIDED)
        if self.vehicle.landed:
            self.text("GUIDED: on the ground; take off first", Severity.WARNING)
            return MavResult.FAILED
        if math.isfinite(command[1]) and command[1] > 0:
            self.speed = command[1]
        self._go(target, None)
        return MavResult.ACCEPTED

    # ---- messages ---------------------------------------------------------------------------------------------------
    def override_channels(self, message: Any) -> None:
        """RC_CHANNELS_OVERRIDE: channels 1 to 4 are the pilot's sticks."""
        for index in range(_OVERRIDE_CHANNELS):
            value = getattr(message, f"chan{index + 1}_raw")
            if value == _RELEASED:
                self._overrides[index] = _CENTRED
            elif value != _UNCHANGED:
                self._overrides[index] = value
        roll, pitch, throttle, yaw = (
            min(1.0, max(-1.0, (value - _CENTRED) / _HALF_RANGE)) for value in self._overrides[:4]
        )
        self.set_sticks(roll, -pitch, throttle, yaw)
        self.note_use(message)

    @property
    def sticks_us(self) -> int:
        """See `Autopilot.sticks_us`."""
        return _OVERRIDE_US

    def set_streams(self, message: Any) -> None:
        """REQUEST_DATA_STREAM: the rate of a group of messages."""
        if message.req_stream_id == ALL_GROUPS:
            contents = {content for group in STREAM_GROUPS.values() for content in group}
        elif message.req_stream_id in STREAM_GROUPS:
            contents = set(STREAM_GROUPS[message.req_stream_id])
        else:
            raise UnsupportedError(f"{message.get_type()} of stream {message.req_stream_id}")
        interval = -1
        if message.start_stop and message.req_message_rate:
            interval = round(1e6 / message.req_message_rate)
        for content in contents:
            self.schedule.set_interval(content.__name__, interval)

    commands: ClassVar[dict[int, CommandHandler]]
    messages: ClassVar[dict[str, MessageHandler]]


def _change_mode(mode: CopterMode) -> CommandHandler:
    """A command that changes the mode."""
    return lambda autopilot, _: autopilot.set_custom_mode(mode)


ArduCopter.commands = {
    **COMMANDS,
    MavCommand.TAKEOFF: ArduCopter.take_off,
    MavCommand.DO_SET_MODE: ArduCopter.do_set_mode,
    MavCommand.REPOSITION: ArduCopter.reposition,
    MavCommand.CONDITION_YAW: ArduCopter.turn,
    MavCommand.LAND: _change_mode(CopterMode.LAND),
    MavCommand.RETURN_TO_LAUNCH: _change_mode(CopterMode.RTL),
    MavCommand.LOITER_UNLIMITED: _change_mode(CopterMode.LOITER),
    MavCommand.MISSION_START: ArduCopter.start_mission,
}
ArduCopter.messages = {
    **MESSAGES,
    "RC_CHANNELS_OVERRIDE": ArduCopter.override_channels,
    "REQUEST_DATA_STREAM": ArduCopter.set_streams,
}
