"""A link between two MAVLink peers: what comes from one is sent to the other, as it is or with faults."""

import select
import sys
import time
from contextlib import redirect_stdout
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.mavlink.faults import FaultyStream
from mavfi.extras.shared.mavlink_frames import FrameSplitter

_MOST_BYTES = 65536
_WAIT_S = 0.5
"""Longest wait for bytes: a connection that is accepted or restored is then seen (s)."""


def connect(address: str) -> Any:
    """A connection of pymavlink, e.g. `udpin:127.0.0.1:14550`, `udpout:`, `tcp:`, `tcpin:`, or a serial device.

    Raises:
        BadInputError: It cannot be opened.
    """
    from pymavlink import mavutil

    try:
        connection = mavutil.mavlink_connection(address, retries=0)
    except Exception as error:  # of sockets, of the serial library, and of text that pymavlink takes apart
        raise BadInputError(f"{address}: cannot be opened ({error})") from None
    if connection.fd is None:
        raise BadInputError(f"{address}: is a file; allowed: a connection, e.g. udpin:127.0.0.1:14550")
    return connection


class MavlinkLink:
    """Two connections, each with the stream of frames that come from it.

    Args:
        program: Connection of the program, and what passes from it.
        autopilot: Connection of the autopilot, and what passes from it.
        dialect: See `mavlink_dialect`.
    """

    def __init__(self, program: tuple[Any, FaultyStream], autopilot: tuple[Any, FaultyStream], dialect: Any) -> None:
        program_side, from_program = program
        autopilot_side, from_autopilot = autopilot
        self._ways = [
            (program_side, FrameSplitter(dialect), from_program, autopilot_side),
            (autopilot_side, FrameSplitter(dialect), from_autopilot, program_side),
        ]
        self._start = time.monotonic()

    def run(self, until_s: float) -> None:
        """Pass on what comes, until an instant (s) from the start of the link, or the end of a TCP connection."""
        while (now_us := self._now_us()) < 1e6 * until_s:
            # Wait for bytes, for the next late frame, or for the end.
            next_us = min(1e6 * until_s, *(stream.next_us for _, _, stream, _ in self._ways))
            wait_s = min(_WAIT_S, max(0.0, 1e-6 * (next_us - now_us)))
            files = {way[0].fd: way for way in self._ways}
            ready, _, _ = select.select(list(files), [], [], wait_s)
            for file in ready:
                source, splitter, stream, destination = files[file]
                try:
                    with redirect_stdout(sys.stderr):  # pymavlink prints what happens to a connection
                        data = source.recv(_MOST_BYTES)
                except OSError:
                    data = b""
                if data == b"":  # a stream has ended; without data, pymavlink returns ""
                    return
                sent = []
                for piece in splitter.feed(data or b""):
                    if isinstance(piece, bytes):
                        sent.append(piece)
                    else:
                        sent += stream.passed(piece, self._now_us())
                # One write: what came in one datagram leaves in one.
                if sent:
                    destination.write(b"".join(sent))
            for _, _, stream, destination in self._ways:
                for late in stream.late(self._now_us()):
                    destination.write(late)

    def _now_us(self) -> int:
        return int(1e6 * (time.monotonic() - self._start))
