"""The rule of the estimated odometry: what a filter publishes passes, whatever its sensors say; other values do not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mavfi.detectors.acceptance import SOURCE, AcceptanceTest
from mavfi.detectors.estimates import ESTIMATE, FIX, WIDTH
from mavfi.kernels.perception.state_estimation import Noise
from mavfi.pipeline.estimation import StateEstimator
from mavfi.sim import imu
from mavfi.states import STATES, floats, new_state
from tests.core.unit.detectors.streams import LIMITS

STEP_US, PER_FIX = 4_000, 25
NOISE = Noise(
    imu.ACCELEROMETER_RANDOM_WALK, imu.GYRO_RANDOM_WALK, imu.ACCELEROMETER_BIAS_WALK, imu.GYRO_BIAS_WALK, 0.05, 0.025
)
ESTIMATED = replace(LIMITS["published"], fix_noise=(NOISE.position, NOISE.heading))
HOVER = np.array([0.0, 0.0, 9.80665, 0.0, 0.0, 0.0])
HERE = np.array([10.0, 0.0, 3.0, 0.4])
NAMES = [field.name for field in STATES[ESTIMATE].header]


def message(name, values):
    state = new_state(name)
    floats(state.header, len(values))[:] = values
    return state


def filtered(steps, *, fixes=lambda number: HERE, samples=lambda number: HOVER, seed=1):
    """(state, time) of all fixes and estimates of a filter that hovers; `None` = no fix."""
    kernel, random, events = StateEstimator(NOISE), np.random.default_rng(seed), []
    for number in range(steps):
        now = STEP_US * number
        if number % PER_FIX == 0 and (fix := fixes(number // PER_FIX)) is not None:
            measured = message(FIX, fix + random.normal(0.0, 1.0, 4) * (0.05, 0.05, 0.05, 0.025))
            events.append((measured, now))
            kernel.receive(measured, now)
        kernel.receive(message("sensor.imu", samples(number) + random.normal(0.0, 0.01, 6)), now)
        events += [(state, now) for state in kernel.step(now)]
    return events


@cache
def hovering():
    return filtered(500)


def alarms(events, detector=None):
    """Fields of all alarms; every publication is accepted."""
    detector = detector or AcceptanceTest(ESTIMATED)
    fields = []
    for state, now in events:
        alarm = detector.check(state, now)
        fields += [alarm.fields[0]] if alarm is not None else []
        detector.accept(state, now)
    return fields


def flying():
    """A detector in flight, the next estimate, and its time."""
    detector, events = AcceptanceTest(ESTIMATED), hovering()
    alarms(events[:-1], detector)
    return detector, *events[-1]


def corner(number):
    return np.array([160.0, -160.0, 160.0, 35.0, 35.0, -35.0]) if 300 <= number < 320 else HOVER


FLIGHTS = {
    "calm": {},
    "samples in the corner of the range": {"samples": corner},
    "no fixes for a while": {"fixes": lambda number: None if 5 <= number < 25 else HERE},
    "fixes elsewhere, until it believes them": {
        "fixes": lambda number: HERE + (9.0, -5.0, 0.0, 1.0) * np.array(number >= 8),
    },
    "a fix that it refuses": {"fixes": lambda number: HERE + (1e4, 0.0, 0.0, 0.0) * np.array(number == 8)},
    "carried along at a speed that the IMU has not seen": {
        "fixes": lambda number: HERE + (0.6 * max(number - 8, 0), 0.0, 0.0, 0.0),
    },
    "in motion after re-initialization": {
        "samples": lambda number: HOVER + (3.0, 0.0, 0.0, 0.0, 0.0, 0.0) * np.array(200 <= number < 400),
        "fixes": lambda number: HERE + (0.3 * max(number - 20, 0), 5.0 * (number > 12), 0.0, 0.0),
    },
}


@pytest.mark.parametrize("case", FLIGHTS)
def test_what_a_filter_publishes_passes_whatever_its_sensors_say(case):
    assert alarms(filtered(1500, **FLIGHTS[case])) == []


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((name, value) for name in NAMES[:WIDTH] for value in (np.nan, -np.inf, 1e300)),
        ("x", 10.6),
        ("y", -0.6),
        ("z", -3.0),
        ("vx", 2.5),
        ("vy", -8.0),
        ("vz", 1e3),
        ("qw", 0.5),
        ("qw", -0.98),
        ("qz", -0.3),
        ("qx", 1e-4),
        ("qy", 0.9),
    ],
)
def test_one_value_that_no_filter_says_is_a_hard_alarm_that_names_it(field, value):
    detector, state, now = flying()
    corrupted = state.copy()
    corrupted.header[field] = value
    alarm = detector.check(corrupted, now)
    assert alarm is not None and (alarm.source, alarm.stage, alarm.hard) == (SOURCE, "perception", True)
    assert alarm.fields == (f"{ESTIMATE}.{field}",) and alarm.score > 1.0
    assert detector.check(state, now) is None, "its copy"


def test_flights_without_an_estimator_have_neither_rule_nor_memory_of_it():
    detector = AcceptanceTest(LIMITS["published"])
    memory_before = detector.memory()
    corrupted = message(ESTIMATE, [np.nan] * WIDTH)
    assert detector.check(corrupted, 0) is None and FIX not in detector.states
    detector.accept(message(FIX, HERE), 0)
    assert detector.memory() == memory_before and not any(name.startswith("estimate.") for name in detector.arrays())
