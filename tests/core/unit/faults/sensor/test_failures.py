"""The failures of a vehicle: which values each of them changes, and the proof that it did."""

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.levels.sensor.failures import Failures
from mavfi.levels.sensor.fault import SensorFault

ODOMETRY = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0, 0.5, 0.6, 0.7])
THRUSTS = np.array([1.0, 2.0, 3.0, 4.0])
READ = {
    "state": lambda failures: failures.state(5, ODOMETRY),
    "force": lambda failures: failures.force(5, ODOMETRY[:3]),
    "imu": lambda failures: failures.imu(5, ODOMETRY[:6]),
    "fix": lambda failures: failures.fix(5, ODOMETRY[:4]),
    "ranges": lambda failures: failures.ranges(5, ODOMETRY),
    "rotors": lambda failures: failures.rotors(5, THRUSTS, 8),
}
TRUE = {
    "state": ODOMETRY,
    "force": ODOMETRY[:3],
    "imu": ODOMETRY[:6],
    "fix": ODOMETRY[:4],
    "ranges": ODOMETRY,
    "rotors": THRUSTS,
}


@pytest.mark.parametrize(
    ("unit", "changed"),
    [
        ("gyro", {"state": [10, 11, 12], "imu": [3, 4, 5]}),
        ("accelerometer", {"force": [0, 1, 2], "imu": [0, 1, 2]}),
        ("compass", {"state": [6, 9], "fix": [3]}),
        ("position", {"state": [0], "fix": [0]}),
        ("depth_camera", {"ranges": np.flatnonzero(ODOMETRY).tolist()}),
        ("motor", {"rotors": [0, 1, 2, 3]}),
    ],
)
def test_a_unit_changes_its_own_values_for_all_readers(unit, changed):
    failures = Failures()
    failure = failures.begin(SensorFault(unit, "wrong"))
    for name, read in READ.items():
        assert np.flatnonzero(read(failures) != TRUE[name]).tolist() == changed.get(name, []), name
    assert failure.injection.activated and failure.injection.before != failure.injection.after
    assert failure.injection.site == f"{unit} wrong" and failure.injection.time_s == 5e-6


def test_without_failures_values_pass_as_they_are():
    for name, read in READ.items():
        assert read(Failures()).tobytes() == TRUE[name].tobytes()
    assert Failures().state(0, ODOMETRY) is ODOMETRY


def test_a_wrong_compass_turns_about_the_vertical():
    failures = Failures()
    failures.begin(SensorFault("compass", "wrong"))
    assert failures.state(5, ODOMETRY)[6:10] == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])
    assert failures.fix(5, np.array([0.0, 0.0, 0.0, 3.0]))[3] == pytest.approx(3.0 - 1.5 * np.pi)


def test_failures_add_up():
    failures = Failures()
    failures.begin(SensorFault("motor", "off", instance=1))
    failures.begin(SensorFault("motor", "off", instance=2))
    failures.begin(SensorFault("gyro", "stuck"))
    assert failures.rotors(5, THRUSTS, 8).tolist() == [0.0, 0.0, 3.0, 4.0]
    assert THRUSTS.tolist() == [1.0, 2.0, 3.0, 4.0], "the commands of the controller stay"


def test_a_null_fault_passes_the_whole_path_and_changes_nothing():
    failures = Failures()
    failure = failures.begin(SensorFault("gyro", "ok"))
    assert failures.state(5, ODOMETRY).tobytes() == ODOMETRY.tobytes()
    assert failure.record().activated and failure.record().before == failure.record().after == 0.5


def test_a_failure_that_changes_no_value_is_not_activated():
    failures = Failures()
    failure = failures.begin(SensorFault("gyro", "stuck", 3_000_000))
    for time_us in (0, 4_000_000, 5_000_000):
        failures.state(time_us, ODOMETRY)
    assert not failure.record().activated and failure.record().time_s == 3.0


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: SensorFault("radar", "off"), "'radar': not known; allowed: gyro"),
        (lambda: SensorFault("motor", "off", instance=5), "instance 5: allowed: 1 to 4, 0 = all"),
        (lambda: SensorFault("gyro", "off", lasts_s=0.0), "lasts_s: 0.0: allowed: above 0"),
    ],
)
def test_what_is_not_allowed(make, text):
    with pytest.raises(BadInputError, match=text):
        make()
