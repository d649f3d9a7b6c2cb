import numpy as np
import pytest

from mavfi.kernels.control import pid
from tests.core.reference.kernels import naive


def gains(**changes):
    three = np.full(3, 0.0)
    plain = pid.Gains(np.array([0.2, 0.3, 0.5]), three, three, 1.0, 1.0, 0.0, 3.0, 10.0, 1.5)
    return plain._replace(**changes)


FULL = {"i": np.full(3, 0.1), "d": np.full(3, 0.01), "acceleration": 0.4}


@pytest.mark.parametrize("changes", [{}, FULL, {**FULL, "integral_limit": 0.01}])
def test_tracking_equals_the_textbook_over_many_steps(changes):
    random = np.random.default_rng(4)
    law, memory, expected_memory = gains(**changes), np.zeros(pid.MEMORY_WIDTH), np.zeros(pid.MEMORY_WIDTH)
    saturated = 0
    for _ in range(200):
        waypoint, odometry = random.normal(size=11) * random.choice([0.2, 2.0]), random.normal(size=13) * 0.2
        odometry[6:10] /= np.linalg.norm(odometry[6:10])
        command = np.empty(4)
        slowdown = pid.track(waypoint, odometry, memory, law, 0.02, command)
        expected = naive.track(waypoint, odometry, expected_memory, law, 0.02)
        np.testing.assert_allclose(command, expected[0], atol=1e-9)
        assert slowdown == pytest.approx(expected[1])
        expected_memory = expected[2]
        np.testing.assert_allclose(memory, expected_memory, atol=1e-12)
        saturated += slowdown > 1.0
    assert 0 < saturated < 200


def test_saturation_keeps_the_direction_and_tells_by_how_much():
    waypoint, odometry, command = np.zeros(11), np.zeros(13), np.empty(4)
    odometry[6] = 1.0
    waypoint[4:7] = [6.0, -8.0, 0.0]
    assert pid.track(waypoint, odometry, np.zeros(7), gains(), 0.02, command) == pytest.approx(10.0 / 3.0)
    np.testing.assert_allclose(command[:3], [1.8, -2.4, 0.0])
    waypoint[4:7] = [1e200, 0.0, 1e200]
    assert pid.track(waypoint, odometry, np.zeros(7), gains(), 0.02, command) == 10.0
    np.testing.assert_allclose(command[:3], [3.0 / np.sqrt(2), 0.0, 3.0 / np.sqrt(2)])


@pytest.mark.parametrize("column", [0, 1, 2, 4, 5, 6])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_on_every_axis_a_corrupted_reference_slows_the_clock_down_by_the_cap(column, value):
    waypoint, odometry, command = np.zeros(11), np.zeros(13), np.zeros(4)
    waypoint[column] = value
    odometry[6] = 1.0
    memory = np.zeros(7)
    assert pid.track(waypoint, odometry, memory, gains(), 0.02, command) == 10.0
    assert np.isnan(command[:3]).all()  # the flight controller refuses it
    assert np.isfinite(pid.track(np.zeros(11), odometry, memory, gains(), 0.02, command))
    assert np.isfinite(command).all() and np.isfinite(memory).all()


def tracked(law, errors, dt=0.02):
    """Commands (x) and memory of a tracker that stands at the origin and is given way-points at these errors."""
    odometry, memory, commands = np.zeros(13), np.zeros(pid.MEMORY_WIDTH), []
    odometry[6] = 1.0
    for error in errors:
        waypoint, command = np.zeros(11), np.empty(4)
        waypoint[0] = error
        pid.track(waypoint, odometry, memory, law, dt, command)
        commands.append(command[0])
    return np.array(commands), memory


def only(**changes):
    """Gains of one term, and no limit that is in the way."""
    none = np.zeros(3)
    return gains(**{"p": none, "i": none, "d": none, "limit": 1e9, "integral_limit": 1e9, **changes})


def test_the_integral_stops_at_its_limit_and_leaves_it_at_the_first_error_of_the_other_sign():
    """Anti-windup: 10 s of an error of 1 m would be 10 m s; after the turn it takes 0.5 s, not 10 s, to reach zero."""
    errors = np.concatenate([np.ones(500), -np.ones(50)])
    commands, _ = tracked(only(i=np.ones(3), integral_limit=0.5), errors)
    assert commands[:25] == pytest.approx(0.02 * np.arange(1, 26))
    assert commands[25:500] == pytest.approx(0.5)
    assert commands[500] == pytest.approx(0.48) and commands[524] == pytest.approx(0.0, abs=1e-12)
    mirrored, _ = tracked(only(i=np.ones(3), integral_limit=0.5), -errors)
    np.testing.assert_array_equal(mirrored, -commands)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_a_corrupted_integral_is_dropped_or_clamped_in_one_step(value):
    odometry, memory, command = np.zeros(13), np.zeros(pid.MEMORY_WIDTH), np.empty(4)
    odometry[6], memory[:3] = 1.0, value
    pid.track(np.zeros(11), odometry, memory, only(i=np.ones(3), integral_limit=0.5), 0.02, command)
    assert np.abs(command[:3]).max() <= np.sqrt(3) * 0.5 and np.abs(memory[:3]).max() <= 0.5


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_corrupted_last_error_costs_one_derivative(value):
    law = only(d=np.full(3, 0.3))
    odometry, memory, command = np.zeros(13), np.zeros(pid.MEMORY_WIDTH), np.empty(4)
    odometry[6], memory[3:6], memory[6] = 1.0, value, 1.0
    pid.track(np.zeros(11), odometry, memory, law, 0.02, command)
    np.testing.assert_array_equal(command[:3], 0.0)
    pid.track(np.ones(11), odometry, memory, law, 0.02, command)
    np.testing.assert_allclose(command[:3] - 1.0, 0.3 * 1.0 / 0.02)
