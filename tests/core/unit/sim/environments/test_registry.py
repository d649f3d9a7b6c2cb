"""From configurations to worlds, and what users get wrong."""

from dataclasses import replace

import numpy as np
import pytest

from mavfi.config import EnvironmentConfig, shipped
from mavfi.errors import BadInputError
from mavfi.sim.environments import build_world, environment_for_file


def environment(generator="cuboids", **parameters):
    return EnvironmentConfig(name="mine", generator=generator, parameters=parameters)


def message(*arguments, **keywords):
    with pytest.raises(BadInputError) as caught:
        build_world(*arguments, **keywords)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_start_and_goal_can_be_given():
    config = shipped("environments", EnvironmentConfig, "farm")
    world = build_world(config, 0, start=(5.0, 0.0, 8.0), goal=(100.0, 1.0, 8.0))
    np.testing.assert_array_equal((world.start, world.goal), ((5.0, 0.0, 8.0), (100.0, 1.0, 8.0)))
    np.testing.assert_array_equal(world.lower, build_world(config, 0).lower)


def test_a_goal_that_the_collision_sphere_would_not_fit_is_refused():
    config = shipped("environments", EnvironmentConfig, "dense")
    world = build_world(config, 0)
    outside = np.array([world.lower[0, 0] - 0.2, *(0.5 * (world.lower[0] + world.upper[0]))[1:]])
    assert "goal" in message(config, 0, goal=tuple(outside))


@pytest.mark.parametrize("goal", ((500.0, 0.0, 3.0), (60.0, 0.0, 11.0), (60.0, 0.0, 0.5), (float("nan"), 0.0, 3.0)))
def test_a_goal_outside_of_the_flight_volume_is_refused(goal):
    text = message(shipped("environments", EnvironmentConfig, "farm"), 0, goal=goal)
    assert "goal" in text and "flight volume" in text and "x 1 to 119" in text


@pytest.mark.parametrize(
    "generator", ("no_such_package:worlds", "mavfi.sim.environments.generated:barn", "math:pi", "swamp")
)
def test_a_function_that_cannot_be_had_is_refused(generator):
    assert generator in message(environment(generator), 0)


def test_an_unknown_or_missing_parameter_is_named_with_what_is_allowed():
    text = message(environment(density=0.1, side=6.0, hight=3.0), 0)
    assert "hight" in text and "density, side" in text
    assert "side" in message(environment(density=0.1), 0)


@pytest.mark.parametrize(
    "parameters",
    (
        {"density": float("nan"), "side": 6.0},
        {"density": 0.9, "side": 6.0},
    ),
)
def test_impossible_parameters_are_refused_by_name(parameters):
    text = message(environment(**parameters), 0)
    assert "mine" in text and ("density" in text or "side" in text)


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [
        ([[3.0, 0.0, 0.0]], [[2.0, 1.0, 1.0]], "box 0: (3, 0, 0) to (2, 1, 1); allowed: finite corners"),
        ([[1.0, 0, 0], [2.0, 0, np.nan]], [[2.0, 1, 1], [3.0, 1, 1]], "box 1: (2, 0, nan) to (3, 1, 1)"),
        ([[1.0, 0.0]], [[2.0, 1.0]], "boxes of shapes (1, 2) and (1, 2); allowed: (n, 3) both"),
    ],
)
def test_boxes_that_are_none_are_refused_with_their_generator(monkeypatch, lower, upper, expected):
    world = build_world(shipped("environments", EnvironmentConfig, "farm"), 0)
    wrong = replace(world, lower=np.array(lower), upper=np.array(upper))
    monkeypatch.setattr("mavfi.sim.environments.registry.find_generator", lambda name: lambda seed: wrong)
    assert f"environment 'mine': generator own: {expected}" in message(environment("own"), 0)


def test_the_example_builds_a_world():
    config = environment("examples.environment_gates:gates", count=3)
    world = build_world(config, 1)
    assert len(world.lower) == 6


def test_other_files_are_no_scanned_maps(tmp_path):
    with pytest.raises(BadInputError, match="allowed"):
        environment_for_file(str(tmp_path / "house.ply"))
    with pytest.raises(BadInputError, match="no such file"):
        environment_for_file(str(tmp_path / "house.bt"))
