"""Betaflight 4.6's simulator target (SITL): packets, frames, and its configuration by MSP.

Sources: Betaflight, `src/platform/SIMULATOR/sitl.c` and `target.h` (packets), `src/main/msp/msp_protocol.h` (codes),
`src/main/msp/msp.c` (layouts).  World: x east, y north, z up; body: x forward, y left, z up.
"""

import math
import socket
import struct
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from mavfi.errors import MavfiError
from mavfi.extras.firmware.process import FIRST_NS, Firmware
from mavfi.extras.shared.frames import HOME
from mavfi.sim.engine import GRAVITY

EEPROM = "eeprom.bin"
"""File of the configuration, in the working directory."""
PERIOD_NS = 1_000_000
"""Period of the exchange with the simulator in flight (ns)."""
BOOT_PERIOD_NS = 10_000_000
"""Period of the exchange before the flight (ns)."""
CHANNELS = 16
"""Number of RC channels in a packet."""
CENTRE = 1500
"""Value of an RC channel in the middle (us)."""
LOW = 1000
"""Smallest value of an RC channel (us)."""
HIGH = 2000
"""Largest value of an RC channel (us)."""
DISARMED = (CENTRE, CENTRE, LOW, CENTRE, *(LOW,) * (CHANNELS - 4))
"""Sticks in the middle, throttle and switches down: roll, pitch, throttle, yaw, auxiliary 1 to 12."""
ARMED = (CENTRE, CENTRE, LOW, CENTRE, HIGH, *(LOW,) * (CHANNELS - 5))
"""As `DISARMED`, with the arm switch, auxiliary 1, up."""
RC_FROM_NS = 3_000_000_000
"""Time from the start until RC is sent (ns); earlier packets are ignored."""
ARM_FROM_NS = 6_000_000_000
"""Time from the start until the arm switch is up (ns)."""
ARMED_BY_NS = 10_000_000_000
"""Time from the start by which the rotors must turn (ns)."""
ANGLE_LIMIT = math.radians(60.0)
"""Roll and pitch angle at full stick, Betaflight's default (rad)."""
YAW_RATE = math.radians(120.0)
"""Yaw rate at full stick, as configured (rad/s)."""
ATTITUDE_GAIN = 120
"""Gain of the attitude loop, in units of 0.1 /s: 12 /s, close to our own loop's 10 /s; Betaflight's default is 50."""
YAW_GAINS = bytes((200, 40))
"""Proportional and integral gain of the yaw rate.  With the defaults, 45 and 80, it oscillates at 1.3 Hz on our
airframe, whose rotors give little torque."""

_PACKETS = struct.Struct("<Q18dd16H")
"""What is sent in a period: whether there is an RC packet, the simulator's packet, and the RC packet."""
_SEA_LEVEL_PA = 101_325.0
"""Air pressure at sea level (Pa)."""

# Codes of MSP messages, from `msp_protocol.h`.
_SET_MODE_RANGE = 35
_RC_TUNING = 111
_SET_RC_TUNING = 204
_PID = 112
_SET_PID = 202
_EEPROM_WRITE = 250
_API_VERSION = 1
_FC_VARIANT = 2
_FC_VERSION = 3

_ARM = 0
"""Number of the mode in which rotors turn."""
_ANGLE = 1
"""Number of the mode in which sticks command angles."""
_HEAD = 5
"""Bytes of an MSP answer in front of its content."""
_MSP_WALL_S = 4.0
"""Time limit of an answer on the serial port."""
_ATTEMPTS = 5
"""Number of starts.  A race of its threads at boot may cost the firmware the port that it has just opened; then it is
started again."""


def packets(now_ns: int, state: Sequence[float], channels: Sequence[int] | None) -> bytes:
    """The packets for the next period.

    Args:
        now_ns: Virtual time.
        state: See `state_of`. Length 17.
        channels: RC channels (us), length 16; None = no new RC packet.
    """
    seconds = 1e-9 * now_ns
    return _PACKETS.pack(channels is not None, seconds, *state, seconds, *(channels or DISARMED))


def state_of(
    position: np.ndarray, quaternion: np.ndarray, velocity: np.ndarray, rates: np.ndarray, force: np.ndarray
) -> tuple[float, ...]:
    """The body's state as the firmware expects it.

    It takes the rates with y to the right and z down, the negative specific force, and the attitude with y and z
    mirrored: any other choice inverts pitch.

    Args:
        position: World frame (m). Shape (3,).
        quaternion: Body to world, w x y z. Shape (4,).
        velocity: World frame (m/s). Shape (3,).
        rates: Body frame (rad/s). Shape (3,).
        force: Specific force, body frame (m/s^2). Shape (3,).
    """
    w, x, y, z = quaternion.tolist()
    p, q, r = rates.tolist()
    ax, ay, az = force.tolist()
    height = float(position[2])
    (latitude, longitude, _) = HOME
    pressure = _SEA_LEVEL_PA * max(0.0, 1.0 - 2.25577e-5 * height) ** 5.25588  # ISA, ICAO Doc 7488
    return (p, -q, -r, -ax, -ay, -az, w, x, -y, -z, *velocity.tolist(), longitude, latitude, height, pressure)


def channels(roll: float, pitch: float, throttle: float, yaw_rate: float) -> list[int]:
    """RC channels of an armed vehicle; each value saturates at full stick.

    Args:
        roll: To the right (rad).
        pitch: Nose down (rad).
        throttle: 0 to 1.
        yaw_rate: Counter-clockwise from above (rad/s).
    """
    return [
        _stick(roll / ANGLE_LIMIT),
        _stick(pitch / ANGLE_LIMIT),
        LOW + round((HIGH - LOW) * min(1.0, max(0.0, throttle))),
        _stick(-yaw_rate / YAW_RATE),
        *ARMED[4:],
    ]


def _stick(share: float) -> int:
    """Value of a channel for a share of full stick."""
    return CENTRE + round((HIGH - CENTRE) * min(1.0, max(-1.0, share)))


AT_REST = state_of(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, GRAVITY]))
"""State of a vehicle that stands level."""


def message(code: int, data: bytes = b"") -> bytes:
    """An MSP request (version 1)."""
    body = bytes([len(data), code]) + data
    return b"$M<" + body + bytes([reduce(xor, body)])


def reply(buffer: bytes, code: int) -> bytes | None:
    """The content of the reply to a request at the start of a buffer; None = not complete yet.

    Raises:
        MavfiError: The firmware refused the request, or this is no reply to it.
    """
    if len(buffer) < _HEAD or len(buffer) < _HEAD + 1 + buffer[3]:
        return None
    check = reduce(xor, buffer[3 : _HEAD + buffer[3] + 1])
    if buffer[:3] != b"$M>" or buffer[4] != code or check:
        raise MavfiError(f"the firmware refused the MSP request {code} ({buffer[:_HEAD].hex()})")
    return buffer[_HEAD : _HEAD + buffer[3]]


class _SilentError(MavfiError):
    """No answer on the serial port."""


class _Console:
    """Its serial port, while it runs in lock-step with a vehicle at rest."""

    def __init__(self, firmware: Firmware, connection: socket.socket) -> None:
        self._firmware = firmware
        self._connection = connection
        firmware.wait()

    def ask(self, code: int, data: bytes = b"") -> bytes:
        """Send a request, and run until the reply is complete."""
        self._connection.sendall(message(code, data))
        buffer = b""
        end = time.monotonic() + _MSP_WALL_S
        while time.monotonic() < end:
            with suppress(BlockingIOError):
                buffer += self._connection.recv(4096)
                content = reply(buffer, code)
                if content is not None:
                    return content
            self._firmware.run(packets(self._firmware.now_ns, AT_REST, None), PERIOD_NS)
        raise _SilentError(f"the firmware did not answer the MSP request {code} within {_MSP_WALL_S:g} s")


def configure(program: Path, shim: Path) -> tuple[str, bytes]:
    """Configure a firmware for `channels`: switches for arming and angle mode, linear rates, attitude gain.

    Returns:
        Name and version, e.g. "BTFL 4.6.0", and its configuration, the content of `EEPROM`.

    Raises:
        MavfiError: The firmware ended, or does not answer.
    """
    for _ in range(_ATTEMPTS - 1):
        with suppress(_SilentError):
            return _configure(program, shim)
    return _configure(program, shim)


def _configure(program: Path, shim: Path) -> tuple[str, bytes]:
    """One attempt of `configure`."""
    with tempfile.TemporaryDirectory(prefix="mavfi-msp-") as folder, socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(Path(folder) / "msp"))
        listener.listen()
        listener.setblocking(False)
        with closing(Firmware(program, shim, {}, listener)) as firmware, socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(Path(folder) / "msp"))
            connection.setblocking(False)
            console = _Console(firmware, connection)
            version = ".".join(str(number) for number in console.ask(_FC_VERSION)[:3])
            name = console.ask(_FC_VARIANT).decode("ascii", "replace")
            _write_configuration(console)
            return f"{name} {version}", (firmware.folder / EEPROM).read_bytes()


def _write_configuration(console: _Console) -> None:
    """Write the configuration; indices as in `MSP_RC_TUNING` and `MSP_PID`."""
    console.ask(_SET_MODE_RANGE, bytes([0, _ARM, 0, 32, 48]))  # auxiliary 1 from 1700 us on; steps of 25 us from 900
    console.ask(_SET_MODE_RANGE, bytes([1, _ANGLE, 1, 0, 48]))  # auxiliary 2: always
    tuning = bytearray(console.ask(_RC_TUNING))
    # roll, pitch: 360 deg/s; yaw: YAW_RATE; no expo, so that rates are linear (units of 10 deg/s)
    yaw = round(math.degrees(YAW_RATE) / 10.0)
    for index, value in ((0, 36), (1, 0), (2, 36), (3, 36), (4, yaw), (10, 0), (11, yaw), (12, 36), (13, 0)):
        tuning[index] = value
    console.ask(_SET_RC_TUNING, bytes(tuning))
    gains = bytearray(console.ask(_PID))
    gains[6:8] = YAW_GAINS  # P and I of the third loop
    gains[9] = ATTITUDE_GAIN  # P of the fourth one, "level"
    console.ask(_SET_PID, bytes(gains))
    console.ask(_EEPROM_WRITE)


def arm(firmware: Firmware, state: Sequence[float]) -> None:
    """Let a firmware that has just been started boot and arm, until the rotors turn; the vehicle is held in a state.

    Raises:
        MavfiError: It ended, or does not arm.
    """
    firmware.wait()
    while not max(firmware.motors) > 0.0:
        since = firmware.now_ns - FIRST_NS
        if since > ARMED_BY_NS:
            raise MavfiError(f"the firmware does not arm within {1e-9 * ARMED_BY_NS:g} s of its time")
        rc = None
        if since >= ARM_FROM_NS:
            rc = ARMED
        elif since >= RC_FROM_NS:
            rc = DISARMED
        firmware.run(packets(firmware.now_ns, state, rc), BOOT_PERIOD_NS)
