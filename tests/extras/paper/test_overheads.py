import json

import pytest

from mavfi.analysis.views import table
from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError
from mavfi.extras.paper import overhead_views, overheads
from mavfi.mission import MissionSpec
from tests.core.unit.analysis.handmade import flown, golden, injected, runs

ROW = {
    "environment": "sparse",
    "arm": "gaussian",
    "stage": "all",
    "detection": 0.01,
    "recovery": 0.02,
    "detection_modelled": 0.0005,
}
MEASURED = {"processor": "a processor", "missions": 2, "rows": [ROW]}


def campaign(**changes):
    content = {"name": "x", "environments": ["sparse"], "arms": {"gaussian": {"detector": "gaussian"}}, **changes}
    return Campaign.model_validate(content)


def watched_runs(**about):
    spent = {
        "compute_us": {"pid": 900, "octomap": 300},
        "recompute_us": {"perception": 200, "planning": 0, "control": 0},
    }
    return runs(golden(1), golden(1, arm="gaussian"), injected(1, flown(**spent), arm="gaussian"), **about)


def test_modelled_shares_by_hand_next_to_the_papers():
    row_of_stage = {row["stage"]: row for row in table(watched_runs(), "overheads_as_in_the_paper").entries()}
    assert row_of_stage["perception"]["modelled"] == row_of_stage["all"]["modelled"] == pytest.approx(200 / 1000)
    assert row_of_stage["control"]["modelled"] == 0
    assert (
        row_of_stage["perception"]["paper_recompute"] == 0.009788
        and row_of_stage["control"]["paper_detection"] == 0.000009
    )
    assert row_of_stage["all"]["paper_sum"] == 0.019218 and row_of_stage["control"]["paper_sum"] is None
    assert row_of_stage["all"]["paper_detection"] is row_of_stage["all"]["paper_recompute"] is None, (
        "it gives the sum alone"
    )
    assert row_of_stage["all"]["measured_detection"] is None, "nothing was measured"
    notes = table(watched_runs(), "overheads_as_in_the_paper").notes
    assert any("detection, modelled, are empty: " in note for note in notes), "elsewhere it may have been measured"
    assert row_of_stage["all"]["modelled_detection"] is row_of_stage["all"]["modelled_sum"] is None
    assert not any("repeats it" in note for note in notes)


def test_medians_of_flights_are_divided_by_the_time_of_the_kernels_and_by_the_modelled_one(monkeypatch):
    flights = iter([2.0, 2.0, 4.0, 8.0])  # the first one compiles

    def cost(scenario, name, profile, models_dir, options):
        kernels = next(flights)
        return overheads.Cost(
            kernels, dict.fromkeys(overheads.STAGES, 0.4), dict.fromkeys(overheads.STAGES, 0.8), 7, 0.0, 10 * kernels
        )

    monkeypatch.setattr(overheads, "cost", cost)
    shown = []
    measured = overheads.measure(campaign(), 3, progress=lambda *done: shown.append(done))
    assert [row["stage"] for row in measured["rows"]] == ["perception", "planning", "control", "all"]
    assert measured["rows"][0]["detection"] == pytest.approx(0.1) and measured["rows"][0]["recovery"] == pytest.approx(
        0.2
    )
    assert measured["rows"][0]["detection_modelled"] == pytest.approx(0.01)
    assert [len(flight) for flight in measured["rows"][0]["flights"]] == [3, 3, 3]
    assert shown == [(1, 3), (2, 3), (3, 3)] and measured["missions"] == 3


def test_without_a_detector_there_is_nothing_to_measure():
    with pytest.raises(BadInputError, match="campaign x: arms: none has a detector"):
        overheads.measure(campaign(arms={}), 1)


def test_measured_shares_are_kept_with_the_ledger(tmp_path):
    assert overhead_views.load(tmp_path) == {}
    overheads.save(MEASURED, tmp_path)
    assert overhead_views.load(tmp_path) == MEASURED
    for damaged in ("{", "[]", json.dumps({"rows": [{}]}), json.dumps({"rows": MEASURED["rows"]})):
        (tmp_path / overheads.FILE).write_text(damaged)
        with pytest.raises(BadInputError, match="overheads.json: is not a file of measured overheads"):
            overhead_views.load(tmp_path)


def test_a_flight_is_measured_by_stage():
    measured = overheads.cost(MissionSpec(environment="sparse", seed=10_000), "gaussian", "paper")
    assert measured.kernels > 0 and measured.judged_count > 1000
    assert measured.compute > 10, "modelled: a map takes 0.28 s, and there are several a second"
    assert all(measured.detection[stage] > 0 for stage in overheads.STAGES)
    assert measured.detection["control"] > measured.detection["planning"], "it publishes most"
    assert measured.recovery["all"] == pytest.approx(sum(measured.recovery[stage] for stage in overheads.STAGES[:-1]))
