"""PX4's simulator interface (HIL messages of MAVLink by TCP): the simulator's side, in lock-step.

The simulator listens on TCP 4560, sends HIL_SENSOR, and PX4 answers each with HIL_ACTUATOR_CONTROLS; the time in the
sensor message is PX4's clock.  Source: PX4, `src/modules/simulation/simulator_mavlink`.  Frames are written and read by
pymavlink (extra `mavlink`).

Checked against written frames only: no PX4 binary was run.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mavfi.errors import BadInputError

PORT = 4560
"""TCP port of the simulator."""
LOCKSTEP = 1
"""Bit of `Controls.flags`: PX4 waits for the sensors."""
SENSORS_UPDATED = 0x1FFF
"""Field `fields_updated` of HIL_SENSOR: all of accelerometer, gyro, magnetometer, pressures, temperature."""
_SYSTEM, _COMPONENT = 1, 200
_MAVLINK_2 = 0xFD
"""First byte of a frame of MAVLink 2."""
_TEMPERATURE = 20.0


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


def _link() -> Any:
    """A MAVLink 2 connection, which skips bytes that are no frame."""
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        raise BadInputError("px4: needs pymavlink; allowed: pip install 'mavfi[mavlink]'") from None
    link = common.MAVLink(None, srcSystem=_SYSTEM, srcComponent=_COMPONENT)
    link.robust_parsing = True
    return link


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

    Raises:
        BadInputError: pymavlink is not installed.
    """
    link = _link()
    link.seq = sequence % 256
    turned = [value for vector in (force, rates, field) for value in (vector[0], -vector[1], -vector[2])]
    message = link.hil_sensor_encode(time_us, *turned, pressure_hpa, 0.0, height_m, _TEMPERATURE, SENSORS_UPDATED)
    return bytes(message.pack(link))


class Stream:
    """Reads PX4's answers from a stream of bytes, which may contain other messages.

    Attributes:
        damaged: Number of pieces that are no frame, or a frame with a wrong checksum.
        lost: Number of missing frames, by their sequence numbers.
        stale: Number of answers that were repeated, or late.
        restarts: Number of times that PX4 restarted.

    Raises:
        BadInputError: pymavlink is not installed.
    """

    def __init__(self) -> None:
        self.damaged, self.lost, self.stale, self.restarts = 0, 0, 0, 0
        self._connect()

    def _connect(self) -> None:
        self._link = _link()
        self._sequence: int | None = None
        self._last_us = -1

    def feed(self, content: bytes) -> list[Controls]:
        """Answers that are complete with these bytes, in order; of each instant, only the first."""
        found = map(self._read, self._link.parse_buffer(content) or ())
        return [controls for controls in found if controls is not None]

    def _read(self, message: Any) -> Controls | None:  # noqa: ANN401
        """The answer in a message; None = it is another message, stale or damaged."""
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.damaged += 1
            return None
        frame = message.get_msgbuf()
        sequence = frame[4 if frame[0] == _MAVLINK_2 else 2]  # also of unknown messages, where `get_seq` is 0
        if self._sequence is not None:
            self.lost += (sequence - self._sequence - 1) % 256
        self._sequence = sequence
        if kind != "HIL_ACTUATOR_CONTROLS":
            return None
        if message.time_usec <= self._last_us:
            self.stale += 1
            return None
        self._last_us = message.time_usec
        return Controls(message.time_usec, tuple(message.controls), message.mode, message.flags)

    def restarted(self) -> None:
        """PX4 has connected again: its time and its frames' numbers start from the beginning."""
        self.restarts += 1
        self._connect()
