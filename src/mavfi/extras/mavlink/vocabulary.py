"""Numbers of MAVLink that the autopilot uses, and a command in one form, however it was sent.

Source: https://mavlink.io/en/messages/common.html and ardupilotmega.html.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any


class MavResult(IntEnum):
    """MAV_RESULT: answers to a command."""

    ACCEPTED = 0
    REJECTED = 1  # temporarily, e.g. while the motors are off
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT: answers to messages of the mission protocol."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    INVALID_SEQUENCE = 13


class MavCommand(IntEnum):
    """MAV_CMD: commands, and items of a mission."""

    WAYPOINT = 16
    LOITER_UNLIMITED = 17
    LOITER_TURNS = 18
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    DO_ORBIT = 34
    SPLINE_WAYPOINT = 82
    DELAY = 93
    CONDITION_DELAY = 112
    CONDITION_YAW = 115
    DO_SET_MODE = 176
    DO_JUMP = 177
    CHANGE_SPEED = 178
    DO_SET_HOME = 179
    FLIGHT_TERMINATION = 185
    REPOSITION = 192
    PAUSE_CONTINUE = 193
    MISSION_START = 300
    ARM_DISARM = 400
    RUN_PREARM_CHECKS = 401
    GET_HOME_POSITION = 410
    INJECT_FAILURE = 420
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_CAPABILITIES = 520


class Severity(IntEnum):
    """MAV_SEVERITY of a STATUSTEXT."""

    ERROR = 3
    WARNING = 4
    INFO = 6


class CoordinateFrame(IntEnum):
    """MAV_FRAME; each global one has a second number, for messages with integer coordinates."""

    GLOBAL = 0
    LOCAL_NED = 1
    MISSION = 2
    RELATIVE = 3
    GLOBAL_INT = 5
    RELATIVE_INT = 6
    LOCAL_OFFSET_NED = 7
    BODY_NED = 8
    BODY_OFFSET_NED = 9
    TERRAIN = 10
    TERRAIN_INT = 11
    BODY_FRD = 12


GLOBAL_FRAMES = (
    CoordinateFrame.GLOBAL,
    CoordinateFrame.GLOBAL_INT,
    CoordinateFrame.RELATIVE,
    CoordinateFrame.RELATIVE_INT,
    CoordinateFrame.TERRAIN,
    CoordinateFrame.TERRAIN_INT,
)
RELATIVE_FRAMES = (CoordinateFrame.RELATIVE, CoordinateFrame.RELATIVE_INT)
"""Altitude above home."""
TERRAIN_FRAMES = (CoordinateFrame.TERRAIN, CoordinateFrame.TERRAIN_INT)
"""Altitude above the ground, which is a plane in our environments."""
COORDINATE_SCALE = 1e-7
"""Degrees of a latitude or longitude that is sent as an integer."""
_MISSING = 2**31 - 1
"""An integer coordinate that its sender leaves out."""


def degrees_of(coordinate: int) -> float:
    """Latitude or longitude of an integer coordinate (degrees); NaN if it is left out."""
    if coordinate == _MISSING:
        return math.nan
    return coordinate * COORDINATE_SCALE


def whole(value: float) -> int:
    """A whole number in a floating-point parameter; -1 for NaN, which means "not given", and infinities."""
    if math.isfinite(value):
        return round(value)
    return -1


@dataclass(frozen=True, slots=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT.

    Attributes:
        number: MAV_CMD.
        parameters: The seven parameters; of a COMMAND_INT, the fifth and sixth in degrees.
        frame: CoordinateFrame of the location; None = not given.
        sender: System and component.
    """

    number: int
    parameters: tuple[float, ...]
    frame: int | None
    sender: tuple[int, int]

    @classmethod
    def of(cls, message: Any) -> "Command":
        """The command in a message."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        parameters = (message.param1, message.param2, message.param3, message.param4)
        if message.get_type() == "COMMAND_INT":
            location = (degrees_of(message.x), degrees_of(message.y), message.z)
            return cls(message.command, parameters + location, message.frame, sender)
        location = (message.param5, message.param6, message.param7)
        return cls(message.command, parameters + location, None, sender)

    def __getitem__(self, number: int) -> float:
        """A parameter by its number in MAVLink's documentation, 1 to 7."""
        return self.parameters[number - 1]


class UnsupportedError(Exception):
    """What a message asks for is not supported; its text says what."""
