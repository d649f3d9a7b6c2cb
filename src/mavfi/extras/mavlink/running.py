"""A running flight as MAVLink telemetry over UDP, for ground stations on this machine."""

import socket

import numpy as np

from mavfi.errors import writing
from mavfi.extras.mavlink.tlog import FlightMessages
from mavfi.flight.loop import Item, Loop
from mavfi.mission import MissionStatus
from mavfi.report.export.lines import end_line, line_of
from mavfi.states import State

HOST = "127.0.0.1"


class Telemetry:
    """Sends the messages of a telemetry log to a port on loopback, until `close`; an observer of flights.

    Events, alarms and injections are sent as STATUSTEXT.

    Args:
        port: UDP port of the ground station.

    Raises:
        BadInputError: pymavlink is not installed.
    """

    def __init__(self, port: int) -> None:
        self._messages = FlightMessages()
        self._link = self._messages.link(self)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to = HOST, port
        self._rows, self._texts = 0, 0

    def begin(self, loop: Loop) -> None:
        """See `Observer`."""

    def published(self, state: State, time_us: int) -> None:
        """See `Observer`."""

    def tick(self, row: np.ndarray, items: list[Item], status: MissionStatus | None) -> None:
        """See `Observer`."""
        for message in self._messages.motion(row, self._rows):
            self._link.send(message)
        self._rows += 1
        lines = [line for item in items if (line := line_of(item)) is not None]
        if status is not None:
            lines.append(end_line(float(row[0]), status))
        for line in lines:
            self._texts += 1
            for message in self._messages.text(line, self._texts):
                self._link.send(message)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def write(self, packet: bytes) -> None:
        """Send a packet."""
        with writing(f"udp://{HOST}:{self._to[1]}"):
            try:
                self._socket.sendto(packet, self._to)
            except ConnectionRefusedError:  # no ground station listens yet
                pass
