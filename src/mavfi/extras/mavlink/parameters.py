"""Parameters that clients read and set: PX4's and ArduCopter's common ones with their defaults, and any that they set.

A value that is an `int` is sent as an integer.  PX4 sends the bits of an integer in place of those of a float
("byte-wise"), ArduPilot its value as a float ("C cast"), see https://mavlink.io/en/services/parameter.html.
"""

import math
import struct
from collections.abc import Callable
from enum import IntEnum
from typing import Any

Number = float | int

PX4_DEFAULTS: dict[str, Number] = {
    # of the airframe and the system
    "SYS_AUTOSTART": 4001,
    "SYS_AUTOCONFIG": 0,
    "SYS_HITL": 0,
    "SYS_HAS_BARO": 1,
    "SYS_HAS_GPS": 1,
    "SYS_HAS_MAG": 1,
    "SYS_FAILURE_EN": 1,  # PX4: 0
    "SYS_FAIL_GPS_WRG": 2,
    "MAVFI_GPS_WRONG": 0,  # not PX4's: see failures.py
    "MAV_SYS_ID": 1,
    "MAV_COMP_ID": 1,
    "MAV_TYPE": 2,
    "MAV_PROTO_VER": 0,
    "CA_AIRFRAME": 0,
    "CA_ROTOR_COUNT": 4,
    "CA_FAILURE_MODE": 0,
    # commander: links, failsafes, arming
    "COM_ARM_WO_GPS": 1,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_HOME_EN": 1,
    "COM_LOW_BAT_ACT": 0,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 4,  # PX4: 3
    "COM_RC_LOSS_T": 0.5,
    "COM_TAKEOFF_ACT": 0,
    "CBRK_FLIGHTTERM": 121_212,
    "CBRK_SUPPLY_CHK": 0,
    "CBRK_USB_CHK": 0,
    "FD_FAIL_P": 60,
    "FD_FAIL_R": 60,
    "NAV_ACC_RAD": 2.0,
    "NAV_DLL_ACT": 0,
    "NAV_LOITER_RAD": 80.0,
    "NAV_MC_ALT_RAD": 0.8,
    "NAV_RCL_ACT": 2,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    # missions and return; RTL_RETURN_ALT, RTL_DESCEND_ALT and NAV_ACC_RAD are those of multicopters (rc.mc_defaults)
    "MIS_TAKEOFF_ALT": 2.5,
    "MIS_DIST_1WP": 10_000.0,
    "MIS_YAW_ERR": 12.0,
    "MIS_YAW_TMT": -1.0,
    "RTL_RETURN_ALT": 30.0,
    "RTL_DESCEND_ALT": 10.0,
    "RTL_LAND_DELAY": 0.0,
    "RTL_MIN_DIST": 10.0,
    "RTL_CONE_ANG": 45,
    "RTL_TYPE": 0,
    # position control
    "MPC_ACC_HOR": 3.0,
    "MPC_ACC_HOR_MAX": 5.0,
    "MPC_ACC_UP_MAX": 4.0,
    "MPC_ACC_DOWN_MAX": 3.0,
    "MPC_JERK_AUTO": 4.0,
    "MPC_JERK_MAX": 8.0,
    "MPC_LAND_ALT1": 10.0,
    "MPC_LAND_ALT2": 5.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_MAN_TILT_MAX": 35.0,
    "MPC_MAN_Y_MAX": 150.0,
    "MPC_POS_MODE": 4,
    "MPC_THR_HOVER": 0.5,
    "MPC_THR_MAX": 1.0,
    "MPC_THR_MIN": 0.12,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TILTMAX_LND": 12.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_VEL_MANUAL": 10.0,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_D_ACC": 0.2,
    "MPC_XY_VEL_I_ACC": 0.4,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_YAW_MODE": 0,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_D_ACC": 0.0,
    "MPC_Z_VEL_I_ACC": 2.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_P_ACC": 4.0,
    # attitude and rate control
    "MC_AIRMODE": 0,
    "MC_ROLL_P": 6.5,
    "MC_PITCH_P": 6.5,
    "MC_YAW_P": 2.8,
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLLRATE_I": 0.2,
    "MC_ROLLRATE_D": 0.003,
    "MC_ROLLRATE_MAX": 220.0,
    "MC_PITCHRATE_P": 0.15,
    "MC_PITCHRATE_I": 0.2,
    "MC_PITCHRATE_D": 0.003,
    "MC_PITCHRATE_MAX": 220.0,
    "MC_YAWRATE_P": 0.2,
    "MC_YAWRATE_I": 0.1,
    "MC_YAWRATE_D": 0.0,
    "MC_YAWRATE_MAX": 200.0,
    # battery, estimator, log
    "BAT1_A_PER_V": -1.0,
    "BAT1_CAPACITY": -1.0,
    "BAT1_N_CELLS": 4,
    "BAT1_SOURCE": 0,
    "BAT1_V_DIV": -1.0,
    "BAT1_V_CHARGED": 4.05,
    "BAT1_V_EMPTY": 3.6,
    "BAT_LOW_THR": 0.15,
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "EKF2_HGT_REF": 1,
    "EKF2_GPS_CTRL": 7,
    "SDLOG_MODE": 0,
    "SDLOG_PROFILE": 1,
}
"""PX4's defaults of a multicopter (https://docs.px4.io/main/en/advanced_config/parameter_reference.html)."""

ARDUCOPTER_DEFAULTS: dict[str, Number] = {
    "SYSID_THISMAV": 1,
    "SYSID_MYGCS": 255,
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 1,
    "ARMING_CHECK": 1,
    "ARMING_REQUIRE": 1,
    "DISARM_DELAY": 10,
    "AHRS_EKF_TYPE": 3,
    "AHRS_ORIENTATION": 0,
    "EK3_ENABLE": 1,
    "ANGLE_MAX": 3000,
    "ATC_RAT_RLL_P": 0.135,
    "ATC_RAT_RLL_I": 0.135,
    "ATC_RAT_RLL_D": 0.0036,
    "ATC_RAT_PIT_P": 0.135,
    "ATC_RAT_PIT_I": 0.135,
    "ATC_RAT_PIT_D": 0.0036,
    "ATC_RAT_YAW_P": 0.18,
    "ATC_RAT_YAW_I": 0.018,
    "BATT_CAPACITY": 3300,
    "BATT_MONITOR": 4,
    "CIRCLE_RADIUS": 1000.0,
    "CIRCLE_RATE": 20.0,
    "COMPASS_USE": 1,
    "FENCE_ACTION": 1,
    "FENCE_ALT_MAX": 100.0,
    "FENCE_ENABLE": 0,
    "FENCE_RADIUS": 300.0,
    "FLTMODE1": 7,
    "FLTMODE2": 9,
    "FLTMODE3": 6,
    "FLTMODE4": 3,
    "FLTMODE5": 5,
    "FLTMODE6": 0,
    "FS_EKF_ACTION": 1,
    "FS_EKF_THRESH": 0.8,
    "FS_GCS_ENABLE": 0,
    "FS_THR_ENABLE": 1,
    "GPS_TYPE": 1,
    "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0,
    "LAND_SPEED": 50,
    "LOG_BITMASK": 176_126,
    "LOIT_SPEED": 1250.0,
    "PILOT_SPEED_UP": 250,
    "PILOT_TKOFF_ALT": 0.0,
    "PSC_POSXY_P": 1.0,
    "RTL_ALT": 1500,
    "RTL_ALT_FINAL": 0,
    "RTL_LOIT_TIME": 5000,
    "RTL_SPEED": 0,
    "SYS_FAILURE_EN": 1,  # not ArduPilot's: see failures.py
    "SYS_FAIL_GPS_WRG": 2,
    "MAVFI_GPS_WRONG": 0,
    "THR_MID": 500,  # of Copter 3.3, which examples of DroneKit read
    "THR_MIN": 130,
    "WP_YAW_BEHAVIOR": 2,
    "WPNAV_ACCEL": 250.0,
    "WPNAV_RADIUS": 200.0,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0,
}
"""ArduCopter's defaults (https://ardupilot.org/copter/docs/parameters.html); speeds in cm/s, heights in cm."""


class ParameterType(IntEnum):
    """MAV_PARAM_TYPE of the values that this autopilot sends."""

    INT32 = 6
    REAL32 = 9


class ParameterError(IntEnum):
    """MAV_PARAM_ERROR."""

    DOES_NOT_EXIST = 1
    OUT_OF_RANGE = 2
    TYPE_MISMATCH = 7


_INTEGER_TYPES = range(1, 9)


class Parameters:
    """Values by name, with the answers to messages about them.

    Args:
        defaults: The values at the start.
        bytewise: Whether integers are sent as the bits of a float.
        on_change: Called with the name and value of each one that was set.
    """

    def __init__(
        self, defaults: dict[str, Number], *, bytewise: bool, on_change: Callable[[str, Number], None]
    ) -> None:
        self._values = dict(defaults)
        self._bytewise = bytewise
        self._on_change = on_change

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def set_text(self, name: str, text: str) -> None:
        """Set a parameter that exists; raises ValueError for a text that is no value of it."""
        value: Number
        if isinstance(self._values[name], int):
            value = int(text)
        else:
            value = float(text)
            if not math.isfinite(value):
                raise ValueError
        self._values[name] = value
        self._on_change(name, value)

    def answer_list(self, send: Callable[..., None]) -> None:
        """PARAM_REQUEST_LIST: send all of them."""
        for name in self._values:
            self._send(name, send)

    def answer_read(self, message: Any, send: Callable[..., None]) -> None:
        """PARAM_REQUEST_READ: send one, by its index or name.

        An unknown one is answered with PARAM_ERROR, as PX4 does since its pull request 25699 (2025; earlier releases
        are silent) and ArduPilot since 31062.
        """
        names = list(self._values)
        name = message.param_id
        if message.param_index >= 0:
            name = ""
            if message.param_index < len(names):
                name = names[message.param_index]
        if name in self._values:
            self._send(name, send)
        else:
            self._refuse(message, message.param_index, ParameterError.DOES_NOT_EXIST, send)

    def answer_set(self, message: Any, send: Callable[..., None]) -> None:
        """PARAM_SET: set and send one, also an unknown one, which then exists.

        PX4 refuses an integer for a float and the reverse, since their bits mean something else.
        """
        name = message.param_id
        is_integer = message.param_type in _INTEGER_TYPES
        if not name:
            self._refuse(message, -1, ParameterError.DOES_NOT_EXIST, send)
            return
        if name in self._values:
            must_be_integer = isinstance(self._values[name], int)
            if self._bytewise and must_be_integer != is_integer:
                self._refuse(message, -1, ParameterError.TYPE_MISMATCH, send)
                return
            is_integer = must_be_integer
        if is_integer and self._bytewise:
            self._values[name] = _integer_bits(message.param_value)
        elif not math.isfinite(message.param_value):
            self._refuse(message, -1, ParameterError.OUT_OF_RANGE, send)
            return
        elif not is_integer:
            self._values[name] = float(message.param_value)
        else:
            self._values[name] = round(message.param_value)
        self._on_change(name, self._values[name])
        self._send(name, send)

    def _send(self, name: str, send: Callable[..., None]) -> None:
        names = list(self._values)
        value = self._values[name]
        kind = ParameterType.REAL32
        content = float(value)
        if isinstance(value, int):
            kind = ParameterType.INT32
            if self._bytewise:
                content = _float_bits(value)
        send("param_value", name.encode(), content, kind, len(names), names.index(name))

    def _refuse(self, message: Any, index: int, error: ParameterError, send: Callable[..., None]) -> None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        send("param_error", *sender, message.param_id.encode(), index, error)


def _integer_bits(value: float) -> int:
    """The integer that PARAM_VALUE and PARAM_SET carry in the bits of a float."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def _float_bits(value: int) -> float:
    """Inverse of `_integer_bits`."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])
