"""Every key of a mission is an option of the verbs that fly one."""

from collections.abc import Callable

import pytest
import typer
from typer.testing import CliRunner

from mavfi.cli.options import mission_of, option_name, with_mission_options
from mavfi.errors import BadInputError
from mavfi.mission import LARGEST_SEED, MissionSpec

VALUES = {
    "environment": "dense",
    "seed": 7,
    "start": (1.0, 2.0, 3.0),
    "goal": (9.0, 2.0, 3.0),
    "autopilot": "hardened",
    "planner": "rrt",
    "platform": "cortex-a57",
    "map": "octree",
    "map_resolution": 0.4,
    "unknown_space": "free",
    "camera_range": 15.0,
    "vehicle": "small_quad",
    "v_max": 2.0,
    "arrival_radius": 8.0,
    "time_limit_factor": 9.0,
    "latency_jitter": 1.0,
    "planner_latency": 3.0,
    "depth_noise": 0.1,
    "wind": 3.0,
    "localization": "estimator",
    "coupling": "observer",
    "detector_place": "published",
    "dead_node": "readback",
    "alarm": "repeated",
    "epoch_liveness": 2.0,
    "grain": "kernel",
    "same_twice": "escalate",
    "answer_s": 0.6,
    "degraded": "hold",
    "trajectory": "package.module:Class",
    "waypoint": "package.module:Class",
    "pid": "package.module:Class",
    "flight_controller": "package.module:Class",
    "protection": "full",
    "trained_for": "published/i9-9940x",
}


@pytest.fixture
def fly() -> Callable[..., MissionSpec]:
    """A verb; gives the mission that its arguments ask for."""
    requests = []
    app = typer.Typer()

    @app.command()
    @with_mission_options
    def verb(mission: MissionSpec, loud: bool = False) -> None:
        requests.append((mission, loud))

    def call(*arguments):
        CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
        return requests.pop()

    return call


def arguments_for(name):
    value = VALUES[name]
    return [option_name(name), *(value if isinstance(value, tuple) else (value,))]


def test_each_key_is_an_option(fly):
    assert fly() == (MissionSpec(), False)
    for name, value in VALUES.items():
        mission, loud = fly(*arguments_for(name), "--loud")
        assert mission == MissionSpec(**{name: value}) != MissionSpec() and loud
        assert MissionSpec.model_fields[name].description, name


def test_what_is_set_is_known_even_if_it_is_the_default(fly):
    mission, _ = fly("--grain", "stage", "--seed", "5")
    assert mission.model_fields_set == {"grain", "seed"}


def test_all_options_together(fly):
    mission, _ = fly(*[part for name in VALUES for part in arguments_for(name)])
    assert mission == MissionSpec(**VALUES)
    assert set(VALUES) == set(MissionSpec.model_fields)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, f"--seed: -1: allowed: 0 to {LARGEST_SEED}"),
        ({"wind": 31.0}, "--wind: 31.0: allowed: 0 to 30"),
        ({"v_max": float("inf")}, "--v-max: inf: allowed: 0.1 to 20"),
        ({"localization": "gps"}, "--localization: 'gps': not known; allowed: truth, estimator"),
        ({"start": (float("nan"), 0.0, 1.0)}, "--start: nan 0.0 1.0: allowed: three finite numbers (m)"),
    ],
)
def test_a_value_that_is_not_allowed_is_named_with_its_option(arguments, message):
    with pytest.raises(BadInputError) as caught:
        mission_of(arguments)
    assert str(caught.value).startswith(message)
