"""ArduPilot's JSON interface of SITL (`--model JSON:127.0.0.1`): the simulator's side, in lock-step.

ArduPilot sends servo outputs by UDP, and waits for one line of JSON with the body's state; after one second without an
answer it repeats the frame.  Source: ArduPilot, `libraries/SITL/SIM_JSON.h` and `examples/JSON/readme.md`.

Checked against written frames only: no ArduPilot binary was run.
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from mavfi.errors import BadInputError

PORT = 9002
"""UDP port of the simulator."""
_OUTPUTS = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}
"""Layout by magic number: 16 or 32 channels."""


@dataclass(frozen=True, slots=True)
class Servos:
    """One frame of servo outputs: requested rate (Hz), its number since the start of ArduPilot, pulses (us)."""

    rate_hz: int
    count: int
    pulses_us: tuple[int, ...]


def servos(datagram: bytes) -> Servos:
    """Read a datagram.

    Raises:
        BadInputError: It is not from ArduPilot.
    """
    magic = int.from_bytes(datagram[:2], "little")
    layout = _OUTPUTS.get(magic)
    if layout is None or len(datagram) != layout.size:
        allowed = ", ".join(f"{number} with {kind.size} bytes" for number, kind in _OUTPUTS.items())
        raise BadInputError(f"ArduPilot: datagram with magic {magic}, {len(datagram)} bytes: allowed: {allowed}")
    _, rate, count, *pulses = layout.unpack(datagram)
    return Servos(rate, count, tuple(pulses))


def state(
    time_s: float, rates: Sequence[float], force: Sequence[float], position: Sequence[float],
    quaternion: Sequence[float], velocity: Sequence[float],
) -> bytes:  # fmt: skip
    """The answer to a frame, given in our frames: world x y z with z up, body x forward, y left, z up.

    ArduPilot's are north, east, down and forward, right, down: both are ours, turned by pi about x.

    Args:
        time_s: Time of the simulation; in lock-step it is ArduPilot's clock.
        rates: Body rates (rad/s).
        force: Specific force, body frame (m/s^2).
        position: World frame (m).
        quaternion: Body to world, w x y z.
        velocity: World frame (m/s).
    """
    w, x, y, z = quaternion
    fields = {
        "timestamp": time_s, "imu": {"gyro": _turned(rates), "accel_body": _turned(force)},
        "position": _turned(position), "quaternion": [w, x, -y, -z], "velocity": _turned(velocity),
    }  # fmt: skip
    return b"\n" + json.dumps(fields, allow_nan=False).encode() + b"\n"


def _turned(vector: Sequence[float]) -> list[float]:
    return [vector[0], -vector[1], -vector[2]]


class Frames:
    """Checks the numbers of frames for loss, repetition and restarts.

    Attributes:
        lost: Number of missing frames.
        repeated: Number of repeated frames.
        restarts: Number of times that ArduPilot restarted.
    """

    def __init__(self) -> None:
        self.lost, self.repeated, self.restarts = 0, 0, 0
        self._last: int | None = None

    def is_new(self, count: int) -> bool:
        """Whether the simulation advances for a frame; a repeated one gets the same answer again."""
        last, self._last = self._last, count
        if last is None or count == last + 1:
            return True
        if count == last:
            self.repeated += 1
            return False
        if count < last:
            self.restarts += 1
        else:
            self.lost += count - last - 1
        return True
