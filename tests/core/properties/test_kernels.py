import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavfi.kernels.control import pid
from mavfi.kernels.planning import waypoint
from mavfi.pipeline.waypoints import SetpointGenerator
from tests.core.unit.kernels.cases import GAINS
from tests.core.unit.pipeline.parts import AUTOPILOTS, config, odometry, status, tracking, trajectory

anything = st.floats(allow_nan=True, allow_infinity=True)


updates = st.lists(
    st.tuples(st.integers(-(2**31), 2**31 - 1) | st.integers(0, 30_000), st.floats(width=32)), max_size=60
)


@given(st.lists(anything, min_size=11, max_size=11), st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_a_command_is_within_its_limits_or_not_a_number(reference, position):
    odometry_ = np.array([*position, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], float)
    command, memory = np.zeros(4), np.zeros(pid.MEMORY_WIDTH)
    for _ in range(2):
        slowdown = pid.track(np.array(reference), odometry_, memory, GAINS, 0.02, command)
        assert 1.0 <= slowdown <= GAINS.slowdown_cap
        assert not np.linalg.norm(command[:3]) > GAINS.limit * (1 + 1e-12)
        assert not abs(command[3]) > GAINS.yaw_rate
        assert (np.abs(memory[:3]) <= GAINS.integral_limit).all()
    pid.track(np.zeros(11), odometry_, memory, GAINS, 0.02, command)
    assert np.isfinite(command).all()


@given(anything, anything, anything, st.floats(0, 30), st.floats(0, 1))
def test_the_reference_clock_stays_on_its_trajectory(blocked, unknown, speed, position, rate):
    points = np.zeros((30, 11))
    points[:, 4] = speed
    arc = np.linspace(0.0, 3.0, 30)
    clock = np.array([position, rate, 0.0])
    for _ in range(5):
        before = clock[0]
        waypoint.advance_clock(clock, points, arc, 0.02, blocked, unknown, 2.5, 0.5, 1.0)
        assert min(before, 29.0) <= clock[0] <= 29.0
        assert 0.0 <= clock[1] <= 1.2


events = st.lists(
    st.one_of(
        st.builds(trajectory, st.integers(-2, 9), st.integers(-2, 5), st.integers(0, 6)),
        st.builds(status, st.integers(-2, 5), anything, st.booleans(), anything, st.integers(-1, 9)),
        st.builds(tracking, st.one_of(anything, st.sampled_from([0.0, 0.3]))),
        st.builds(odometry, st.tuples(*[st.floats(0, 9)] * 3), st.tuples(*[st.floats(-3, 3)] * 3)),
    ),
    max_size=12,
)


@given(st.sampled_from(AUTOPILOTS), events, events)
def test_the_setpoint_generator_repeats_itself_from_the_same_memory(autopilot, before, between):
    kernel = SetpointGenerator(config(autopilot))
    with np.errstate(all="ignore"):
        for k, state in enumerate(before):
            kernel.receive(state, k * 20_000)
            kernel.step(k * 20_000)
        for state in between:
            kernel.receive(state, 20_000 * len(before))
        kernel.mark()
        now = 20_000 * (len(before) + 1)
        first = [state.header.tobytes() for state in kernel.step(now)]
        kernel.rollback()
        assert [state.header.tobytes() for state in kernel.step(now)] == first
