"""What the autopilot sends periodically: the content and rate of each message."""

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from mavfi.extras.mavlink.failures import FIX_3D
from mavfi.numerics.frames import Triple, euler
from mavfi.numerics.rotations import rotation_matrix

if TYPE_CHECKING:
    from mavfi.extras.mavlink.autopilot import Autopilot

Arguments = tuple[Any, ...]
_QUADROTOR = 2
_ACTIVE = 4
_STANDBY = 3
_DILUTION = 80  # of precision of the position, in 1/100
_SATELLITES = 12
_THROTTLE = 50  # %
_ALL_FIELDS = 0x1FFF  # of HIGHRES_IMU are updated
_ALL_ESTIMATES = 0x3FF  # of ESTIMATOR_STATUS are valid
_ARMED_FLAG = 128
"""MAV_MODE_FLAG_SAFETY_ARMED."""
_HEALTHY = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x4000 | 0x8000 | 0x10000 | 0x200000 | 0x10000000
"""MAV_SYS_STATUS_SENSOR: gyro, accelerometer, compass, pressure, GPS, controls, motors, receiver, AHRS, pre-arm."""
_SENSORS = {"gyro": 0x1, "accelerometer": 0x2, "compass": 0x4, "position": 0x20, "motor": 0x8000}
_ON_GROUND = 1
_IN_AIR = 2
_TAKING_OFF = 3
_LANDING = 4
_MILLIVOLTS = 16_000
_NO_VOLTAGE = 65_535
_EKF_GOOD = 831
_EKF_WITHOUT_POSITION = 1 | 2 | 4 | 32 | 128
"""Flags of EKF_STATUS_REPORT: all estimates; attitude, velocity and height, in constant-position mode."""
_ODOMETRY_FRAME = 1  # MAV_FRAME_LOCAL_NED
_ODOMETRY_CHILD_FRAME = 12  # MAV_FRAME_BODY_FRD
_ODOMETRY_ESTIMATOR = 7  # MAV_ESTIMATOR_TYPE_AUTOPILOT
_CHANNELS = 18
_NAN = float("nan")


def _heading(autopilot: "Autopilot") -> float:
    """Degrees clockwise from north, 0 to 360."""
    return math.degrees(autopilot.vehicle.yaw) % 360.0


def _above_sea(autopilot: "Autopilot") -> float:
    """Altitude above sea level (m)."""
    return autopilot.geography.origin[2] - autopilot.vehicle.position[2]


def _above_home(autopilot: "Autopilot") -> float:
    """Height above home (m)."""
    return autopilot.geography.home[2] - autopilot.vehicle.position[2]


def _scaled(autopilot: "Autopilot", ned: Triple) -> tuple[int, int, int]:
    """Latitude and longitude (1e-7 degrees) and altitude (mm) of a position (m)."""
    latitude, longitude, altitude = autopilot.geography.geodetic(ned)
    return round(1e7 * latitude), round(1e7 * longitude), round(1e3 * altitude)


def heartbeat(autopilot: "Autopilot") -> Arguments:
    """HEARTBEAT."""
    flags = autopilot.mode_flags
    armed = autopilot.vehicle.sim.armed
    if armed:
        flags |= _ARMED_FLAG
    state = _STANDBY
    if armed and not autopilot.vehicle.landed:
        state = _ACTIVE
    return _QUADROTOR, autopilot.kind, flags, autopilot.custom_mode, state


def sys_status(autopilot: "Autopilot") -> Arguments:
    """SYS_STATUS; sensors that are off are unhealthy, and so is GPS without a 3D fix."""
    failures = autopilot.failures
    unhealthy = {_SENSORS[unit] for unit in failures.units_off}
    if failures.fix_type < FIX_3D:
        unhealthy.add(_SENSORS["position"])
    voltage = _MILLIVOLTS
    if failures.battery_is_silent:
        voltage = _NO_VOLTAGE
    return _HEALTHY, _HEALTHY, _HEALTHY & ~sum(unhealthy), 300, voltage, -1, failures.charge, 0, 0, 0, 0, 0, 0


def home_position(autopilot: "Autopilot") -> Arguments:
    """HOME_POSITION."""
    level = [1.0, 0.0, 0.0, 0.0]
    home = autopilot.geography.home
    return *_scaled(autopilot, home), *home, level, 0.0, 0.0, 0.0, autopilot.vehicle.now_us


def extended_sys_state(autopilot: "Autopilot") -> Arguments:
    """EXTENDED_SYS_STATE."""
    if autopilot.vehicle.landed:
        landed_state = _ON_GROUND
    elif autopilot.is_taking_off:
        landed_state = _TAKING_OFF
    elif autopilot.is_landing:
        landed_state = _LANDING
    else:
        landed_state = _IN_AIR
    return 0, landed_state


def gps_raw_int(autopilot: "Autopilot") -> Arguments:
    """GPS_RAW_INT; without a fix while the position is off."""
    north, east, _ = autopilot.vehicle.velocity
    speed = min(65_534, round(100 * math.hypot(north, east)))
    course = round(100 * _heading(autopilot)) % 36_000
    return (
        autopilot.vehicle.now_us,
        autopilot.failures.fix_type,
        *_scaled(autopilot, autopilot.vehicle.position),
        _DILUTION,  # horizontal
        _DILUTION,  # vertical
        speed,
        course,
        _SATELLITES,
    )


def global_position_int(autopilot: "Autopilot") -> Arguments:
    """GLOBAL_POSITION_INT."""
    speeds = (max(-32_768, min(32_767, round(100 * value))) for value in autopilot.vehicle.velocity)
    above = round(1e3 * _above_home(autopilot))
    return (
        autopilot.ms,
        *_scaled(autopilot, autopilot.vehicle.position),
        above,
        *speeds,
        round(100 * _heading(autopilot)) % 36_000,
    )


def vfr_hud(autopilot: "Autopilot") -> Arguments:
    """VFR_HUD."""
    north, east, down = autopilot.vehicle.velocity
    speed = math.hypot(north, east)
    return speed, speed, round(_heading(autopilot)) % 360, _THROTTLE, _above_sea(autopilot), -down


def altitude(autopilot: "Autopilot") -> Arguments:
    """ALTITUDE."""
    above = _above_sea(autopilot)
    height = _above_home(autopilot)
    return autopilot.vehicle.now_us, above, above, -autopilot.vehicle.position[2], height, _NAN, 0.0


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
    field = (0.2, 0.0, 0.4)
    air = (1013.25, 0.0, _above_sea(autopilot), 25.0)
    return autopilot.vehicle.now_us, x, -y, -z, roll, -pitch, -yaw, *field, *air, _ALL_FIELDS


def battery_status(autopilot: "Autopilot") -> Arguments | None:
    """BATTERY_STATUS, constant unless the battery fails; None = it reports nothing."""
    failures = autopilot.failures
    if failures.battery_is_silent:
        return None
    cells = [_MILLIVOLTS, *[_NO_VOLTAGE] * 9]
    return 0, 0, 0, 2500, cells, -1, -1, -1, failures.charge, 0, failures.charge_state


def estimator_status(autopilot: "Autopilot") -> Arguments:
    """ESTIMATOR_STATUS: all estimates are valid."""
    return autopilot.vehicle.now_us, _ALL_ESTIMATES, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.2, 0.2


def system_time(autopilot: "Autopilot") -> Arguments:
    """SYSTEM_TIME."""
    return autopilot.vehicle.stamp // 1000, autopilot.ms


def mission_current(autopilot: "Autopilot") -> Arguments:
    """MISSION_CURRENT."""
    return autopilot.mission.status


def gps_global_origin(autopilot: "Autopilot") -> Arguments:
    """GPS_GLOBAL_ORIGIN."""
    return *_scaled(autopilot, (0.0, 0.0, 0.0)), autopilot.vehicle.now_us


def odometry(autopilot: "Autopilot") -> Arguments:
    """ODOMETRY; velocities along the body's axes, covariances unknown."""
    vehicle = autopilot.vehicle
    unknown = [_NAN, *[0.0] * 20]
    matrix = np.empty((3, 3))
    rotation_matrix(np.array(vehicle.orientation), matrix)
    velocity = [float(value) for value in matrix.T @ np.array(vehicle.velocity)]
    frames = (_ODOMETRY_FRAME, _ODOMETRY_CHILD_FRAME)
    state = (*vehicle.position, list(vehicle.orientation), *velocity, *vehicle.rates)
    return vehicle.now_us, *frames, *state, unknown, unknown, 0, _ODOMETRY_ESTIMATOR


def rc_channels(autopilot: "Autopilot") -> Arguments:
    """RC_CHANNELS: what RC_CHANNELS_OVERRIDE last set."""
    channels = autopilot.channels
    return autopilot.ms, len(channels), *channels, *[_NO_VOLTAGE] * (_CHANNELS - len(channels)), 255


def ekf_status_report(autopilot: "Autopilot") -> Arguments:
    """EKF_STATUS_REPORT; without a position while GPS has no 3D fix."""
    flags = _EKF_GOOD
    if autopilot.failures.fix_type < FIX_3D:
        flags = _EKF_WITHOUT_POSITION
    return flags, 0.1, 0.1, 0.1, 0.1, 0.0


Content = Callable[["Autopilot"], Arguments | None]
"""The fields of a message, which has the name of the function; None = it is not sent now."""
STREAMS: dict[Content, float] = {
    heartbeat: 1.0,
    sys_status: 1.0,
    home_position: 1.0,
    battery_status: 1.0,
    estimator_status: 1.0,
    system_time: 1.0,
    mission_current: 1.0,
    gps_global_origin: 0.0,
    rc_channels: 0.0,
    odometry: 0.0,
    extended_sys_state: 5.0,
    gps_raw_int: 5.0,
    global_position_int: 10.0,
    vfr_hud: 10.0,
    altitude: 10.0,
    attitude: 50.0,
    attitude_quaternion: 50.0,
    local_position_ned: 50.0,
    highres_imu: 50.0,
}
"""Messages and their rates at the start (Hz); 0 = only on request."""
ARDUPILOT_STREAMS: dict[Content, float] = {
    **STREAMS,
    rc_channels: 4.0,
    ekf_status_report: 4.0,
    altitude: 0.0,
    odometry: 0.0,
    estimator_status: 0.0,
    highres_imu: 0.0,
    attitude_quaternion: 0.0,
}
"""Messages of ArduCopter and their rates at the start (Hz); it has no messages of PX4's estimator."""
STREAM_GROUPS: dict[int, tuple[Content, ...]] = {
    1: (highres_imu, gps_raw_int),
    2: (sys_status, mission_current, gps_raw_int, battery_status),
    3: (rc_channels,),
    6: (global_position_int, local_position_ned),
    10: (attitude,),
    11: (vfr_hud,),
    12: (ekf_status_report, system_time, extended_sys_state),
}
"""MAV_DATA_STREAM: raw sensors, extended status, radio, position, extra 1 to 3."""
ALL_GROUPS = 0
_ON_REQUEST = -1


class Schedule:
    """Instants at which messages are due.

    Args:
        streams: The messages and their rates (Hz); 0 = only on request.
    """

    def __init__(self, streams: dict[Content, float]) -> None:
        self._streams = {message.__name__: message for message in streams}
        self._defaults: dict[str, int] = {}
        for message, rate in streams.items():
            interval = _ON_REQUEST
            if rate > 0.0:
                interval = round(1e6 / rate)
            self._defaults[message.__name__] = interval
        self._intervals = dict(self._defaults)
        self._due: dict[str, int] = {}
        self._requested: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self._streams

    def request(self, name: str) -> None:
        """Make a message due at once."""
        self._requested.add(name)

    def interval_us(self, name: str) -> int:
        """Time between two messages (us); -1 = only on request, 0 = there is no such message."""
        return self._intervals.get(name, 0)

    def set_interval(self, name: str, interval_us: int) -> None:
        """Set the time between two messages (us); 0 = the default, negative = only on request."""
        if interval_us == 0:
            interval_us = self._defaults[name]
        self._intervals[name] = max(interval_us, _ON_REQUEST)
        self._due.pop(name, None)

    def due(self, now_us: int) -> Iterator[Content]:
        """Messages to send now."""
        for name, message in self._streams.items():
            interval = self._intervals[name]
            if name in self._requested or (interval > 0 and now_us >= self._due.get(name, 0)):
                self._requested.discard(name)
                self._due[name] = now_us + max(interval, 0)
                yield message
