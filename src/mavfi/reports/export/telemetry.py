"""A running flight as MAVLink telemetry over UDP, for ground stations on this machine."""

import socket

import numpy as np

from mavfi.errors import writing
from mavfi.flight_logs.lines import end_line, line_of
from mavfi.hosts.loop.observe import Item
from mavfi.hosts.loop.scheduler import Loop
from mavfi.mission import MissionStatus
from mavfi.reports.export.tlog import Payload, motion_messages, packet, text_messages
from mavfi.states import State

HOST = "127.0.0.1"


class Telemetry:
    """Sends the messages of a telemetry log to a port on loopback, until `close`; an observer of flights.

    Events, alarms and injections are sent as STATUSTEXT.

    Args:
        port: UDP port of the ground station.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to = HOST, port
        self._sent, self._rows, self._texts = 0, 0, 0

    def begin(self, loop: Loop) -> None:
        """See `Observer`."""

    def published(self, state: State, time_us: int) -> None:
        """See `Observer`."""

    def tick(self, row: np.ndarray, items: list[Item], status: MissionStatus | None) -> None:
        """See `Observer`."""
        for message in motion_messages(row, self._rows):
            self._send(message)
        self._rows += 1
        lines = [line for item in items if (line := line_of(item)) is not None]
        if status is not None:
            lines.append(end_line(float(row[0]), status))
        for line in lines:
            self._texts += 1
            for message in text_messages(line, self._texts):
                self._send(message)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, message: Payload) -> None:
        with writing(f"udp://{HOST}:{self._to[1]}"):
            try:
                self._socket.sendto(packet(self._sent, message), self._to)
            except ConnectionRefusedError:  # no ground station listens yet
                pass
        self._sent += 1
