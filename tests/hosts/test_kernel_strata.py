"""Faults in a mission drawn by value class and source line: exact places, weights that lead back, a campaign."""

from collections import Counter

import numpy as np
import pytest
from pydantic import ValidationError

from mavfi.campaign.analysis import analyse
from mavfi.campaign.config import Campaign
from mavfi.campaign.kernel_rows import read_kernel_runs
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.faults.instruction import Locating, Profiling, Resolving
from mavfi.faults.instruction.selection import parse_selection
from mavfi.faults.instruction.stratified import densities, key_of, sizes_of
from mavfi.hosts.compose import make_scenario
from mavfi.hosts.instruction import fly_struck
from mavfi.hosts.kernel_faults import Wish, draw_kernel_faults
from mavfi.hosts.kernel_strata import pick
from mavfi.reports.markdown import report
from tests.unit.faults.instruction.kernels import LOOP, fill, loop

DRAWS, FEW = 2500, 3
CALLS = (4, 23, 11)


def scenario():
    return make_scenario("sparse", 7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0))


@pytest.fixture(scope="module")
def counted():
    """Two functions of a kernel, called several times."""
    twins = {"loop": Profiling(loop), "fill": Profiling(fill)}
    for n in CALLS:
        twins["loop"](LOOP[0], n)
    twins["fill"](np.linspace(0.0, 4.0, 12), 2.0)
    return twins


# ---- picks ----------------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_weighted_picks_are_uniform_over_dynamic_instructions(counted):
    """Of few picks at a time, the mean weight of each stratum is its share; without weights it is the density."""
    sizes = sizes_of(pair for twin in counted.values() for pair in twin.sites())
    whole, wanted = sum(sizes.values()), densities(sizes)
    random = np.random.default_rng(8)
    picks = [chosen for _ in range(DRAWS) for chosen in pick(random, counted, parse_selection("all"), FEW)]
    assert len(picks) == DRAWS * FEW
    weights, hits = Counter(), Counter()
    for chosen in picks:
        weights[key_of(chosen.site)] += chosen.weight
        hits[key_of(chosen.site)] += 1
    for key, size in sizes.items():
        error = np.sqrt(wanted[key] / len(picks))
        assert abs(hits[key] / len(picks) - wanted[key]) < 5 * error
        share = size / whole
        assert abs(weights[key] / len(picks) - share) < 5 * error * share / wanted[key]
    assert max(chosen.weight for chosen in picks) <= 2.0


def test_picks_of_one_mission_are_kept_apart(counted):
    together = Counter()
    for seed in range(200):
        picks = pick(np.random.default_rng(seed), counted, parse_selection("all"), FEW)
        together[len({key_of(chosen.site) for chosen in picks})] += 1
    assert together[FEW] > 150


def test_picks_are_of_the_class_that_was_asked_for_or_none(counted):
    random = np.random.default_rng(1)
    picks = pick(random, counted, parse_selection("floating_point"), 50)
    assert len(picks) == 50 and all(chosen.site.floating for chosen in picks)
    assert pick(random, counted, parse_selection("opcode:fdiv"), 5) == []
    assert pick(random, counted, parse_selection("all"), 0) == []


def test_picks_are_found_again_in_their_calls(counted):
    own = {"loop": counted["loop"]}
    picks = pick(np.random.default_rng(2), own, parse_selection("all"), 60)
    digest = picks[0].digest
    locating = Locating(loop, {digest: [(chosen.site.block, chosen.number) for chosen in picks]})
    for n in CALLS:
        assert locating(LOOP[0], n) == loop(LOOP[0], n)
    places = [locating.place(digest, chosen.site.block, chosen.number) for chosen in picks]
    assert {call for call, _ in places} == {0, 1, 2}
    wanted = {}
    for (call, start), chosen in zip(places, picks, strict=True):
        wanted.setdefault(call, []).append(start + chosen.site.offset)
    resolving = Resolving(loop, wanted)
    for n in CALLS:
        resolving(LOOP[0], n)
    for (call, start), chosen in zip(places, picks, strict=True):
        assert resolving.sites[call, start + chosen.site.offset] == chosen.site


# ---- missions -------------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_faults_of_a_mission_hit_where_they_were_drawn():
    wish = Wish({"pid": 10, "point_cloud": 3}, which="data", sampling="stratified")
    drawn = draw_kernel_faults(scenario(), wish, seed=3)
    assert drawn.faults == draw_kernel_faults(scenario(), wish, seed=3).faults
    faults = [*drawn.faults["pid"], *drawn.faults["point_cloud"]]
    assert [len(own) for own in drawn.faults.values()] == [10, 3]
    assert all(0.0 < fault.weight <= 2.0 for fault in faults) and len({fault.weight for fault in faults}) > 3
    struck = [flight.log.injections[0] for flight in fly_struck(scenario(), faults).flights]
    assert all(injection["hit"] for injection in struck)
    assert len({(injection["line"], injection["value_class"]) for injection in struck[:10]}) > 6


# ---- campaigns ------------------------------------------------------------------------------------------------------
def campaign(**changes):
    kernels = {"names": ["pid"], "which": "data", "sampling": "stratified"} | changes
    return Campaign.model_validate({
        "name": "strata", "environments": ["sparse"], "first_seed": 7, "flights": 2, "faults": 6, "law": "kernels",
        "kernels": kernels, "null_runs": 0, "v_max": 6.0,
    })  # fmt: skip


def test_only_another_sampling_makes_another_campaign():
    plain = campaign(sampling="uniform")
    assert "sampling" not in plain.to_json()["kernels"]
    assert campaign().to_json()["kernels"]["sampling"] == "stratified"
    assert campaign().key() != plain.key()
    with pytest.raises(ValidationError, match="sampling"):
        campaign(sampling="even")


@pytest.mark.slow
def test_rates_of_a_campaign_are_weighted_means(tmp_path):
    assert run_campaign(campaign(), tmp_path, workers=1).complete
    with Store.open(tmp_path) as store:
        runs = read_kernel_runs(store)
    weights = [run.weight for run in runs]
    assert len(runs) == 6 and len(set(weights)) > 2
    analysis = analyse(tmp_path)
    entry = analysis["kernels"]["table"][0]
    assert entry["sdc"]["rate"] == pytest.approx(np.average([run.outcome == "sdc" for run in runs], weights=weights))
    assert sum(entry["counts"].values()) == 6
    text = report(analysis, [], "2026-01-01", {})
    assert "drawn by value class and source line" in text and "weighted back" in text
