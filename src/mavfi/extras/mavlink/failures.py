"""MAV_CMD_INJECT_FAILURE with PX4's meaning of its units, types and instances.

Source: FailureTable.cpp and FailureInjectionManager.cpp of PX4's failure_injection_manager, and its page
https://docs.px4.io/main/en/debug/failure_injection (October 2026).  PX4 implements `off` and `stuck` of most sensors;
the other types of gyro, accelerometer, compass, position and motor are ours.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from mavfi.extras.mavlink.flying import MavVehicle
from mavfi.extras.mavlink.parameters import Parameters
from mavfi.extras.mavlink.vocabulary import Command, MavResult, whole
from mavfi.faults.levels.sensor.failures import Failure
from mavfi.faults.levels.sensor.fault import NULL, SensorFault
from mavfi.faults.levels.sensor.fault import UNITS as DEVICES

UNITS = {0: "gyro", 1: "accelerometer", 2: "compass", 4: "position", 101: "motor"}
"""Units of `SensorFault` by FAILURE_UNIT, which has no depth camera."""
TYPES = dict(enumerate(("ok", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent", "drift")))
"""Its types by FAILURE_TYPE."""
PROOF_US = 1_000_000
"""Time within which a failure must change a value (us)."""
_BATTERY = 100
_ABSENT = {
    3: "baro: this vehicle has no barometer; its height fails with gps",
    5: "optical_flow: this vehicle has no such sensor",
    6: "vio: this vehicle has no such sensor",
    7: "distance_sensor: this vehicle has no such sensor",
    8: "airspeed: this vehicle has no such sensor",
    102: "servo: this vehicle has none",
    103: "avoidance: not part of this autopilot",
    104: "rc_signal: this vehicle has no receiver; stop sending MANUAL_CONTROL or RC_CHANNELS_OVERRIDE",
    105: "mavlink_signal: stop reading or sending",
    106: "esc: this vehicle has no telemetry of motors",
    107: "traffic: this vehicle has no such receiver",
}
"""Why other units are not supported; PX4 refuses 5 and 102 to 105 too."""
_ALL = 0xFFFF
"""Mask of all instances."""
FIX_3D = 3
_NO_FIX = 1
FULL = 90
"""Charge of the battery (%)."""
_DEPLETED = 6
"""Reported charge of a depleted battery (%): just below PX4's critical level, BAT_CRIT_THR."""
_MAX_INSTANCE = 16
"""PX4 addresses instances 1 to 16."""


class ChargeState(IntEnum):
    """MAV_BATTERY_CHARGE_STATE."""

    OK = 1
    CRITICAL = 3


@dataclass(slots=True)
class PendingFailure:
    """A command that is acknowledged once each of its failures has changed a value."""

    command: Command
    failures: list[Failure]


@dataclass(slots=True)
class ReportedState:
    """What telemetry says of a receiver or battery while they fail, apart from values of sensors.

    Attributes:
        fix_type: GPS_FIX_TYPE of GPS `wrong`; None = the receiver works.
        battery: Type of the failure of the battery; "" = it works.
    """

    fix_type: int | None = None
    battery: str = ""


class FailureCommands:
    """The failures of one vehicle, by command.

    Args:
        vehicle: The vehicle.
        parameters: Those of the autopilot, of which SYS_FAIL_GPS_WRG and MAVFI_GPS_WRONG count.
        text: Sends a STATUSTEXT about a failure.
        acknowledge: Sends the answer to a command.
    """

    def __init__(
        self,
        vehicle: MavVehicle,
        parameters: Parameters,
        text: Callable[[str], None],
        acknowledge: Callable[[Command, int], None],
    ) -> None:
        self._vehicle = vehicle
        self._parameters = parameters
        self._text = text
        self._acknowledge = acknowledge
        self._pending: list[PendingFailure] = []
        self._reported = ReportedState()

    # ---- what telemetry says ----------------------------------------------------------------------------------------
    @property
    def units_off(self) -> set[str]:
        """Units that send nothing."""
        return {failure.fault.unit for failure in self._vehicle.failures.active if failure.fault.kind == "off"}

    @property
    def fix_type(self) -> int:
        """GPS_FIX_TYPE."""
        if self._reported.fix_type is not None:
            return self._reported.fix_type
        if "position" in self.units_off:
            return _NO_FIX
        return FIX_3D

    @property
    def battery_is_silent(self) -> bool:
        """Whether the battery reports nothing."""
        return self._reported.battery == "off"

    @property
    def charge(self) -> int:
        """Reported charge of the battery (%); -1 = none."""
        if self._reported.battery == "off":
            return -1
        if self._reported.battery == "wrong":
            return _DEPLETED
        return FULL

    @property
    def charge_state(self) -> ChargeState:
        """Reported state of the battery."""
        if self._reported.battery == "wrong":
            return ChargeState.CRITICAL
        return ChargeState.OK

    # ---- the command ------------------------------------------------------------------------------------------------
    def inject(self, command: Command) -> int | None:
        """Begin or end a failure; None = acknowledged later, by `prove`."""
        if self._parameters["SYS_FAILURE_EN"] == 0:
            return self._refuse("SYS_FAILURE_EN is 0", MavResult.DENIED)
        number = whole(command[1])
        kind = TYPES.get(whole(command[2]))
        mask = _mask_of(command)
        if kind is None:
            return self._refuse(f"FAILURE_TYPE {command[2]:g}: not known")
        if mask == 0:
            return self._refuse("no instance", MavResult.DENIED)
        if number == _BATTERY:
            return self._fail_battery(kind, mask)
        if number in UNITS:
            return self._fail_device(command, UNITS[number], kind, mask)
        return self._refuse(_ABSENT.get(number, f"FAILURE_UNIT {command[1]:g}: not known"))

    def _fail_device(self, command: Command, unit: str, kind: str, mask: int) -> int | None:
        """Begin or end a failure of some instances of a device."""
        count = DEVICES[unit].instances
        every = (1 << count) - 1
        if mask != _ALL and mask & ~every:
            return self._refuse(f"{unit}: this vehicle has {count}; allowed: instance 1 to {count}, 0 = all")
        instances = {number for number in range(1, count + 1) if mask >> (number - 1) & 1}
        if kind == NULL:
            self._end(unit, instances)
            self._text(f"cleared: {unit}")
            return MavResult.ACCEPTED
        if unit == "position" and kind == "wrong" and not self._parameters["MAVFI_GPS_WRONG"]:
            return self._degrade_fix()
        if not self._vehicle.sim.armed:
            return self._refuse("motors off: no value reaches the controller", MavResult.REJECTED)

        # a repeated command would change nothing; another failure of the same instances is replaced
        same = self._active_in(unit, instances, kind)
        if same:
            if all(failure.injection is not None for failure in same):
                return MavResult.ACCEPTED
            return None
        self._end(unit, instances)
        self._pending.append(PendingFailure(command, self._begin(unit, kind, instances)))
        return None

    def _refuse(self, reason: str, result: MavResult = MavResult.UNSUPPORTED) -> MavResult:
        self._text(f"failure refused: {reason}")
        return result

    def _begin(self, unit: str, kind: str, instances: set[int]) -> list[Failure]:
        """Failures of some instances, one for all of them if they are all."""
        numbers = sorted(instances)
        if len(instances) == DEVICES[unit].instances:
            numbers = [0]
        now_us = self._vehicle.now_us
        seed = self._vehicle.spec.seed
        faults = [SensorFault(unit, kind, now_us, instance=number, seed=seed) for number in numbers]
        return [self._vehicle.failures.begin(fault) for fault in faults]

    def _active_in(self, unit: str, instances: set[int], kind: str) -> list[Failure]:
        """The failures of a type that together are those of these instances; none if others fail, or not all do."""
        failures = []
        covered: set[int] = set()
        for failure in self._vehicle.failures.active:
            if failure.fault.unit == unit and failure.fault.kind == kind:
                failing = _instances_of(failure)
                if failing & instances:
                    failures.append(failure)
                    covered |= failing
        if covered == instances:
            return failures
        return []

    def _end(self, unit: str, instances: set[int]) -> None:
        """End the failures of some instances; others of the same failure go on."""
        if unit == "position":
            self._reported.fix_type = None
        for failure in list(self._vehicle.failures.active):
            failing = _instances_of(failure)
            if failure.fault.unit == unit and failing & instances:
                self._vehicle.failures.remove(failure)
                if failing - instances:
                    self._begin(unit, failure.fault.kind, failing - instances)

    # ---- failures that telemetry shows ------------------------------------------------------------------------------
    def _degrade_fix(self) -> MavResult:
        """GPS `wrong`: the receiver reports SYS_FAIL_GPS_WRG; below a 3D fix the position is not used any more."""
        fix_type = round(self._parameters["SYS_FAIL_GPS_WRG"])
        if fix_type == self._reported.fix_type:
            return MavResult.ACCEPTED  # a repeated command
        if fix_type == self.fix_type:
            return self._refuse(f"SYS_FAIL_GPS_WRG: {fix_type}: the present fix type", MavResult.FAILED)
        before = self.fix_type
        self._end("position", {1})
        self._reported.fix_type = fix_type
        if fix_type < FIX_3D:
            self._begin("position", "off", {1})
        self._text(f"fault: position wrong: fix type {before} -> {fix_type}")
        return MavResult.ACCEPTED

    def _fail_battery(self, kind: str, mask: int) -> MavResult:
        """Battery `off` (no reports) and `wrong` (depleted)."""
        if mask not in (_ALL, 1):
            return self._refuse("battery: this vehicle has 1; allowed: instance 1, 0 = all")
        if kind not in (NULL, "off", "wrong"):
            return self._refuse(f"battery {kind}: allowed: off, wrong")
        before = self.charge
        self._reported.battery = ""
        if kind == NULL:
            self._text("cleared: battery")
            return MavResult.ACCEPTED
        self._reported.battery = kind
        self._text(f"fault: battery {kind}: {before} % -> {self.charge} %")
        return MavResult.ACCEPTED

    # ---- proof ------------------------------------------------------------------------------------------------------
    def prove(self) -> None:
        """Acknowledge commands whose failures were all activated, or were not in time."""
        for pending in list(self._pending):
            injections = [failure.injection for failure in pending.failures]
            if None not in injections:
                for injection in injections:
                    assert injection is not None  # by the condition
                    self._text(f"fault: {injection.site}: {injection.before:.4g} -> {injection.after:.4g}")
                self._acknowledge(pending.command, MavResult.ACCEPTED)
            elif self._vehicle.now_us - pending.failures[0].fault.time_us >= PROOF_US:
                for failure in pending.failures:
                    if failure in self._vehicle.failures.active:
                        self._vehicle.failures.remove(failure)
                self._text("failure refused: no value has changed within a second")
                self._acknowledge(pending.command, MavResult.FAILED)
            else:
                continue
            self._pending.remove(pending)


def _mask_of(command: Command) -> int:
    """Mask of the instances: those of parameter 3, or if it is NaN, the mask in parameter 4."""
    if math.isfinite(command[3]):
        instance = whole(command[3])
        if instance == 0:
            return _ALL
        if instance < 0:
            return 0
        return 1 << (min(instance, _MAX_INSTANCE + 1) - 1)
    return max(0, whole(command[4]))


def _instances_of(failure: Failure) -> set[int]:
    """Numbers of the instances that fail, from 1."""
    if failure.fault.instance:
        return {failure.fault.instance}
    return set(range(1, DEVICES[failure.fault.unit].instances + 1))
