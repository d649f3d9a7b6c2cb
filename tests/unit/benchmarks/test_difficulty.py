import pytest

from benchmarks import difficulty
from mavfi.campaign.flights import Row
from mavfi.campaign.plan import PHASE_GOLDEN, PHASE_INJECTED, RunSpec
from mavfi.faults.fault import Fault, FaultSite
from mavfi.sim.environments import build_world

FAULT = Fault("state", FaultSite("planning.waypoint", "x", None), 1_000_000, 62)


def record(success=True, time_s=30.0):
    return {"end": "flown", "success": success, "flight_time_s": time_s}


def golden(seed, own):
    return Row(RunSpec(PHASE_GOLDEN, "golden", "density05", seed, "key"), own, None, own)


def struck(seed, own, twin, target="flag"):
    spec = RunSpec(PHASE_INJECTED, "fi", "density05", seed, "key", target, seed, FAULT)
    return Row(spec, own, twin, twin)


def cells():
    good, lost = record(), record(success=False)
    rows = [
        golden(1, good), golden(2, record(time_s=40.0)), golden(3, lost),
        struck(1, lost, good), struck(2, record(time_s=32.0), good), struck(3, lost, lost),
        struck(1, record(time_s=31.0), good, "epochs"),
    ]  # fmt: skip
    return [
        difficulty.Cell(stack, v, "density05", 0.05, rows) for stack in difficulty.STACKS for v in difficulty.SPEEDS
    ]


def test_the_effect_is_that_of_missions_whose_golden_flight_arrives():
    cell = cells()[0]
    assert (cell.golden.successes, cell.golden.n, cell.median_time) == (2, 3, 35.0)
    assert (cell.effect(difficulty.fails, "flag").successes, cell.effect(difficulty.fails, "flag").n) == (1, 2)
    slower = cell.effect(difficulty.fails_or_slower)
    assert (slower.successes, slower.n) == (2, 3)
    assert cell.effect(difficulty.fails, "nothing").rate is None


def test_page_and_picture_come_from_the_cells(tmp_path):
    source = {"directory": tmp_path, "digest": "0123456789abcdef0", "versions": {"mavfi": "1"}}
    page = difficulty.page(cells(), [source], 3)
    assert "50 [9, 91] 1/2" in page and "`0123456789abcdef`" in page and "| flag | epochs |" in page
    difficulty.draw(cells(), tmp_path / "figure.png")
    assert 5_000 < (tmp_path / "figure.png").stat().st_size < 120_000


def test_the_sweep_covers_both_stacks_on_evaluation_seeds():
    campaigns = dict((path.name, campaign) for campaign, path in difficulty.campaigns(2))
    assert {"published-3", "published-6", "hardened-3", "hardened-6"} <= set(campaigns)
    assert all(campaign.first_seed >= 10_000 and campaign.flights == 2 for campaign in campaigns.values())


@pytest.mark.parametrize("name", ("density05", "density15", "density25", "density35"))
def test_the_densities_are_what_their_names_say(name):
    environment = difficulty.find_environment(name)
    world = build_world(environment, 10_000)
    covered = 100.0 * len(world.lower) / (120.0 * 60.0 - 288.0)
    assert abs(covered - int(name[-2:]) / 100) < 0.01
    assert environment.parameters["gap"] == 2.0
