"""Missions: upload, download and flight of way-points, by MAVLink's mission protocol."""

import math
from collections import defaultdict
from typing import TYPE_CHECKING, Any

from mavfi.extras.mavlink.flying import FOREVER_S, climb, go_to, return_to_launch
from mavfi.flight.piloted import Task, land
from mavfi.numerics.frames import HOME, Triple, local

if TYPE_CHECKING:
    from mavfi.extras.mavlink.autopilot import Autopilot

_ACCEPTED = 0
_WAYPOINT, _TAKEOFF, _LAND, _RETURN, _SPEED = 16, 22, 21, 20, 178
_RELATIVE_FRAMES = (3, 6)
"""MAV_FRAME: global, relative to home."""
_SCALE, _MISSING = 1e-7, 2**31 - 1
_MISSION, _ALL_TYPES = 0, 255
"""MAV_MISSION_TYPE."""


def place_of(item: Any) -> Triple:
    """Place (NED, m) of a MISSION_ITEM_INT or COMMAND_INT; NaN where a coordinate is left out."""
    latitude, longitude = (math.nan if value == _MISSING else value * _SCALE for value in (item.x, item.y))
    return local(latitude, longitude, item.z + (HOME[2] if item.frame in _RELATIVE_FRAMES else 0.0))


class Mission:
    """Items by MAV_MISSION_TYPE; those of a mission are flown, those of fences and rally points are only stored."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._items: defaultdict[int, list[Any]] = defaultdict(list)
        self._expected = 0
        self._current = 0

    def answer(self, message: Any) -> None:
        """Answer a message of the protocol."""
        send, asked = self._autopilot.send, (message.get_srcSystem(), message.get_srcComponent())
        kind, which = message.get_type(), getattr(message, "mission_type", _MISSION)
        items = self._items[which]
        if kind == "MISSION_COUNT":
            items.clear()
            self._expected = message.count
            self._next(which, asked)
        elif kind == "MISSION_ITEM_INT":
            if message.seq == len(items):
                items.append(message)
            self._next(which, asked)
        elif kind == "MISSION_REQUEST_LIST":
            send("mission_count", *asked, len(items), which)
        elif kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and message.seq < len(items):
            item = items[message.seq]
            given = item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z
            send("mission_item_int", *asked, item.seq, item.frame, item.command, 0, item.autocontinue, *given, which)
        elif kind == "MISSION_SET_CURRENT":
            self._current = message.seq
            send("mission_current", message.seq)
        elif kind == "MISSION_CLEAR_ALL":
            for cleared in self._items.values() if which == _ALL_TYPES else (items,):
                cleared.clear()
            send("mission_ack", *asked, _ACCEPTED, which)

    def _next(self, which: int, asked: tuple[int, int]) -> None:
        """Ask for the next item, or acknowledge the last one."""
        count = len(self._items[which])
        if count < self._expected:
            self._autopilot.send("mission_request_int", *asked, count, which)
            return
        if which == _MISSION:
            self._current = 0
        self._autopilot.send("mission_ack", *asked, _ACCEPTED, which)

    def fly(self) -> Task:
        """Fly the items from the current one on, once the motors run."""
        autopilot, items = self._autopilot, self._items[_MISSION]
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
        autopilot, vehicle, command = self._autopilot, self._autopilot.vehicle, item.command
        place = place_of(item)
        if command == _TAKEOFF or (command == _WAYPOINT and vehicle.landed):
            yield from climb(vehicle, -place[2])
        if command == _WAYPOINT:
            yaw = None if math.isnan(item.param4) else math.radians(item.param4)
            yield from go_to(vehicle, place, autopilot.speed, yaw)
        elif command == _SPEED and item.param2 > 0:
            autopilot.speed = float(item.param2)
        elif command == _RETURN:
            yield from return_to_launch(vehicle, autopilot.speed)
            vehicle.sim.arm(False)
        elif command == _LAND:
            if item.x or item.y:  # PX4: without coordinates it lands where it is
                yield from go_to(vehicle, (place[0], place[1], vehicle.position[2]), autopilot.speed)
            yield from land(vehicle, FOREVER_S)
            vehicle.sim.arm(False)
