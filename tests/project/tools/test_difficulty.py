import pytest

from mavfi.sim.environments import build_world
from tools import difficulty


def test_the_sweep_covers_both_profiles_on_evaluation_seeds():
    parts = {path.name: campaign for _, _, campaign, path in difficulty.campaigns(2)}
    assert {"published-3", "published-6", "hardened-3", "hardened-6"} <= set(parts)
    assert all(campaign.first_seed >= 10_000 and campaign.missions == 2 for campaign in parts.values())
    spec = parts["hardened-4.5"].spec("density05", 10_000)
    assert (spec.autopilot, spec.v_max) == ("hardened", 4.5)


@pytest.mark.parametrize("name", ("density05", "density15", "density25", "density35"))
def test_the_densities_are_what_their_names_say(name):
    environment = difficulty.find_environment(name)
    world = build_world(environment, 10_000)
    covered = 100.0 * len(world.lower) / (120.0 * 60.0 - 288.0)
    assert abs(covered - int(name[-2:]) / 100) < 0.01
    assert environment.parameters["gap"] == 2.0
