"""Frames as peers send them: packed by pymavlink, with random content."""

import random

from pymavlink.dialects.v20 import common

KINDS = [kind for kind in common.mavlink_map.values() if kind.id >= 0]
"""All messages of the dialect `common`."""


class Peer:
    """Sends messages with consecutive sequence numbers."""

    def __init__(self, system=1, *, is_signed=False, seed=0):
        self._link = common.MAVLink(None, srcSystem=system, srcComponent=1)
        self._random = random.Random(seed)
        if is_signed:
            self._link.signing.secret_key = bytes(32)
            self._link.signing.sign_outgoing = True

    def frame(self, kind, *, version=2):
        """A message of a kind; every other one of MAVLink 2 ends with zeros, which are left out."""
        size = kind.unpacker.size
        if version == 1:
            size = min(size, 255)
        filled = self._random.choice([size, self._random.randrange(size + 1)])
        content = self._random.randbytes(filled).ljust(size, b"\0")
        message = common.MAVLink_message(kind.id, kind.msgname)
        frame = message._pack(self._link, kind.crc_extra, content, force_mavlink1=version == 1)
        self._link.seq = (self._link.seq + 1) % 256
        return bytes(frame)


def received(data):
    """The messages that pymavlink's own parser finds in a stream, as the values of their fields."""
    link = common.MAVLink(None)  # raises MAVError for a wrong checksum
    return [
        (message.get_type(), message.get_seq(), {name: repr(getattr(message, name)) for name in message.fieldnames})
        for message in link.parse_buffer(data) or []
    ]
