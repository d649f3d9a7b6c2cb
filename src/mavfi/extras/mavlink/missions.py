"""The mission protocol: uploads and downloads of items in both forms, and their flight."""

import math
from collections import defaultdict
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

from mavfi.extras.mavlink.flying import FOREVER_S, climb, go_to, hold, orbit, wait, yaw_of_condition
from mavfi.extras.mavlink.setpoints import completed
from mavfi.extras.mavlink.vocabulary import (
    COORDINATE_SCALE,
    GLOBAL_FRAMES,
    CoordinateFrame,
    MavCommand,
    MissionResult,
    degrees_of,
    whole,
)
from mavfi.flight.piloted import Task, land, turn_to
from mavfi.numerics.frames import Triple

if TYPE_CHECKING:
    from mavfi.extras.mavlink.autopilot import Autopilot

_MISSION = 0
_FENCE = 1
_ALL_TYPES = 255
"""MAV_MISSION_TYPE."""
_RETRY_US = 500_000
"""Time after which an item that was asked for with MISSION_REQUEST_INT is asked for with MISSION_REQUEST (us)."""
_REPEATED_US = 5_000_000
"""Time after an upload within which its items may come again (us)."""
_CIRCLE_SPEED = 3.0
"""Speed of LOITER_TURNS (m/s)."""
_CIRCLE_RADIUS = 10.0
"""Its radius where an item gives none (m)."""
_LARGEST = 2**31 - 1
_NO_ITEMS = 65_535
_IN_MISSION_MODE = 1
_OUT_OF_MISSION_MODE = 2
"""Fields `total` and `mission_mode` of MISSION_CURRENT."""
_TURN_S = 15.0
"""Longest duration of CONDITION_YAW (s)."""
_TURN_MARGIN = math.radians(3.0)
"""Error of the yaw at its end (rad)."""

FLOWN = (
    MavCommand.WAYPOINT,
    MavCommand.SPLINE_WAYPOINT,
    MavCommand.LOITER_UNLIMITED,
    MavCommand.LOITER_TURNS,
    MavCommand.LOITER_TIME,
    MavCommand.RETURN_TO_LAUNCH,
    MavCommand.LAND,
    MavCommand.TAKEOFF,
    MavCommand.DELAY,
    MavCommand.CONDITION_DELAY,
    MavCommand.CONDITION_YAW,
    MavCommand.DO_JUMP,
    MavCommand.CHANGE_SPEED,
    MavCommand.DO_SET_HOME,
)
"""Items that are flown; a spline as straight lines."""
_AT_A_PLACE = (
    MavCommand.WAYPOINT,
    MavCommand.SPLINE_WAYPOINT,
    MavCommand.LOITER_UNLIMITED,
    MavCommand.LOITER_TURNS,
    MavCommand.LOITER_TIME,
)
PAYLOAD = {
    203: "DO_DIGICAM_CONTROL",
    204: "DO_MOUNT_CONFIGURE",
    205: "DO_MOUNT_CONTROL",
    206: "DO_SET_CAM_TRIGG_DIST",
    214: "DO_SET_CAM_TRIGG_INTERVAL",
    530: "SET_CAMERA_MODE",
    531: "SET_CAMERA_ZOOM",
    532: "SET_CAMERA_FOCUS",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW",
    1001: "DO_GIMBAL_MANAGER_CONFIGURE",
    2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE",
    2003: "DO_TRIGGER_CONTROL",
    2500: "VIDEO_START_CAPTURE",
    2501: "VIDEO_STOP_CAPTURE",
}
"""Items for a camera or gimbal, which this vehicle lacks: stored, skipped in flight, and said at the upload."""


class MissionState(IntEnum):
    """MISSION_STATE, in MISSION_CURRENT."""

    NO_MISSION = 1
    NOT_STARTED = 2
    ACTIVE = 3
    PAUSED = 4  # begun, and another mode has been set
    COMPLETE = 5


@dataclass(frozen=True, slots=True)
class MissionItem:
    """An item, in either form of the protocol.

    Attributes:
        frame: MAV_FRAME.
        command: MAV_CMD.
        autocontinue: Whether the mission continues with the next item.
        parameters: Parameters 1 to 4.
        x: Latitude (degrees), or the fifth parameter.
        y: Longitude (degrees), or the sixth.
        z: Altitude (m), or the seventh.
    """

    frame: int
    command: int
    autocontinue: int
    parameters: tuple[float, float, float, float]
    x: float
    y: float
    z: float

    @classmethod
    def of(cls, message: Any) -> "MissionItem":
        """The item of a MISSION_ITEM or MISSION_ITEM_INT."""
        x = float(message.x)
        y = float(message.y)
        if message.get_type() == "MISSION_ITEM_INT" and message.frame != CoordinateFrame.MISSION:
            x = degrees_of(message.x)
            y = degrees_of(message.y)
        parameters = (message.param1, message.param2, message.param3, message.param4)
        return cls(message.frame, message.command, message.autocontinue, parameters, x, y, message.z)

    @property
    def integers(self) -> tuple[int, int]:
        """Fifth and sixth parameter as in MISSION_ITEM_INT."""
        scale = COORDINATE_SCALE
        if self.frame == CoordinateFrame.MISSION:
            scale = 1.0
        return _integer(self.x / scale), _integer(self.y / scale)


def _integer(value: float) -> int:
    """A coordinate as an integer of 32 bits; a missing one is the largest."""
    if not math.isfinite(value):
        return _LARGEST
    return min(_LARGEST, max(-_LARGEST, round(value)))


class Mission:
    """Items by MAV_MISSION_TYPE; those of a mission are flown, those of fences and rally points are only stored.

    Args:
        autopilot: Its autopilot.
        home_first: Whether item 0 is home, as ArduPilot has it.
        asks_for_floats: Whether items are asked for with MISSION_REQUEST at once.
    """

    def __init__(self, autopilot: "Autopilot", *, home_first: bool, asks_for_floats: bool) -> None:
        self._autopilot = autopilot
        self._home_first = home_first
        self._asks_for_floats = asks_for_floats
        self._items: defaultdict[int, list[MissionItem]] = defaultdict(list)
        self._upload: list[MissionItem] | None = None  # until it is complete
        self._upload_type = _MISSION
        self._expected = 0
        self._uploader = (0, 0)
        self._asked_us = 0
        self._uploaded_us = -_REPEATED_US
        self._is_repeated = False
        self._has_begun = False
        self._is_complete = False
        self.current = self.first

    @property
    def first(self) -> int:
        """Number of the first item that is flown."""
        return int(self._home_first)

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to fly."""
        return len(self._items[_MISSION]) <= self.first

    @property
    def count(self) -> int:
        """Number of items, home included if it is one."""
        return len(self._items[_MISSION])

    @property
    def status(self) -> tuple[int, int, MissionState, int]:
        """Content of MISSION_CURRENT: current item, number of items without home, state, and whether in its mode."""
        total = self.count - self.first
        if self.is_empty:
            total = _NO_ITEMS
        mode = _OUT_OF_MISSION_MODE
        if self._autopilot.is_in_mission_mode:
            mode = _IN_MISSION_MODE
        return self.current, total, self._state, mode

    @property
    def _state(self) -> MissionState:
        if self.is_empty:
            return MissionState.NO_MISSION
        if self._is_complete:
            return MissionState.COMPLETE
        if not self._has_begun:
            return MissionState.NOT_STARTED
        if self._autopilot.is_in_mission_mode:
            return MissionState.ACTIVE
        return MissionState.PAUSED

    def _reset_state(self) -> None:
        """Nothing of the items has been flown."""
        self._has_begun = False
        self._is_complete = False

    # ---- upload -----------------------------------------------------------------------------------------------------
    def begin_upload(self, message: Any) -> None:
        """MISSION_COUNT."""
        self._upload = []
        self._upload_type = message.mission_type
        self._expected = message.count
        self._uploader = (message.get_srcSystem(), message.get_srcComponent())
        self._ask()

    @property
    def is_uploading(self) -> bool:
        """Whether items are expected."""
        return self._upload is not None

    def receive(self, message: Any) -> None:
        """MISSION_ITEM or MISSION_ITEM_INT of an upload; each is asked for."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        assert self._upload is not None  # by `is_uploading`
        if message.seq < len(self._upload):
            return  # sent twice
        if message.seq > len(self._upload):
            self.acknowledge(sender, MissionResult.INVALID_SEQUENCE, message.mission_type)
            return
        item = MissionItem.of(message)
        is_home = self._home_first and message.seq == 0
        if self._upload_type == _MISSION and not is_home:
            result = self._check(item)
            if result != MissionResult.ACCEPTED:
                self._upload = None
                self.acknowledge(sender, result, _MISSION)
                return
        self._upload.append(item)
        self._ask()

    def _check(self, item: MissionItem) -> MissionResult:
        """Whether an item can be flown, or skipped because it is for a payload."""
        if item.command in PAYLOAD:
            self._autopilot.text(f"mission: {PAYLOAD[item.command]} is skipped: no camera or gimbal")
            return MissionResult.ACCEPTED
        if item.command not in FLOWN:
            self._autopilot.text(f"mission refused: command {item.command} is not supported")
            return MissionResult.UNSUPPORTED
        needs_place = item.command in (*_AT_A_PLACE, MavCommand.TAKEOFF)
        if item.command in (MavCommand.LAND, MavCommand.DO_SET_HOME):
            needs_place = bool(item.x or item.y)
        if needs_place and item.frame not in GLOBAL_FRAMES:
            self._autopilot.text(f"mission refused: frame {item.frame} is not supported")
            return MissionResult.UNSUPPORTED_FRAME
        return MissionResult.ACCEPTED

    def _ask(self) -> None:
        """Ask for the next item, or store and acknowledge the upload."""
        assert self._upload is not None  # an upload is under way
        if len(self._upload) < self._expected:
            self._is_repeated = False
            self._asked_us = self._autopilot.vehicle.now_us
            self._request(as_float=self._asks_for_floats)
            return
        # in place: a mission that is being flown takes the new items
        items = self._items[self._upload_type]
        items[:] = self._upload
        self._upload = None
        self._uploaded_us = self._autopilot.vehicle.now_us
        if self._upload_type == _FENCE and items:
            self._autopilot.text("fence: stored, not enforced")
        if self._upload_type == _MISSION:
            if self._home_first and items:
                items[0] = self._home_item()
            self.current = self.first
            self._reset_state()
        self.acknowledge(self._uploader, MissionResult.ACCEPTED, self._upload_type)

    def _request(self, *, as_float: bool) -> None:
        assert self._upload is not None  # an upload is under way
        name = "mission_request_int"
        if as_float:
            name = "mission_request"
        self._autopilot.send(name, *self._uploader, len(self._upload), self._upload_type)

    def repeat_request(self) -> None:
        """Ask again, in the older form, for an item that has not come: clients may know only that one."""
        if self._upload is None or self._is_repeated:
            return
        if self._autopilot.vehicle.now_us - self._asked_us >= _RETRY_US:
            self._is_repeated = True
            self._request(as_float=True)

    def acknowledge(self, sender: tuple[int, int], result: MissionResult, mission_type: int) -> None:
        """Send MISSION_ACK."""
        self._autopilot.send("mission_ack", *sender, result, mission_type)

    def refuse(self, message: Any) -> None:
        """Messages on parts of lists, which neither PX4 nor ArduPilot's missions need."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        self.acknowledge(sender, MissionResult.UNSUPPORTED, message.mission_type)

    def repeats(self, message: Any) -> bool:
        """Whether an item belongs to an upload that has just ended: a client has answered both requests for it."""
        is_recent = self._autopilot.vehicle.now_us - self._uploaded_us < _REPEATED_US
        return is_recent and message.seq < self._expected and message.current <= 1

    # ---- download ---------------------------------------------------------------------------------------------------
    def send_count(self, message: Any) -> None:
        """MISSION_REQUEST_LIST."""
        count = len(self._items[message.mission_type])
        if message.mission_type == _MISSION and self._home_first:
            count = max(count, 1)
        sender = (message.get_srcSystem(), message.get_srcComponent())
        self._autopilot.send("mission_count", *sender, count, message.mission_type)

    def send_item(self, message: Any) -> None:
        """MISSION_REQUEST or MISSION_REQUEST_INT: the item in the form of the request."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        items = self._items[message.mission_type]
        if message.mission_type == _MISSION and self._home_first and message.seq == 0:
            item = self._home_item()
        elif message.seq < len(items):
            item = items[message.seq]
        else:
            self.acknowledge(sender, MissionResult.INVALID_SEQUENCE, message.mission_type)
            return
        name = "mission_item"
        x: float = item.x
        y: float = item.y
        if message.get_type() == "MISSION_REQUEST_INT":
            name = "mission_item_int"
            x, y = item.integers
        is_current = int(message.seq == self.current and message.mission_type == _MISSION)
        head = (*sender, message.seq, item.frame, item.command, is_current, item.autocontinue)
        self._autopilot.send(name, *head, *item.parameters, x, y, item.z, message.mission_type)

    def _home_item(self) -> MissionItem:
        """Home as item 0."""
        geography = self._autopilot.geography
        latitude, longitude, altitude = geography.geodetic(geography.home)
        return MissionItem(
            CoordinateFrame.GLOBAL, MavCommand.WAYPOINT, 1, (0.0, 0.0, 0.0, 0.0), latitude, longitude, altitude
        )

    # ---- where to begin, and deletion -------------------------------------------------------------------------------
    def set_current(self, message: Any) -> None:
        """MISSION_SET_CURRENT; a mission that is being flown continues from there."""
        autopilot = self._autopilot
        if message.seq >= max(1, self.count):
            autopilot.text(f"mission: no item {message.seq}")
            return
        self.current = max(self.first, message.seq)
        self._is_complete = False
        autopilot.send("mission_current", *self.status)
        autopilot.restart_mission()

    def clear(self, message: Any) -> None:
        """MISSION_CLEAR_ALL."""
        # in place: a mission that is being flown ends
        stored_lists = [self._items[message.mission_type]]
        if message.mission_type == _ALL_TYPES:
            stored_lists = list(self._items.values())
        for stored in stored_lists:
            stored.clear()
        if self.is_empty:
            self._reset_state()
        sender = (message.get_srcSystem(), message.get_srcComponent())
        self.acknowledge(sender, MissionResult.ACCEPTED, message.mission_type)

    # ---- flight -----------------------------------------------------------------------------------------------------
    def fly(self) -> Task:
        """Fly the items from the current one on, once the motors run; they may be uploaded before that."""
        autopilot = self._autopilot
        items = self._items[_MISSION]
        jumps: dict[int, int] = {}  # how often each DO_JUMP has jumped
        yield from self._motors()
        self.current = max(self.current, self.first)
        self._has_begun = True
        self._is_complete = False
        while self.current < len(items):
            yield from self._motors()
            number = self.current
            item = items[number]
            autopilot.send("mission_current", *self.status)
            if item.command == MavCommand.DO_JUMP:
                self.current = self._after_jump(number, item, jumps)
                yield  # a jump to itself must not stop time
                continue
            yield from self._item(item)
            autopilot.send("mission_item_reached", number)
            self.current = number + 1
        self.current = self.first
        self._is_complete = True
        autopilot.text("Mission finished")
        return True

    def _motors(self) -> Task:
        """Wait until the motors run."""
        while not self._autopilot.vehicle.sim.armed:
            yield

    def _after_jump(self, number: int, item: MissionItem, jumps: dict[int, int]) -> int:
        """Number of the item after a DO_JUMP: its target, or the next one once it has jumped often enough."""
        target, repetitions = (whole(parameter) for parameter in item.parameters[:2])
        jumps[number] = jumps.get(number, 0) + 1
        if 0 <= repetitions < jumps[number] or not 0 <= target < self.count:
            jumps.pop(number)
            return number + 1
        return max(target, self.first)

    def _place(self, item: MissionItem) -> Triple:
        """Where an item is (NED, m); what it leaves out is as the vehicle is."""
        autopilot = self._autopilot
        x = item.x
        y = item.y
        if x == 0.0 and y == 0.0:  # both autopilots: no coordinates
            x = y = math.nan
        return completed(autopilot.vehicle, autopilot.geography.place(x, y, item.z, item.frame))

    def _item(self, item: MissionItem) -> Task:
        """Fly one item."""
        autopilot = self._autopilot
        vehicle = autopilot.vehicle
        command = item.command
        first, second = item.parameters[:2]
        if command in _AT_A_PLACE:
            yield from self._visit(item)
        elif command == MavCommand.TAKEOFF:
            down = autopilot.geography.place(math.nan, math.nan, item.z, item.frame)[2]
            if vehicle.position[2] > down:
                yield from climb(vehicle, -down)
        elif command in (MavCommand.DELAY, MavCommand.CONDITION_DELAY):
            yield from wait(vehicle, first)
        elif command == MavCommand.CONDITION_YAW:
            yield from turn_to(vehicle, yaw_of_condition(vehicle, item.parameters), _TURN_S, _TURN_MARGIN)
        elif command == MavCommand.CHANGE_SPEED and second > 0:
            autopilot.speed = float(second)
        elif command == MavCommand.DO_SET_HOME:
            home = vehicle.position
            if first != 1:
                home = self._place(item)
            autopilot.set_home(home)
        elif command == MavCommand.RETURN_TO_LAUNCH:
            yield from autopilot.return_home()
            vehicle.sim.arm(False)
        elif command == MavCommand.LAND:
            yield from self._land(item)

    def _visit(self, item: MissionItem) -> Task:
        """Fly to the place of an item, and do there what it asks for."""
        autopilot = self._autopilot
        yaw = None
        if math.isfinite(item.parameters[3]) and not autopilot.ignores_mission_yaw:
            yaw = math.radians(item.parameters[3])
        target = self._place(item)
        if autopilot.vehicle.landed:
            yield from climb(autopilot.vehicle, -target[2])
        yield from go_to(autopilot.vehicle, target, autopilot.speed, yaw)
        yield from self._stay(item, target, yaw)

    def _land(self, item: MissionItem) -> Task:
        """Land at the place of an item; without coordinates where the vehicle is."""
        vehicle = self._autopilot.vehicle
        if item.x or item.y:
            target = self._place(item)
            yield from go_to(vehicle, (target[0], target[1], vehicle.position[2]), self._autopilot.speed)
        yield from land(vehicle, FOREVER_S)
        vehicle.sim.arm(False)

    def _stay(self, item: MissionItem, target: Triple, yaw: float | None) -> Task:
        """What an item asks for once its place is reached."""
        vehicle = self._autopilot.vehicle
        first = item.parameters[0]
        if item.command == MavCommand.LOITER_UNLIMITED:
            yield from hold(vehicle, yaw)
        elif item.command == MavCommand.LOITER_TURNS:
            radius = item.parameters[2]
            if radius == 0 or not math.isfinite(radius):
                radius = _CIRCLE_RADIUS
            turns_s = 2.0 * math.pi * abs(radius) * max(0.0, first) / _CIRCLE_SPEED
            end_us = vehicle.now_us + round(1e6 * turns_s)
            for _ in orbit(vehicle, target, abs(radius), _CIRCLE_SPEED, radius > 0):
                if vehicle.now_us >= end_us:
                    return
                yield
        elif first > 0:
            yield from wait(vehicle, first, yaw)
