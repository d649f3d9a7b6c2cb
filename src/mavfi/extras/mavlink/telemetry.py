"""Messages that the autopilot sends periodically, with their rates."""

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from mavfi.numerics.frames import HOME, Triple, euler, geodetic

if TYPE_CHECKING:
    from mavfi.extras.mavlink.autopilot import Autopilot

Arguments = tuple[Any, ...]
_QUADROTOR, _PX4 = 2, 12
_ACTIVE, _STANDBY = 4, 3
_MODE_FLAGS, _ARMED_FLAG = 1 | 4 | 8 | 16, 128
"""MAV_MODE_FLAG: custom mode, auto, guided, stabilize; safety armed."""
_HEALTHY = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x4000 | 0x8000 | 0x10000 | 0x200000 | 0x10000000
"""MAV_SYS_STATUS_SENSOR: gyro, accelerometer, compass, pressure, GPS, controls, motors, receiver, AHRS, pre-arm."""
_SENSORS = {"gyro": 0x1, "accelerometer": 0x2, "compass": 0x4, "position": 0x20, "motor": 0x8000}
_ON_GROUND, _IN_AIR, _TAKING_OFF, _LANDING = 1, 2, 3, 4
_FIX_3D, _NO_FIX = 3, 1
_CENTIVOLTS, _PERCENT = 16_000, 90
_NAN = float("nan")


def _heading(autopilot: "Autopilot") -> float:
    """Degrees clockwise from north, 0 to 360."""
    return math.degrees(autopilot.vehicle.yaw) % 360.0


def _above_sea(autopilot: "Autopilot") -> float:
    """Altitude above sea level (m)."""
    return HOME[2] - autopilot.vehicle.position[2]


def _scaled(ned: Triple) -> tuple[int, int, int]:
    """Latitude and longitude (1e-7 degrees) and altitude (mm) of a position (m)."""
    latitude, longitude, altitude = geodetic(ned)
    return round(1e7 * latitude), round(1e7 * longitude), round(1e3 * altitude)


def heartbeat(autopilot: "Autopilot") -> Arguments:
    """HEARTBEAT."""
    main, sub = autopilot.mode.value
    armed = autopilot.vehicle.sim.armed
    state = _ACTIVE if armed and not autopilot.vehicle.landed else _STANDBY
    return _QUADROTOR, _PX4, _MODE_FLAGS | (_ARMED_FLAG if armed else 0), main << 16 | sub << 24, state


def sys_status(autopilot: "Autopilot") -> Arguments:
    """SYS_STATUS; sensors that are off are unhealthy."""
    off = sum({_SENSORS[failure.fault.unit] for failure in autopilot.failures if failure.fault.kind == "off"})
    return _HEALTHY, _HEALTHY, _HEALTHY & ~off, 300, _CENTIVOLTS, -1, _PERCENT, 0, 0, 0, 0, 0, 0


def home_position(autopilot: "Autopilot") -> Arguments:
    """HOME_POSITION."""
    level = [1.0, 0.0, 0.0, 0.0]
    return *_scaled((0.0, 0.0, 0.0)), 0.0, 0.0, 0.0, level, 0.0, 0.0, 0.0, autopilot.vehicle.now_us


def extended_sys_state(autopilot: "Autopilot") -> Arguments:
    """EXTENDED_SYS_STATE."""
    name = autopilot.mode.name
    moving = _TAKING_OFF if name == "TAKEOFF" else _LANDING if name == "LAND" else _IN_AIR
    return 0, _ON_GROUND if autopilot.vehicle.landed else moving


def gps_raw_int(autopilot: "Autopilot") -> Arguments:
    """GPS_RAW_INT; without a fix while the position is off."""
    lost = any(failure.fault.unit == "position" and failure.fault.kind == "off" for failure in autopilot.failures)
    north, east, _ = autopilot.vehicle.velocity
    speed = min(65_534, round(100 * math.hypot(north, east)))
    course = round(100 * _heading(autopilot)) % 36_000
    return (
        autopilot.vehicle.now_us,
        _NO_FIX if lost else _FIX_3D,
        *_scaled(autopilot.vehicle.position),
        80,
        80,
        speed,
        course,
        12,
    )


def global_position_int(autopilot: "Autopilot") -> Arguments:
    """GLOBAL_POSITION_INT."""
    speeds = (max(-32_768, min(32_767, round(100 * value))) for value in autopilot.vehicle.velocity)
    above = round(-1e3 * autopilot.vehicle.position[2])
    return autopilot.ms, *_scaled(autopilot.vehicle.position), above, *speeds, round(100 * _heading(autopilot)) % 36_000


def vfr_hud(autopilot: "Autopilot") -> Arguments:
    """VFR_HUD."""
    north, east, down = autopilot.vehicle.velocity
    speed = math.hypot(north, east)
    return speed, speed, round(_heading(autopilot)) % 360, 50, _above_sea(autopilot), -down


def altitude(autopilot: "Autopilot") -> Arguments:
    """ALTITUDE."""
    above, height = _above_sea(autopilot), -autopilot.vehicle.position[2]
    return autopilot.vehicle.now_us, above, above, height, height, _NAN, 0.0


def attitude(autopilot: "Autopilot") -> Arguments:
    """ATTITUDE."""
    return autopilot.ms, *euler(autopilot.vehicle.orientation), *autopilot.vehicle.rates


def attitude_quaternion(autopilot: "Autopilot") -> Arguments:
    """ATTITUDE_QUATERNION."""
    return autopilot.ms, *autopilot.vehicle.orientation, *autopilot.vehicle.rates


def local_position_ned(autopilot: "Autopilot") -> Arguments:
    """LOCAL_POSITION_NED."""
    return autopilot.ms, *autopilot.vehicle.position, *autopilot.vehicle.velocity


def highres_imu(autopilot: "Autopilot") -> Arguments:
    """HIGHRES_IMU; constant magnetic field and pressure."""
    x, y, z, roll, pitch, yaw = map(float, autopilot.vehicle.imu())
    field, air = (0.2, 0.0, 0.4), (1013.25, 0.0, _above_sea(autopilot), 25.0)
    return autopilot.vehicle.now_us, x, -y, -z, roll, -pitch, -yaw, *field, *air, 0x1FFF


def battery_status(autopilot: "Autopilot") -> Arguments:
    """BATTERY_STATUS, constant."""
    del autopilot
    return 0, 0, 0, 2500, [_CENTIVOLTS, *[65_535] * 9], -1, -1, -1, _PERCENT


def estimator_status(autopilot: "Autopilot") -> Arguments:
    """ESTIMATOR_STATUS: all estimates are valid."""
    return autopilot.vehicle.now_us, 0x3FF, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.2, 0.2


def system_time(autopilot: "Autopilot") -> Arguments:
    """SYSTEM_TIME."""
    return autopilot.vehicle.stamp // 1000, autopilot.ms


STREAMS: tuple[tuple[float, Callable[["Autopilot"], Arguments]], ...] = (
    (1.0, heartbeat), (1.0, sys_status), (1.0, home_position), (1.0, battery_status), (1.0, estimator_status),
    (1.0, system_time), (5.0, extended_sys_state), (5.0, gps_raw_int), (10.0, global_position_int), (10.0, vfr_hud),
    (10.0, altitude), (50.0, attitude), (50.0, attitude_quaternion), (50.0, local_position_ned), (50.0, highres_imu),
)  # fmt: skip
"""Rate (Hz) and content of each message, which has the name of its function."""


class Schedule:
    """Instants at which messages are due."""

    def __init__(self) -> None:
        self._due: dict[str, int] = {}

    def request(self, name: str) -> None:
        """Make a message due at once."""
        self._due[name] = 0

    def due(self, now_us: int) -> Iterator[Callable[["Autopilot"], Arguments]]:
        """Messages to send now."""
        for rate, message in STREAMS:
            if now_us >= self._due.get(message.__name__, 0):
                self._due[message.__name__] = now_us + round(1e6 / rate)
                yield message
