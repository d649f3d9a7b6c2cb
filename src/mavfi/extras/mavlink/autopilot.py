"""A MAVLink autopilot: answers messages, flies tasks, sends telemetry; its owner advances time.

`px4.Px4Autopilot` and `ardupilot.ArduCopter` add modes, and how these autopilots arm, take off and follow set-points.
Whatever a client sends is executed, answered with a refusal, or noted in `Autopilot.not_supported`.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

from mavfi.extras.mavlink.failures import FIX_3D, FailureCommands
from mavfi.extras.mavlink.flying import MavVehicle, Setpoint, Sticks, go_to, hold
from mavfi.extras.mavlink.missions import Mission
from mavfi.extras.mavlink.parameters import Number, Parameters
from mavfi.extras.mavlink.setpoints import Geography, completed, global_target, has_acceleration, local_target
from mavfi.extras.mavlink.telemetry import Content, Schedule
from mavfi.extras.mavlink.tlog import chunks_of, mavlink_dialect
from mavfi.extras.mavlink.vocabulary import (
    Command,
    CoordinateFrame,
    MavCommand,
    MavResult,
    Severity,
    UnsupportedError,
    whole,
)
from mavfi.flight.piloted import TICK_US, EndedTask, Task
from mavfi.numerics.frames import Triple

_AUTOPILOT_VERSION = 148
_MESSAGE_INTERVAL = 244
"""Ids of messages that are sent on request only."""
_FORCE = 21_196
"""Second parameter of a command that disarms in flight."""
_HOME_LIMIT = 50_000.0
"""Largest distance of home from the origin (m): ArduPilot's."""
_STICKS_US = 500_000
"""Age of MANUAL_CONTROL from which sticks count as centred (us); PX4: COM_RC_LOSS_T."""
_UNUSED_US = 2_000_000
"""Time within which set-points and sticks must be followed, by a change of the mode (us)."""
_GROUND_SPEED_TYPES = (0, 1)
"""SPEED_TYPE: air and ground speed, which are the same here."""
_DEFAULT_SPEED = -2.0
_FTP_NAK = 129
_FTP_NOT_FOUND = 10
_FTP_UNKNOWN = 7
_FTP_OF_FILES = (3, 4)  # ListDirectory, OpenFileRO
_FTP_PAYLOAD = 251
_LOG_DATA = 90
_PARAM_EXT_FAILED = 2

CommandHandler = Callable[[Any, Command], int | None]
"""Executes a command; its result, or None if it is acknowledged later."""
MessageHandler = Callable[[Any, Any], None]


class Autopilot(ABC):
    """One vehicle with the system id 1.

    Args:
        vehicle: The vehicle.
        link: Packs messages: pymavlink's `MAVLink`, which writes to a file-like object.
        tell: Called with each new line of `not_supported`.

    Attributes:
        kind: MAV_AUTOPILOT.
        origin: Of NED: latitude and longitude (degrees), altitude above sea level (m).
        defaults: Parameters at the start.
        integers_bytewise: Whether integer parameters are sent as the bits of a float.
        streams: Periodic messages and their rates (Hz).
        version: `flight_sw_version` of AUTOPILOT_VERSION.
        capabilities: MAV_PROTOCOL_CAPABILITY.
        long_frame: CoordinateFrame of the altitude in a COMMAND_LONG.
        answers_all_components: Whether messages to other components of its system are answered too.
        ignores_mission_yaw: Whether the fourth parameter of a way-point means nothing.
        home_is_item: Whether item 0 of a mission is home.
        set_mode_number: Number of the command as which SET_MODE is acknowledged.
        commands: What executes each command.
        messages: What handles each message.
        not_supported: Messages, and uses of them, that were neither executed nor answered; each once.
        speed: Of flights to places (m/s).
    """

    kind: ClassVar[int]
    origin: ClassVar[Triple]
    defaults: ClassVar[dict[str, Number]]
    integers_bytewise: ClassVar[bool]
    streams: ClassVar[dict[Content, float]]
    version: ClassVar[int]
    capabilities: ClassVar[int]
    long_frame: ClassVar[CoordinateFrame]
    answers_all_components: ClassVar[bool]
    ignores_mission_yaw: ClassVar[bool]
    home_is_item: ClassVar[bool]
    set_mode_number: ClassVar[int]
    commands: ClassVar[dict[int, CommandHandler]]
    messages: ClassVar[dict[str, MessageHandler]]

    def __init__(self, vehicle: MavVehicle, link: Any, tell: Callable[[str], None] | None = None) -> None:
        self.vehicle = vehicle
        self._link = link
        self._tell = tell
        self.not_supported: list[str] = []
        self.geography = Geography(self.origin)
        self.parameters = Parameters(self.defaults, bytewise=self.integers_bytewise, on_change=self.parameter_changed)
        self.mission = Mission(self, home_first=self.home_is_item, asks_for_floats=self.home_is_item)
        self.failures = FailureCommands(vehicle, self.parameters, self._tell_failure, self.acknowledge)
        self.schedule = Schedule(self.streams)
        self.speed = self.default_speed
        self._setpoint: Setpoint | None = None
        self._setpoint_us = 0
        self._sticks = Sticks()
        self._sticks_us = -_STICKS_US
        self._unused: dict[str, int] = {}  # messages that the present mode does not follow: when they came last
        self._task = 0
        self._long_texts = 0
        self._start(hold(vehicle))

    # ---- what an autopilot adds -------------------------------------------------------------------------------------
    @property
    @abstractmethod
    def mode_name(self) -> str:
        """Name of the mode, in small letters."""

    @property
    @abstractmethod
    def mode_flags(self) -> int:
        """MAV_MODE_FLAG of HEARTBEAT, without that of armed motors."""

    @property
    @abstractmethod
    def custom_mode(self) -> int:
        """`custom_mode` of HEARTBEAT."""

    @property
    @abstractmethod
    def is_taking_off(self) -> bool:
        """Whether it takes off."""

    @property
    @abstractmethod
    def is_landing(self) -> bool:
        """Whether it lands."""

    @property
    @abstractmethod
    def is_in_mission_mode(self) -> bool:
        """Whether the present mode flies the mission."""

    @property
    @abstractmethod
    def default_speed(self) -> float:
        """Speed of flights to places unless a command changes it (m/s)."""

    @property
    @abstractmethod
    def channels(self) -> list[int]:
        """Channels of the receiver (us)."""

    @property
    @abstractmethod
    def followed(self) -> tuple[str, ...]:
        """Set-points and sticks that the present mode follows, by the names of their messages."""

    @abstractmethod
    def parameter_changed(self, name: str, value: Number) -> None:
        """Act on a parameter that was set."""

    @abstractmethod
    def set_custom_mode(self, custom_mode: int) -> int:
        """Change to the mode with this number in SET_MODE; the result as of a command."""

    @abstractmethod
    def task_ended(self, task: EndedTask) -> None:
        """Act on the end of the running task."""

    @abstractmethod
    def arm_or_disarm(self, command: Command) -> int:
        """MAV_CMD_COMPONENT_ARM_DISARM."""

    @abstractmethod
    def follow(self, setpoint: Setpoint, message: Any) -> None:
        """Act on a set-point."""

    @abstractmethod
    def follow_attitude(self, message: Any) -> None:
        """SET_ATTITUDE_TARGET."""

    @abstractmethod
    def answer_stray_item(self, message: Any) -> None:
        """A MISSION_ITEM that is no part of an upload."""

    @abstractmethod
    def restart_mission(self) -> None:
        """Fly the mission from its current item, if it is being flown."""

    @abstractmethod
    def return_home(self) -> Task:
        """Fly home and land."""

    # ---- state ------------------------------------------------------------------------------------------------------
    @property
    def ms(self) -> int:
        """Time since start (ms), 32 bits."""
        return self.vehicle.now_us // 1000 & 0xFFFFFFFF

    @property
    def sticks(self) -> Sticks:
        """The pilot's sticks; in the centre if nothing was received for some time."""
        if self.vehicle.now_us - self._sticks_us > self.sticks_us:
            return Sticks()
        return self._sticks

    @property
    def sticks_us(self) -> int:
        """Age from which the pilot's sticks count as centred (us)."""
        return _STICKS_US

    def set_home(self, place: Triple) -> bool:
        """Move home to a place (NED, m); returns whether it is near enough."""
        if not all(math.isfinite(coordinate) and abs(coordinate) <= _HOME_LIMIT for coordinate in place):
            return False
        self.geography.home = place
        self.schedule.request("home_position")
        return True

    # ---- time -------------------------------------------------------------------------------------------------------
    def step(self, until_us: int) -> None:
        """Let time pass up to an instant (us), a multiple of 20 ms, and send what is due."""
        while self.vehicle.now_us < until_us:
            self.vehicle.step(min(until_us, self.vehicle.now_us + TICK_US))
            self._end_tasks()
            self._note_unused()
            self.failures.prove()
            self.mission.repeat_request()
            for content in self.schedule.due(self.vehicle.now_us):
                fields = content(self)
                if fields is not None:
                    self.send(content.__name__, *fields)

    def _note_unused(self) -> None:
        """Note set-points and sticks that came for a mode which has not been set."""
        for kind, time_us in list(self._unused.items()):
            if kind in self.followed:
                del self._unused[kind]
            elif self.vehicle.now_us - time_us > _UNUSED_US:
                del self._unused[kind]
                self.note_unsupported(f"{kind} in mode {self.mode_name}")

    def _end_tasks(self) -> None:
        """Tell of a task that has ended by itself."""
        ended = list(self.vehicle.ended_tasks)
        self.vehicle.ended_tasks = []
        for task in ended:
            if task.number != self._task:
                continue
            if isinstance(task.result, Exception):
                self.text(f"{self.mode_name} failed: {task.result}", Severity.ERROR)
            self.task_ended(task)

    def _start(self, task: Task) -> None:
        self._task = self.vehicle.start(task)
        self.vehicle.ended_tasks = [task for task in self.vehicle.ended_tasks if task.number == self._task]

    def _go_and_hold(self, target: Triple, yaw: float | None) -> Task:
        yield from go_to(self.vehicle, target, self.speed, yaw)
        yield from hold(self.vehicle, yaw, target)

    def _latest(self) -> tuple[Setpoint | None, int]:
        return self._setpoint, self._setpoint_us

    # ---- output -----------------------------------------------------------------------------------------------------
    def send(self, name: str, *arguments: Any) -> None:
        """Send a message, by its name in small letters."""
        getattr(self._link, f"{name}_send")(*arguments)

    def text(self, text: str, severity: int = Severity.INFO) -> None:
        """Send a STATUSTEXT, a longer text in chunks that share an id."""
        parts = chunks_of(text)
        text_id = 0
        if len(parts) > 1:
            self._long_texts += 1
            text_id = self._long_texts % 65_535 + 1
        for index, part in enumerate(parts):
            self.send("statustext", severity, part, text_id, index)

    def _tell_failure(self, text: str) -> None:
        self.text(text, Severity.ERROR)

    def note_unsupported(self, what: str) -> None:
        """Note once what a client sent in vain."""
        if what in self.not_supported:
            return
        self.not_supported.append(what)
        if self._tell is not None:
            self._tell(what)

    def acknowledge(self, command: Command, result: int) -> None:
        """Send the result of a command."""
        self.send("command_ack", command.number, result, 0, 0, *command.sender)

    # ---- input ------------------------------------------------------------------------------------------------------
    def handle(self, message: Any) -> None:
        """Execute or answer a message, or note that it is not supported."""
        kind = message.get_type()
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        if not self._is_recipient(system, component):
            self.note_unsupported(f"{kind} to system {system}, component {component}")
            return
        if kind in _EMPTY:
            return
        handler = self.messages.get(kind)
        if handler is None:
            self.note_unsupported(kind)
            return
        try:
            handler(self, message)
        except UnsupportedError as error:
            self.note_unsupported(str(error))

    def _is_recipient(self, system: int, component: int) -> bool:
        """Whether a message to a system and component is for this autopilot; 0 = to all."""
        if system not in (0, self._link.srcSystem):
            return False
        return self.answers_all_components or component in (0, self._link.srcComponent)

    def _command(self, message: Any) -> None:
        """COMMAND_LONG and COMMAND_INT."""
        self.execute(Command.of(message))

    def execute(self, command: Command) -> None:
        """Execute a command, and acknowledge it now or later."""
        handler = self.commands.get(command.number)
        if handler is None:
            self.acknowledge(command, MavResult.UNSUPPORTED)
            return
        try:
            result = handler(self, command)
        except UnsupportedError as error:
            self.text(f"command {command.number} refused: {error}")
            result = MavResult.UNSUPPORTED
        if result is not None:
            self.acknowledge(command, result)

    def _set_mode(self, message: Any) -> None:
        """SET_MODE, which both autopilots acknowledge as a command."""
        result = self.set_custom_mode(message.custom_mode)
        self.send(
            "command_ack", self.set_mode_number, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )

    def _follow_local(self, message: Any) -> None:
        self._follow(local_target(message, self.vehicle), message)

    def _follow_global(self, message: Any) -> None:
        self._follow(global_target(message, self.geography), message)

    def _follow_attitude(self, message: Any) -> None:
        self.follow_attitude(message)
        self.note_use(message)

    def _follow(self, setpoint: Setpoint, message: Any) -> None:
        if has_acceleration(message):
            self.note_unsupported(f"acceleration in {message.get_type()}")
        self.follow(setpoint, message)
        self.note_use(message)

    def note_use(self, message: Any) -> None:
        """Remember a set-point or a position of sticks until a mode follows it."""
        self._unused[message.get_type()] = self.vehicle.now_us

    def set_setpoint(self, setpoint: Setpoint) -> None:
        """Set what a task that follows set-points flies."""
        self._setpoint = setpoint
        self._setpoint_us = self.vehicle.now_us

    def _timesync(self, message: Any) -> None:
        if message.tc1 == 0:
            self.send("timesync", 1000 * self.vehicle.now_us, message.ts1)

    def _ping(self, message: Any) -> None:
        if message.target_system == 0:
            sender = (message.get_srcSystem(), message.get_srcComponent())
            self.send("ping", message.time_usec, message.seq, *sender)

    def _manual_control(self, message: Any) -> None:
        """MANUAL_CONTROL: x forward, y right, z up (0 to 1000), r clockwise."""
        axes = (message.y, message.x, 2 * message.z - 1000, message.r)
        self.set_sticks(*(min(1.0, max(-1.0, axis / 1000.0)) for axis in axes))
        self.note_use(message)

    def set_sticks(self, roll: float, pitch: float, throttle: float, yaw: float) -> None:
        """Move the pilot's sticks, -1 to 1."""
        self._sticks = Sticks(roll, pitch, throttle, yaw)
        self._sticks_us = self.vehicle.now_us

    def _mission_item(self, message: Any) -> None:
        if self.mission.is_uploading:
            self.mission.receive(message)
        elif not self.mission.repeats(message):
            self.answer_stray_item(message)

    def _list_logs(self, message: Any) -> None:
        """LOG_REQUEST_LIST: there are none."""
        del message
        self.send("log_entry", 0, 0, 0, 0, 0)

    def _send_log(self, message: Any) -> None:
        """LOG_REQUEST_DATA: no bytes."""
        self.send("log_data", message.id, message.ofs, 0, [0] * _LOG_DATA)

    def _refuse_file(self, message: Any) -> None:
        """FILE_TRANSFER_PROTOCOL: there is no file system."""
        request = bytearray(message.payload)
        reply = bytearray(_FTP_PAYLOAD)
        reply[0:3] = request[0:3]  # sequence number and session
        reply[0:2] = (int.from_bytes(request[0:2], "little") + 1 & 0xFFFF).to_bytes(2, "little")
        reply[3] = _FTP_NAK
        reply[4] = 1  # size
        reply[5] = request[3]  # the opcode that is refused
        reply[12] = _FTP_UNKNOWN
        if request[3] in _FTP_OF_FILES:
            reply[12] = _FTP_NOT_FOUND
        self.send("file_transfer_protocol", 0, message.get_srcSystem(), message.get_srcComponent(), bytes(reply))

    def _refuse_extended_parameter(self, message: Any) -> None:
        """PARAM_EXT_SET: there are none."""
        self.send(
            "param_ext_ack",
            message.param_id.encode(),
            message.param_value.encode(),
            message.param_type,
            _PARAM_EXT_FAILED,
        )

    # ---- commands of both autopilots --------------------------------------------------------------------------------
    def _disarm_is_allowed(self, command: Command) -> bool:
        """Whether the motors may be switched off: on the ground, or with the magic number."""
        return self.vehicle.landed or command[2] == _FORCE

    def switch_motors(self, *, on: bool) -> None:
        """Switch the motors on or off, and say so if that changes anything."""
        if on != self.vehicle.sim.armed:
            self.vehicle.sim.arm(on)
            if on:
                self.text("Armed")
            else:
                self.text("Disarmed")
        self.schedule.request("heartbeat")

    def place_of(self, command: Command) -> Triple:
        """Place (NED, m) of a command; coordinates that it leaves out are those of the vehicle."""
        frame = command.frame
        if frame is None:
            frame = self.long_frame
        return completed(self.vehicle, self.geography.place(command[5], command[6], command[7], frame))

    def change_speed(self, command: Command) -> int:
        """MAV_CMD_DO_CHANGE_SPEED."""
        if whole(command[1]) not in _GROUND_SPEED_TYPES:
            return MavResult.UNSUPPORTED
        if command[2] == _DEFAULT_SPEED:
            self.speed = self.default_speed
        elif math.isfinite(command[2]) and command[2] > 0:
            self.speed = float(command[2])
        else:
            return MavResult.DENIED
        return MavResult.ACCEPTED

    def move_home(self, command: Command) -> int:
        """MAV_CMD_DO_SET_HOME; the altitude of a COMMAND_LONG is above sea level."""
        home = self.vehicle.position
        if command[1] != 1:
            if not (math.isfinite(command[5]) and math.isfinite(command[6]) and math.isfinite(command[7])):
                return MavResult.DENIED
            frame = command.frame
            if frame is None:
                frame = CoordinateFrame.GLOBAL
            home = self.geography.place(command[5], command[6], command[7], frame)
        if not self.set_home(home):
            self.text("home refused: allowed: within 50 km")
            return MavResult.DENIED
        return MavResult.ACCEPTED

    def terminate(self, command: Command) -> int:
        """MAV_CMD_DO_FLIGHTTERMINATION: motors off at once."""
        if not command[1] > 0.5:
            return MavResult.DENIED
        self.switch_motors(on=False)
        self.text("Flight terminated", Severity.ERROR)
        return MavResult.ACCEPTED

    def run_checks(self, command: Command) -> int:
        """MAV_CMD_RUN_PREARM_CHECKS."""
        del command
        if self.vehicle.sim.armed:
            return MavResult.REJECTED
        if self.failures.fix_type < FIX_3D:
            self.text("Pre-arm checks failed: no position", Severity.ERROR)
        else:
            self.text("Pre-arm checks passed")
        return MavResult.ACCEPTED

    def send_home(self, command: Command) -> int:
        """MAV_CMD_GET_HOME_POSITION."""
        del command
        self.schedule.request("home_position")
        return MavResult.ACCEPTED

    def inject_failure(self, command: Command) -> int | None:
        """MAV_CMD_INJECT_FAILURE."""
        return self.failures.inject(command)

    # ---- messages on request ----------------------------------------------------------------------------------------
    def request_message(self, command: Command) -> int:
        """MAV_CMD_REQUEST_MESSAGE."""
        number = whole(command[1])
        if number == _AUTOPILOT_VERSION:
            return self.send_version(command)
        if number == _MESSAGE_INTERVAL:
            return self.send_interval_of(whole(command[2]))
        name = _message_name(number)
        if name not in self.schedule:
            return MavResult.DENIED
        self.schedule.request(name)
        return MavResult.ACCEPTED

    def send_version(self, command: Command) -> int:
        """MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES."""
        del command
        hashes = [[0] * 8] * 3
        self.send("autopilot_version", self.capabilities, self.version, 0, 0, 0, *hashes, 0, 0, 42)
        return MavResult.ACCEPTED

    def send_interval(self, command: Command) -> int:
        """MAV_CMD_GET_MESSAGE_INTERVAL."""
        return self.send_interval_of(whole(command[1]))

    def send_interval_of(self, number: int) -> int:
        """Send MESSAGE_INTERVAL of a message, by its id."""
        if not 0 <= number <= 0xFFFF:
            return MavResult.DENIED
        self.send("message_interval", number, self.schedule.interval_us(_message_name(number)))
        return MavResult.ACCEPTED

    def set_interval(self, command: Command) -> int:
        """MAV_CMD_SET_MESSAGE_INTERVAL; the rates are the same for all clients."""
        name = _message_name(whole(command[1]))
        if name not in self.schedule or not math.isfinite(command[2]):
            return MavResult.DENIED
        self.schedule.set_interval(name, whole(command[2]))
        return MavResult.ACCEPTED


def _message_name(number: int) -> str:
    """Name of a message in small letters; "" = not known."""
    message_class = mavlink_dialect().mavlink_map.get(number)
    if message_class is None:
        return ""
    name: str = message_class.msgname.lower()
    return name


COMMANDS: dict[int, CommandHandler] = {
    MavCommand.ARM_DISARM: lambda autopilot, command: autopilot.arm_or_disarm(command),
    MavCommand.CHANGE_SPEED: Autopilot.change_speed,
    MavCommand.DO_SET_HOME: Autopilot.move_home,
    MavCommand.FLIGHT_TERMINATION: Autopilot.terminate,
    MavCommand.RUN_PREARM_CHECKS: Autopilot.run_checks,
    MavCommand.GET_HOME_POSITION: Autopilot.send_home,
    MavCommand.INJECT_FAILURE: Autopilot.inject_failure,
    MavCommand.REQUEST_MESSAGE: Autopilot.request_message,
    MavCommand.REQUEST_CAPABILITIES: Autopilot.send_version,
    MavCommand.GET_MESSAGE_INTERVAL: Autopilot.send_interval,
    MavCommand.SET_MESSAGE_INTERVAL: Autopilot.set_interval,
}
"""Commands of both autopilots."""
MESSAGES: dict[str, MessageHandler] = {
    "COMMAND_LONG": Autopilot._command,
    "COMMAND_INT": Autopilot._command,
    "SET_MODE": Autopilot._set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": Autopilot._follow_local,
    "SET_POSITION_TARGET_GLOBAL_INT": Autopilot._follow_global,
    "SET_ATTITUDE_TARGET": Autopilot._follow_attitude,
    "MANUAL_CONTROL": Autopilot._manual_control,
    "TIMESYNC": Autopilot._timesync,
    "PING": Autopilot._ping,
    "PARAM_REQUEST_LIST": lambda autopilot, _: autopilot.parameters.answer_list(autopilot.send),
    "PARAM_REQUEST_READ": lambda autopilot, message: autopilot.parameters.answer_read(message, autopilot.send),
    "PARAM_SET": lambda autopilot, message: autopilot.parameters.answer_set(message, autopilot.send),
    "PARAM_EXT_SET": Autopilot._refuse_extended_parameter,
    "MISSION_COUNT": lambda autopilot, message: autopilot.mission.begin_upload(message),
    "MISSION_ITEM": Autopilot._mission_item,
    "MISSION_ITEM_INT": Autopilot._mission_item,
    "MISSION_REQUEST_LIST": lambda autopilot, message: autopilot.mission.send_count(message),
    "MISSION_REQUEST": lambda autopilot, message: autopilot.mission.send_item(message),
    "MISSION_REQUEST_INT": lambda autopilot, message: autopilot.mission.send_item(message),
    "MISSION_SET_CURRENT": lambda autopilot, message: autopilot.mission.set_current(message),
    "MISSION_CLEAR_ALL": lambda autopilot, message: autopilot.mission.clear(message),
    "MISSION_REQUEST_PARTIAL_LIST": lambda autopilot, message: autopilot.mission.refuse(message),
    "MISSION_WRITE_PARTIAL_LIST": lambda autopilot, message: autopilot.mission.refuse(message),
    "LOG_REQUEST_LIST": Autopilot._list_logs,
    "LOG_REQUEST_DATA": Autopilot._send_log,
    "FILE_TRANSFER_PROTOCOL": Autopilot._refuse_file,
}
"""Messages of both autopilots."""
_EMPTY = ("HEARTBEAT", "MISSION_ACK", "LOG_REQUEST_END")
"""Messages that ask for nothing: a client's sign of life, and the end of a transfer."""
