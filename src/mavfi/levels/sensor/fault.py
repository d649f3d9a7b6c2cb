"""The planned failure of a sensor or motor.

It is a level of its own: a `MessageFault` is one flipped bit of a number on a topic or call, and knows no time; a
failure changes all values of a device, for all its readers, as a function of time.
"""

from dataclasses import dataclass
from math import inf, pi
from typing import ClassVar, Literal

from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import Fault


@dataclass(frozen=True, slots=True)
class Device:
    """A device that can fail.

    Attributes:
        error: Error of type `wrong`, in the unit's own unit; with `relative`, a share of the value.
        spread: Largest value of type `garbage`, uniform in both directions; with `relative`, from 0 on.
        relative: Whether values are amounts, which are never negative.
        lost: What readers receive in place of a lost value; None = they keep the last one.
        instances: Number of such devices.
        readers: What the failure changes.
    """

    error: float
    spread: float
    relative: bool = False
    lost: float | None = None
    instances: int = 1
    readers: str = ""


UNITS = {
    "gyro": Device(0.5, 3.0, readers="body rates (rad/s)"),
    "accelerometer": Device(2.0, 20.0, readers="specific force (m/s²)"),
    "compass": Device(0.5 * pi, pi, readers="heading (rad)"),
    "position": Device(10.0, 50.0, readers="position (m) and velocity (m/s)"),
    "depth_camera": Device(0.5, 20.0, relative=True, lost=float("nan"), readers="ranges of the image (m)"),
    "motor": Device(-0.4, 1.0, relative=True, lost=0.0, instances=4, readers="commanded thrust (share of the largest)"),
}
"""Devices by name. The error of a position is along x."""
TYPES = {
    "ok": "no failure: the null fault, through the whole path",
    "off": "no values: readers keep the last one, an image has no measurement, a motor stands still",
    "stuck": "the value at the start of the failure",
    "garbage": "uniform noise",
    "wrong": "a constant error",
    "slow": "an update every 0.5 s",
    "delayed": "the value of 0.2 s ago",
    "intermittent": "half of all blocks of 0.1 s are lost, as with off",
    "drift": "an error that grows in proportion to time, to that of wrong within 10 s",
}
"""Types of failures: MAVLink's FAILURE_TYPE (https://mavlink.io/en/messages/common.html#FAILURE_TYPE)."""
NULL = "ok"
"""Type of a null fault: the device works."""
RANDOM = ("garbage", "intermittent")
"""Types that draw values by the seed."""
FAILING = tuple(kind for kind in TYPES if kind != NULL)
"""Types that change values."""
SLOW_US = 500_000
"""Period of `slow` (us)."""
DELAY_US = 200_000
"""Delay of `delayed` (us)."""
BLOCK_US = 100_000
"""Length of a block of `intermittent` (us)."""
DRIFT_US = 10_000_000
"""Time in which `drift` reaches the error of `wrong` (us)."""


@dataclass(frozen=True, slots=True)
class SensorFault(Fault):
    """A failure of a sensor or motor, for all its readers.

    Attributes:
        unit: gyro, accelerometer, compass, position, depth_camera or motor.
        kind: ok, off, stuck, garbage, wrong, slow, delayed, intermittent or drift.
        time_us: First instant; `NO_SITE` = the golden run has no such instant.
        lasts_s: Duration (s); "inf" = to the end.
        instance: Number of the motor from 1; 0 = all of them.
        stratum: Always "": not drawn by stratum.
        weight: Always 1.
        seed: Seed of the draw, and of the random values of `garbage` and `intermittent`.

    Raises:
        BadInputError: Unknown unit or type, or a number out of range.
    """

    level: ClassVar[Literal["sensor"]] = "sensor"
    unit: str
    kind: str
    time_us: int = 0
    lasts_s: float = inf
    instance: int = 0
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        for value, names in ((self.unit, UNITS), (self.kind, TYPES)):
            if value not in names:
                raise BadInputError(f"sensor fault: {not_known(value, names)}")
        instances = UNITS[self.unit].instances
        if instances == 1 and self.instance != 0:
            raise BadInputError(f"fault in {self.unit}: instance {self.instance}: allowed: none")
        if not 0 <= self.instance <= instances:
            raise BadInputError(f"fault in {self.unit}: instance {self.instance}: allowed: 1 to {instances}, 0 = all")
        if not self.lasts_s > 0.0:
            raise BadInputError(f"fault in {self.site}: lasts_s: {self.lasts_s}: allowed: above 0")

    @property
    def device(self) -> str:
        """Unit and instance as text, e.g. "motor2"."""
        return f"{self.unit}{self.instance or ''}"

    @property
    def site(self) -> str:
        """Device and type as text."""
        return f"{self.device} {self.kind}"

    @property
    def bit(self) -> None:
        """None: whole values are changed."""
        return None

    @property
    def end_us(self) -> float:
        """End of the failure (us), exclusive."""
        return self.time_us + 1e6 * self.lasts_s


def check_read(unit: str, flight_controller: str, localization: str) -> None:
    """Check that something in a mission reads a device.

    Raises:
        BadInputError: Nothing does.
    """
    if unit == "accelerometer" and flight_controller == "cascade" and localization == "truth":
        raise BadInputError(
            "fault in accelerometer: localization truth and our flight controller do not read it; "
            "allowed: localization estimator, or flight_controller betaflight"
        )
