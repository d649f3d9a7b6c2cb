"""Missions: upload, download and flight of way-points, by MAVLink's mission protocol."""

import math
from typing import TYPE_CHECKING, Any

from mavfi.bridges.airsim.frames import Triple
from mavfi.bridges.airsim.vehicle import Task
from mavfi.bridges.mavlink.flying import climb, go_to, return_to_launch
from mavfi.flight_logs.ned import HOME, local

if TYPE_CHECKING:
    from mavfi.bridges.mavlink.autopilot import Autopilot

_ACCEPTED = 0
_WAYPOINT, _TAKEOFF, _LAND, _RETURN, _SPEED = 16, 22, 21, 20, 178
_RELATIVE = (3, 6)
_SCALE = 1e-7
MISSION, FENCE, RALLY = range(3)


class Mission:
    """Items by MAV_MISSION_TYPE; those of type MISSION are flown."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._items: dict[int, list[Any]] = {MISSION: [], FENCE: [], RALLY: []}
        self._expected = 0
        self._current = 0

    def answer(self, message: Any) -> None:
        """Answer a message of the protocol."""
        send, asked = self._autopilot.send, (message.get_srcSystem(), message.get_srcComponent())
        kind, which = message.get_type(), getattr(message, "mission_type", MISSION)
        items = self._items.setdefault(which, [])
        if kind == "MISSION_COUNT":
            items.clear()
            self._expected = message.count
            self._next(which, asked)
        elif kind in ("MISSION_ITEM_INT", "MISSION_ITEM"):
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
            items.clear()
            send("mission_ack", *asked, _ACCEPTED, which)

    def _next(self, which: int, asked: tuple[int, int]) -> None:
        """Ask for the next item, or acknowledge the last one."""
        count = len(self._items[which])
        if count < self._expected:
            self._autopilot.send("mission_request_int", *asked, count, which)
            return
        if which == MISSION:
            self._current = 0
        self._autopilot.send("mission_ack", *asked, _ACCEPTED, which)

    def fly(self) -> Task:
        """Fly the items from the current one on, once the motors run."""
        autopilot, items = self._autopilot, self._items[MISSION]
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
        autopilot = self._autopilot
        if item.command == _TAKEOFF:
            yield from climb(autopilot.vehicle, -self._place(item)[2])
        elif item.command == _WAYPOINT:
            if autopilot.vehicle.landed:
                yield from climb(autopilot.vehicle, -self._place(item)[2])
            yaw = None if math.isnan(item.param4) else math.radians(item.param4)
            yield from go_to(autopilot.vehicle, self._place(item), autopilot.speed, yaw)
        elif item.command == _SPEED and item.param2 > 0:
            autopilot.speed = float(item.param2)
        elif item.command in (_RETURN, _LAND):
            yield from return_to_launch(autopilot.vehicle, autopilot.speed)
            autopilot.vehicle.sim.arm(False)

    @staticmethod
    def _place(item: Any) -> Triple:
        """NED (m)."""
        height = item.z + (HOME[2] if item.frame in _RELATIVE else 0.0)
        return local(item.x * _SCALE, item.y * _SCALE, height)
