"""A plain twin of the rule of the estimated odometry: rotations by SciPy, vectors by NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavfi.detectors import estimates
from mavfi.detectors.acceptance import AcceptanceTest
from mavfi.detectors.estimates import ATTITUDE, ESTIMATE, VELOCITY, WIDTH
from mavfi.states import bytes_of, floats, new_state
from tests.core.unit.detectors.test_estimates import ESTIMATED

RANGE_FORCE, RANGE_RATE = 16 * 10.0, 35.0
JUMP, TURN = 30**0.5 * 0.05, 30**0.5 * 0.025 + 0.1
FAST, WIDE = np.linalg.norm([RANGE_FORCE] * 3) + 9.80665, np.linalg.norm([RANGE_RATE] * 3)
LAST = np.array([20.0, 1.0, 4.0, 2.0, -1.0, 0.2, 0.8, 0.0, 0.0, 0.6])
NOW = 5_000_000


def group(column):
    return "position" if column < VELOCITY else "velocity" if column < ATTITUDE else "attitude"


def naive(new, elapsed, fix):
    """What is wrong with an estimate, of position, velocity and attitude."""
    broken = np.flatnonzero(~np.isfinite(new))
    if len(broken):
        return group(broken[0])
    if not abs(float(new[ATTITUDE:] @ new[ATTITUDE:]) - 1.0) <= 1e-9:
        return "attitude"
    led = LAST[:3] + elapsed * LAST[VELOCITY:ATTITUDE]
    by_itself = np.abs(new[:3] - led) <= JUMP + 0.5 * FAST * elapsed**2
    if not (by_itself | (np.abs(new[:3] - fix) <= JUMP)).all():
        return "position"
    if (new[:3] == fix).all():
        return None
    last, other = (Rotation.from_quat(values[ATTITUDE:], scalar_first=True) for values in (LAST, new))
    half = 0.5 * (last.inv() * other).magnitude()
    if not np.sin(half) <= 0.5 * (TURN + WIDE * elapsed):
        return "attitude"
    grown = np.abs(new - LAST)[VELOCITY:ATTITUDE]
    return None if (grown <= 1.0 + FAST * elapsed).all() else "velocity"


@pytest.fixture(scope="module")
def rule():
    return AcceptanceTest(ESTIMATED)


SHIFTS = st.tuples(*[st.floats(-6.0, 6.0) | st.sampled_from([0.0, 0.2, -0.2, np.nan, np.inf, 1e300])] * 6)
TURNS = st.tuples(*[st.floats(-1.0, 1.0)] * 3)


@settings(max_examples=300)
@given(
    SHIFTS,
    st.sampled_from([0.0, 0.02, 1.0]),
    TURNS,
    st.sampled_from([1.0, -1.0, 1.001]),
    st.sampled_from([0, 4_000, 20_000, 600_000]),
    st.sampled_from(["far", "near", "here"]),
)
def test_an_estimate_is_judged_as_by_the_twin(rule, shift, scale, turn, length, elapsed_us, where):
    new = LAST.copy()
    with np.errstate(all="ignore"):
        new[:ATTITUDE] += scale * np.array(shift)
    attitude = Rotation.from_quat(LAST[ATTITUDE:], scalar_first=True) * Rotation.from_rotvec(turn)
    new[ATTITUDE:] = length * attitude.as_quat(scalar_first=True)
    fix = {"far": np.full(3, -50.0), "near": new[:3] + 0.2, "here": new[:3]}[where]
    rule.start()
    for name, values in (("sensor.position", fix), (ESTIMATE, LAST)):
        state = new_state(name)
        floats(state.header, len(values))[:] = values
        rule.accept(state, NOW)
    state = new_state(ESTIMATE)
    floats(state.header, WIDTH)[:] = new
    verdict = estimates.judge_estimate(bytes_of(state.header), NOW + elapsed_us, rule.estimate)
    expected = naive(new, 1e-6 * elapsed_us, fix)
    assert (None if verdict < 0 else group(verdict)) == expected
