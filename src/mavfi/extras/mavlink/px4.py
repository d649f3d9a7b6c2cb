"""PX4's modes: how it arms, takes off, follows set-points and returns."""

import math
from collections.abc import Callable
from enum import Enum
from typing import Any, ClassVar

from mavfi.extras.mavlink.autopilot import COMMANDS, MESSAGES, Autopilot, CommandHandler, MessageHandler
from mavfi.extras.mavlink.flying import (
    FOREVER_S,
    Setpoint,
    climb,
    go_to,
    hold,
    offboard,
    orbit,
    pilot,
    pilot_attitude,
    return_to,
)
from mavfi.extras.mavlink.parameters import PX4_DEFAULTS, Number
from mavfi.extras.mavlink.setpoints import attitude_target
from mavfi.extras.mavlink.shell import SHELL, Shell
from mavfi.extras.mavlink.telemetry import STREAMS, Content
from mavfi.extras.mavlink.vocabulary import Command, CoordinateFrame, MavCommand, MavResult, MissionResult, whole
from mavfi.flight.piloted import EndedTask, Task, Vertical, land
from mavfi.numerics.frames import HOME, Triple

_CUSTOM = 1
_AUTO = 4
_GUIDED = 8
_STABILIZE = 16
_MANUAL_INPUT = 64
"""MAV_MODE_FLAG."""
_MODE_FLAGS = _CUSTOM | _AUTO | _GUIDED | _STABILIZE
_DISARM = 0
_ARM = 1
_PAUSE = 0
_CONTINUE = 1
_CLEARANCE = 0.1
"""Error of the altitude of a take-off that goes unmentioned (m): PX4's."""
_AT_HOME = 1.0
"""Distance from the place of a take-off that is not flown (m)."""


class FlightMode(Enum):
    """PX4's custom modes: main mode and sub-mode."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    TAKEOFF = (4, 2)
    HOLD = (4, 3)
    MISSION = (4, 4)
    RETURN = (4, 5)
    LAND = (4, 6)
    ORBIT = (3, 1)  # only by MAV_CMD_DO_ORBIT
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)


_PILOTED = (FlightMode.MANUAL, FlightMode.STABILIZED, FlightMode.ALTITUDE, FlightMode.POSITION)
"""Modes that follow sticks."""


class Px4Autopilot(Autopilot):
    """One vehicle with PX4's modes."""

    kind: ClassVar[int] = 12
    origin: ClassVar[Triple] = HOME
    defaults: ClassVar[dict[str, Number]] = PX4_DEFAULTS
    integers_bytewise: ClassVar[bool] = True
    streams: ClassVar[dict[Content, float]] = STREAMS
    version: ClassVar[int] = 0x010E0000
    capabilities: ClassVar[int] = 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x40 | 0x80 | 0x100 | 0x800 | 0x2000
    long_frame: ClassVar[CoordinateFrame] = CoordinateFrame.GLOBAL
    answers_all_components: ClassVar[bool] = False
    ignores_mission_yaw: ClassVar[bool] = False
    home_is_item: ClassVar[bool] = False
    set_mode_number: ClassVar[int] = MavCommand.DO_SET_MODE

    def __init__(self, *arguments: Any) -> None:
        self.mode = FlightMode.HOLD
        self._take_off_place: Triple | None = None
        self.shell = Shell(self)
        super().__init__(*arguments)

    # ---- state ------------------------------------------------------------------------------------------------------
    @property
    def mode_name(self) -> str:
        """See `Autopilot.mode_name`."""
        return self.mode.name.lower()

    @property
    def mode_flags(self) -> int:
        """See `Autopilot.mode_flags`."""
        return _MODE_FLAGS

    @property
    def custom_mode(self) -> int:
        """See `Autopilot.custom_mode`."""
        main, sub = self.mode.value
        return main << 16 | sub << 24

    @property
    def is_taking_off(self) -> bool:
        """See `Autopilot.is_taking_off`."""
        return self.mode is FlightMode.TAKEOFF

    @property
    def is_landing(self) -> bool:
        """See `Autopilot.is_landing`."""
        return self.mode is FlightMode.LAND

    @property
    def is_in_mission_mode(self) -> bool:
        """See `Autopilot.is_in_mission_mode`."""
        return self.mode is FlightMode.MISSION

    @property
    def default_speed(self) -> float:
        """See `Autopilot.default_speed`."""
        return self.parameters["MPC_XY_CRUISE"]

    @property
    def channels(self) -> list[int]:
        """See `Autopilot.channels`: there is no receiver."""
        return []

    @property
    def followed(self) -> tuple[str, ...]:
        """See `Autopilot.followed`."""
        if self.mode is FlightMode.OFFBOARD:
            return ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
        if self.mode in _PILOTED:
            return ("MANUAL_CONTROL",)
        return ()

    def parameter_changed(self, name: str, value: Number) -> None:
        """See `Autopilot.parameter_changed`."""
        if name == "MPC_XY_CRUISE" and value > 0:
            self.speed = float(value)

    # ---- modes ------------------------------------------------------------------------------------------------------
    def set_mode(self, mode: FlightMode) -> None:
        """Change the mode and start its task."""
        self.mode = mode
        self.schedule.request("heartbeat")
        vehicle = self.vehicle
        tilt = math.radians(self.parameters["MPC_MAN_TILT_MAX"])
        rise = self.parameters["MPC_Z_VEL_MAX_UP"]
        tasks: dict[FlightMode, Callable[[], Task]] = {
            FlightMode.MANUAL: lambda: pilot_attitude(vehicle, lambda: self.sticks, tilt, rise, holds_height=False),
            FlightMode.STABILIZED: lambda: pilot_attitude(vehicle, lambda: self.sticks, tilt, rise, holds_height=False),
            FlightMode.ALTITUDE: lambda: pilot_attitude(vehicle, lambda: self.sticks, tilt, rise, holds_height=True),
            FlightMode.POSITION: lambda: pilot(vehicle, lambda: self.sticks, self.parameters["MPC_VEL_MANUAL"], rise),
            FlightMode.TAKEOFF: self._climb,
            FlightMode.LAND: lambda: land(vehicle, FOREVER_S),
            FlightMode.RETURN: self.return_home,
            FlightMode.MISSION: self.mission.fly,
            FlightMode.OFFBOARD: lambda: offboard(vehicle, self._latest, 1e6 * self.parameters["COM_OF_LOSS_T"]),
        }
        self._start(tasks.get(mode, lambda: hold(vehicle))())

    def set_custom_mode(self, custom_mode: int) -> int:
        """See `Autopilot.set_custom_mode`."""
        return self._set_main_mode(custom_mode >> 16 & 255, custom_mode >> 24)

    def _set_main_mode(self, main: int, sub: int) -> int:
        for mode in FlightMode:
            if mode.value == (main, sub) and mode is not FlightMode.ORBIT:
                return self.request_mode(mode)
        self.text(f"mode {main} {sub} refused: not supported")
        return MavResult.DENIED

    def request_mode(self, mode: FlightMode, text: str = "") -> int:
        """Change the mode on command; with running motors, mode mission needs one."""
        if mode is FlightMode.MISSION and self.mission.is_empty and self.vehicle.sim.armed:
            self.text("mission refused: there is none")
            return MavResult.DENIED
        self._take_off_place = None
        self.set_mode(mode)
        if text:
            self.text(text)
        return MavResult.ACCEPTED

    def task_ended(self, task: EndedTask) -> None:
        """See `Autopilot.task_ended`: hold follows."""
        del task
        if self.mode in (FlightMode.LAND, FlightMode.RETURN):
            self.vehicle.sim.arm(False)
            self.text("Disarmed by landing")
        self.set_mode(FlightMode.HOLD)

    def restart_mission(self) -> None:
        """See `Autopilot.restart_mission`."""
        if self.mode is FlightMode.MISSION:
            self._start(self.mission.fly())

    def return_home(self) -> Task:
        """See `Autopilot.return_home`: at RTL_RETURN_ALT, lower near home, in a cone of RTL_CONE_ANG."""
        height = self.parameters["RTL_RETURN_ALT"]
        slope = math.tan(math.radians(self.parameters["RTL_CONE_ANG"]))
        home = self.geography.home
        north, east, _ = self.vehicle.position
        distance = math.hypot(north - home[0], east - home[1])
        if slope > 0.0:
            height = min(height, max(distance / slope, 2.0 * self.parameters["NAV_ACC_RAD"]))
        return return_to(self.vehicle, home, height, self.speed)

    # ---- commands ---------------------------------------------------------------------------------------------------
    def arm_or_disarm(self, command: Command) -> int:
        """See `Autopilot.arm_or_disarm`."""
        action = whole(command[1])
        if action not in (_ARM, _DISARM):
            return MavResult.UNSUPPORTED
        if action == _DISARM and not self._disarm_is_allowed(command):
            return MavResult.DENIED
        changes = self.vehicle.sim.armed != (action == _ARM)
        self.switch_motors(on=action == _ARM)
        if changes and self.mode not in (FlightMode.OFFBOARD, FlightMode.MISSION):
            self.set_mode(FlightMode.HOLD)
        return MavResult.ACCEPTED

    def do_set_mode(self, command: Command) -> int:
        """MAV_CMD_DO_SET_MODE; without a custom mode, MAV_MODE decides as in PX4's Commander.cpp."""
        flags = max(0, whole(command[1]))
        if flags & _CUSTOM or command[2] > 0:
            return self._set_main_mode(whole(command[2]), whole(command[3]))
        if flags & _AUTO:
            return self.request_mode(FlightMode.MISSION)
        if not flags & _MANUAL_INPUT:
            return MavResult.DENIED
        if flags & _GUIDED:
            return self.request_mode(FlightMode.POSITION)
        if flags & _STABILIZE:
            return self.request_mode(FlightMode.STABILIZED)
        return self.request_mode(FlightMode.MANUAL)

    def start_mission(self, command: Command) -> int:
        """MAV_CMD_MISSION_START."""
        del command
        if self.mission.is_empty:
            self.text("mission refused: there is none")
            return MavResult.DENIED
        return self.request_mode(FlightMode.MISSION, "Mission started")

    def take_off(self, command: Command) -> int:
        """MAV_CMD_NAV_TAKEOFF: to an altitude above sea level, at least MIS_TAKEOFF_ALT above home; needs motors.

        Source: PX4's navigator_main.cpp (`rep->current.alt = cmd.param7`) and takeoff.cpp.
        """
        if not self.vehicle.sim.armed:
            return MavResult.REJECTED
        altitude = command[7]
        frame = command.frame
        if frame is None:
            frame = CoordinateFrame.GLOBAL
        place = list(self.vehicle.position)
        lowest = self.geography.home[2] - self.parameters["MIS_TAKEOFF_ALT"]
        place[2] = lowest
        if math.isfinite(altitude):
            place[2] = self.geography.place(math.nan, math.nan, altitude, frame)[2]
            if place[2] > lowest:
                if place[2] > lowest + _CLEARANCE:
                    self.text(f"Using minimum takeoff altitude: {self.parameters['MIS_TAKEOFF_ALT']:.2f} m")
                place[2] = lowest
        if place[2] > self.vehicle.position[2]:
            self.text("Already higher than takeoff altitude")
            place[2] = self.vehicle.position[2]
        # zeros are what programs send that have no place in mind
        if math.isfinite(command[5]) and math.isfinite(command[6]) and (command[5] or command[6]):
            place[:2] = self.geography.place(command[5], command[6], 0.0, frame)[:2]
        self._take_off_place = (place[0], place[1], place[2])
        self.set_mode(FlightMode.TAKEOFF)
        self.text("Takeoff detected")
        return MavResult.ACCEPTED

    def _climb(self) -> Task:
        """Climb, and then fly to the place of the take-off if it is another one."""
        vehicle = self.vehicle
        speed = self.parameters["MPC_TKO_SPEED"]
        place = self._take_off_place
        if place is None:  # the mode was set without a command
            north, east, _ = vehicle.position
            place = (north, east, self.geography.home[2] - self.parameters["MIS_TAKEOFF_ALT"])
        yield from climb(vehicle, -place[2], speed)
        if math.hypot(place[0] - vehicle.position[0], place[1] - vehicle.position[1]) > _AT_HOME:
            yield from go_to(vehicle, place, self.speed)

    def pause_or_continue(self, command: Command) -> int:
        """MAV_CMD_DO_PAUSE_CONTINUE."""
        if whole(command[1]) == _PAUSE:
            return self.request_mode(FlightMode.HOLD)
        if whole(command[1]) == _CONTINUE:
            return self.request_mode(FlightMode.MISSION)
        return MavResult.DENIED

    def reposition(self, command: Command) -> int:
        """MAV_CMD_DO_REPOSITION; parameter 4 is a yaw in rad."""
        if not self.vehicle.sim.armed:
            self.text("reposition refused: disarmed")
            return MavResult.REJECTED
        yaw = None
        if math.isfinite(command[4]):
            yaw = command[4]
        if math.isfinite(command[1]) and command[1] > 0:
            self.speed = command[1]
        target = self.place_of(command)
        self.mode = FlightMode.HOLD
        self.schedule.request("heartbeat")
        self._start(self._go_and_hold(target, yaw))
        return MavResult.ACCEPTED

    def do_orbit(self, command: Command) -> int:
        """MAV_CMD_DO_ORBIT; negative radius = counter-clockwise."""
        if not self.vehicle.sim.armed:
            self.text("orbit refused: disarmed")
            return MavResult.REJECTED
        radius = command[1]
        speed = command[2]
        if not (math.isfinite(radius) and abs(radius) >= 1.0):
            return MavResult.DENIED
        centre = self.place_of(command)
        self.mode = FlightMode.ORBIT
        self.schedule.request("heartbeat")
        if not math.isfinite(speed) or speed == 0:
            speed = self.speed
        self._start(orbit(self.vehicle, centre, abs(radius), abs(speed), radius > 0))
        return MavResult.ACCEPTED

    # ---- messages ---------------------------------------------------------------------------------------------------
    def follow(self, setpoint: Setpoint, message: Any) -> None:
        """See `Autopilot.follow`: mode offboard flies it, which may be entered later."""
        del message
        self.set_setpoint(setpoint)

    def follow_attitude(self, message: Any) -> None:
        """See `Autopilot.follow_attitude`: the thrust is a share of the largest."""
        self.set_setpoint(attitude_target(message, self.vehicle, Vertical(throttle=float(message.thrust))))

    def answer_stray_item(self, message: Any) -> None:
        """See `Autopilot.answer_stray_item`."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        self.mission.acknowledge(sender, MissionResult.ERROR, message.mission_type)

    def acknowledge(self, command: Command, result: int) -> None:
        """See `Autopilot.acknowledge`; that of a typed command is printed."""
        if command.sender == SHELL:
            self.shell.print_result(command, result)
        else:
            super().acknowledge(command, result)

    commands: ClassVar[dict[int, CommandHandler]]
    messages: ClassVar[dict[str, MessageHandler]] = {
        **MESSAGES,
        "SERIAL_CONTROL": lambda autopilot, message: autopilot.shell.receive(message),
    }


Px4Autopilot.commands = {
    **COMMANDS,
    MavCommand.TAKEOFF: Px4Autopilot.take_off,
    MavCommand.DO_SET_MODE: Px4Autopilot.do_set_mode,
    MavCommand.REPOSITION: Px4Autopilot.reposition,
    MavCommand.PAUSE_CONTINUE: Px4Autopilot.pause_or_continue,
    MavCommand.DO_ORBIT: Px4Autopilot.do_orbit,
    MavCommand.LAND: lambda autopilot, _: autopilot.request_mode(FlightMode.LAND, "Landing"),
    MavCommand.RETURN_TO_LAUNCH: lambda autopilot, _: autopilot.request_mode(FlightMode.RETURN, "Returning to launch"),
    MavCommand.MISSION_START: Px4Autopilot.start_mission,
}
