"""PX4's simulator interface (HIL messages of MAVLink by TCP): the simulator's side, in lock-step.

The simulator listens on TCP 4560, sends HIL_SENSOR, and PX4 answers each with HIL_ACTUATOR_CONTROLS; the time in the
sensor message is PX4's clock.  Sources: PX4, `src/modules/simulation/simulator_mavlink`; MAVLink, `common.xml` and
"Serialization" (mavlink.io).

Checked against written frames only: no PX4 binary was run.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

PORT = 4560
"""TCP port of the simulator."""
LOCKSTEP = 1
"""Bit of `Controls.flags`: PX4 waits for the sensors."""
SENSORS_UPDATED = 0x1FFF
"""Field `fields_updated` of HIL_SENSOR: all of accelerometer, gyro, magnetometer, pressures, temperature."""
_V1, _V2, _SIGNED = 0xFE, 0xFD, 1
_HEAD = {_V1: 6, _V2: 10}
_SIGNATURE = 13
_SENSOR, _CONTROLS = 107, 93
_CRC_EXTRA = {_SENSOR: 108, _CONTROLS: 47}
"""Last byte of the checksum, which stands for the definition of a message."""
_SENSOR_FORM = struct.Struct("<Q13fI")
_CONTROLS_FORM = struct.Struct("<QQ16fB")


@dataclass(frozen=True, slots=True)
class Controls:
    """HIL_ACTUATOR_CONTROLS.

    Attributes:
        time_us: Time of the sensors that it answers.
        controls: Motors 0 to 1, surfaces -1 to 1. Length 16.
        mode: MAV_MODE flags; 128 = armed.
        flags: See `LOCKSTEP`.
    """

    time_us: int
    controls: tuple[float, ...]
    mode: int
    flags: int


def checksum(content: bytes) -> int:
    """CRC-16/MCRF4XX, as MAVLink wants it."""
    crc = 0xFFFF
    for byte in content:
        part = (byte ^ crc) & 0xFF
        part = (part ^ part << 4) & 0xFF
        crc = (crc >> 8 ^ part << 8 ^ part << 3 ^ part >> 4) & 0xFFFF
    return crc


def sensor(
    time_us: int, force: Sequence[float], rates: Sequence[float], field: Sequence[float], pressure_hpa: float,
    height_m: float, sequence: int,
) -> bytes:  # fmt: skip
    """A HIL_SENSOR frame (MAVLink 2), given in our body frame: x forward, y left, z up; PX4's is forward, right, down.

    Args:
        time_us: Time of the simulation.
        force: Specific force (m/s^2).
        rates: Body rates (rad/s).
        field: Magnetic field (gauss).
        pressure_hpa: Static pressure.
        height_m: Pressure altitude.
        sequence: Number of the frame, modulo 256.
    """
    turned = [value for vector in (force, rates, field) for value in (vector[0], -vector[1], -vector[2])]
    content = _SENSOR_FORM.pack(time_us, *turned, pressure_hpa, 0.0, height_m, 20.0, SENSORS_UPDATED)
    content = content.rstrip(b"\0") or b"\0"  # MAVLink 2 leaves out zeros at the end
    head = struct.pack("<BBBBBBBHB", _V2, len(content), 0, 0, sequence % 256, 1, 200, _SENSOR, 0)
    check = checksum(head[1:] + content + bytes([_CRC_EXTRA[_SENSOR]]))
    return head + content + check.to_bytes(2, "little")


class Stream:
    """Reads PX4's answers from a stream of bytes, whatever else is in it.

    Attributes:
        damaged: Number of answers with a wrong checksum.
        lost: Number of frames that are missing, by their sequence numbers.
        stale: Number of answers that came again, or late.
        restarts: How often PX4 has started anew.
    """

    def __init__(self) -> None:
        self.damaged, self.lost, self.stale, self.restarts = 0, 0, 0, 0
        self._buffer = b""
        self._sequence: int | None = None
        self._last_us = -1

    def feed(self, content: bytes) -> list[Controls]:
        """Answers that are complete with these bytes, in order; of each instant, only the first."""
        self._buffer += content
        found = []
        while (frame := self._next()) is not None:
            controls = self._read(frame)
            if controls is not None and self._is_new(controls):
                found.append(controls)
        return found

    def _next(self) -> bytes | None:
        """The next whole frame; bytes in front of it are skipped."""
        while self._buffer:
            start = self._buffer[0]
            if start not in _HEAD:
                self._buffer = self._buffer[1:]
                continue
            if len(self._buffer) < 3:
                return None
            signed = start == _V2 and self._buffer[2] & _SIGNED
            size = _HEAD[start] + self._buffer[1] + 2 + (_SIGNATURE if signed else 0)
            if len(self._buffer) < size:
                return None
            frame = self._buffer[:size]
            if self._is_whole(frame):
                self._buffer = self._buffer[size:]
                return frame
            self._buffer = self._buffer[1:]  # no frame begins here, or it is damaged
        return None

    def _is_whole(self, frame: bytes) -> bool:
        """Whether the checksum is right; unknown messages, whose definition is not known here, count as whole."""
        number, head = _number(frame), _HEAD[frame[0]]
        if number not in _CRC_EXTRA:
            return True
        end = head + frame[1]
        right = checksum(frame[1:end] + bytes([_CRC_EXTRA[number]])) == int.from_bytes(frame[end : end + 2], "little")
        self.damaged += not right
        return right

    def _read(self, frame: bytes) -> Controls | None:
        place = 4 if frame[0] == _V2 else 2
        if self._sequence is not None:
            self.lost += (frame[place] - self._sequence - 1) % 256
        self._sequence = frame[place]
        if _number(frame) != _CONTROLS:
            return None
        content = frame[_HEAD[frame[0]] :][: frame[1]].ljust(_CONTROLS_FORM.size, b"\0")[: _CONTROLS_FORM.size]
        time_us, flags, *controls, mode = _CONTROLS_FORM.unpack(content)
        return Controls(time_us, tuple(controls), mode, flags)

    def _is_new(self, controls: Controls) -> bool:
        """Whether it is the first answer of its instant; after a restart, time begins again."""
        if controls.time_us > self._last_us:
            self._last_us = controls.time_us
            return True
        self.stale += 1
        return False

    def restarted(self) -> None:
        """PX4 has connected again."""
        self.restarts += 1
        self._buffer, self._sequence, self._last_us = b"", None, -1


def _number(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little") if frame[0] == _V2 else frame[5]
