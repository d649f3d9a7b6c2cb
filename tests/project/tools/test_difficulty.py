import polars as pl
import pytest

from mavfi.analysis.runs import Runs
from mavfi.sim.environments import build_world
from tools import difficulty


def row(kind, seed, success, time_s=30.0, target="", golden_success=True):
    inflation = time_s / 30.0 - 1.0 if success and golden_success else None
    return {
        "kind": kind,
        "seed": seed,
        "world": f"density05/{seed}",
        "target": target,
        "success": success,
        "judged": True,
        "golden_success": golden_success,
        "inflation": inflation,
        "flight_time_s": time_s,
        "weight": 1.0,
    }


def cells():
    rows = [
        row("golden", 1, True),
        row("golden", 2, True, 40.0),
        row("golden", 3, False),
        row("injected", 1, False, target="flag"),
        row("injected", 2, True, 32.0, "flag"),
        row("injected", 3, False, target="flag", golden_success=False),
        row("injected", 1, True, 31.0, "epochs"),
    ]
    runs = Runs(pl.DataFrame(rows, infer_schema_length=None))
    return [difficulty.Cell(profile, v, 0.05, runs) for profile in difficulty.PROFILES for v in difficulty.SPEEDS]


def test_the_effect_is_that_of_missions_whose_golden_flight_arrives():
    cell = cells()[0]
    assert (cell.golden.successes, cell.golden.n, cell.median_time) == (2, 3, 35.0)
    flag = cell.effect(difficulty.FAILS, "flag")
    assert (flag.successes, flag.n) == (1, 2)
    slower = cell.effect(difficulty.FAILS_OR_SLOWER)
    assert (slower.successes, slower.n) == (2, 3)
    assert cell.effect(difficulty.FAILS, "nothing").rate is None


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
