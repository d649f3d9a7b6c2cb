"""The autopilot on UDP, on loopback, in wall time."""

import select
import socket
import time
from collections.abc import Callable
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.mavlink.ardupilot import ArduCopter
from mavfi.extras.mavlink.autopilot import Autopilot
from mavfi.extras.mavlink.flying import MavVehicle
from mavfi.extras.mavlink.px4 import Px4Autopilot
from mavfi.extras.mavlink.tlog import mavlink_dialect
from mavfi.flight.piloted import TICK_US
from mavfi.mission import MissionSpec

HOST = "127.0.0.1"
PORT = 14_580
"""UDP port of the autopilot, as of PX4's simulation."""
OFFBOARD_PORT = 14_540
GROUND_STATION_PORT = 14_550
MAX_SPEED = 12.0
"""Largest speed that may be commanded (m/s)."""
DIALECTS: dict[str, type[Autopilot]] = {"px4": Px4Autopilot, "ardupilot": ArduCopter}
"""Autopilots by name."""
_POLL_S = 0.004


class MavlinkServer:
    """Serves one vehicle until `close`.

    Args:
        spec: The mission, of which environment, seed, vehicle, wind and flight controller count.
        port: UDP port of the autopilot; 0 = any free one.
        peers: Ports to which telemetry is sent, in addition to those from which messages come.
        speed: Simulated time per wall time.
        dialect: Name of the autopilot, see `DIALECTS`.
        tell: Called once with each thing that a client sends in vain.

    Raises:
        BadInputError: pymavlink is not installed, the port is in use, or the mission cannot be flown from the ground.
    """

    def __init__(
        self,
        spec: MissionSpec,
        port: int = PORT,
        peers: tuple[int, ...] = (OFFBOARD_PORT, GROUND_STATION_PORT),
        speed: float = 1.0,
        dialect: str = "px4",
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self._dialect = mavlink_dialect()
        self._speed = speed
        self._peers = {(HOST, peer) for peer in peers}
        self._parsers: dict[tuple[str, int], Any] = {}
        self.vehicle = MavVehicle(spec)
        self.vehicle.sim.limit_speed(MAX_SPEED)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((HOST, port))
        except OSError as error:
            self.close()
            text = f"--port: {port}: cannot be opened ({error.strerror}); allowed: a free UDP port"
            raise BadInputError(text) from None
        self._socket.setblocking(False)
        link = self._dialect.MAVLink(self, srcSystem=1, srcComponent=1)
        self.autopilot = DIALECTS[dialect](self.vehicle, link, tell)
        self.received = 0

    @property
    def port(self) -> int:
        """UDP port of the autopilot."""
        return int(self._socket.getsockname()[1])

    def write(self, data: bytes) -> None:
        """Send a packet to all peers; those that do not listen are skipped."""
        for peer in self._peers:
            try:
                self._socket.sendto(data, peer)
            except OSError:
                continue

    def run(self, seconds: float) -> None:
        """Serve for a wall time (s)."""
        start = time.monotonic()
        start_us = self.vehicle.now_us
        while (now := time.monotonic() - start) < seconds:
            self.receive()
            target = start_us + int(1e6 * self._speed * now) // TICK_US * TICK_US
            if target > self.vehicle.now_us:
                self.autopilot.step(target)
            select.select([self._socket], [], [], _POLL_S)

    def receive(self) -> None:
        """Handle all messages that have arrived."""
        while True:
            try:
                data, peer = self._socket.recvfrom(65_535)
            except (BlockingIOError, ConnectionRefusedError):
                return
            self._peers.add(peer)
            if peer not in self._parsers:
                self._parsers[peer] = self._dialect.MAVLink(None)
                self._parsers[peer].robust_parsing = True
            for message in self._parsers[peer].parse_buffer(data) or ():
                if message.get_type() != "BAD_DATA":
                    self.received += 1
                    self.autopilot.handle(message)

    def close(self) -> None:
        """Close the socket and the simulation."""
        self._socket.close()
        self.vehicle.sim.close()
