import pytest

from mavfi.analysis import VIEWS
from mavfi.analysis import published as paper
from mavfi.extras.paper.redundancy import (
    DesignConfig,
    band,
    find_design,
    performance,
    ratio,
    redundancy_tables,
    schemes,
    shipped_designs,
    summary,
    time_ratio,
)
from tests.core.unit.analysis.handmade import flown, golden, injected, runs


def toy(**changes):
    return DesignConfig(**{"name": "toy", "mass": 1.0, "max_thrust": 20.0, **changes})


def test_the_comparison_has_every_scheme_and_the_papers_figures():
    rows = VIEWS["redundancy"].table(runs(golden(1), injected(1, flown()))).entries()
    assert len(rows) == len(shipped_designs()) * 4
    tmr = {(row["vehicle"], row["calibration"]): row for row in rows if row["scheme"] == "TMR"}
    assert [row["paper"] for row in tmr.values()] == [1.06, 1.06, 1.91, 1.91]
    assert tmr["dji_spark", "logged power"]["time"] == pytest.approx(1.881, abs=1e-3)
    assert tmr["dji_spark", "thermal design power"]["band"].startswith("≥ 1.0"), "at one end it cannot hover"
    assert all(row["time"] == 1 and row["band"] is None for row in rows if row["scheme"] == "autoencoder")
    assert tmr["airsim_uav", "logged power"]["limited"] == 1.0, "it may fly faster than the mission lets it"


def test_detection_costs_what_table_ii_says():
    assert schemes()["Gaussian"] == (1, paper.figure("overhead", environment="dense", setting="dr_gaussian"))
    assert schemes()["autoencoder"] == (1, 0.000062)


def test_model_tables_are_not_those_of_a_profile_and_need_no_flights():
    for name in ("redundancy", "redundancy_band", "redundancy_speeds"):
        notes = VIEWS[name].table(runs(golden(1))).notes
        assert not any(note.startswith("autopilot profile") for note in notes)


def test_the_band_is_the_hull_of_one_parameter_after_the_other():
    own = toy(bands={"processor_power": {"low": 1.0, "high": 9.0}, "sensing_range": {"low": 2.0, "high": 20.0}})
    changes = [("processor_power", 1.0), ("processor_power", 9.0), ("sensing_range", 2.0), ("sensing_range", 20.0)]
    ends = [own.model_copy(update={key: value}) for key, value in changes]
    found = [ratio(one, "TMR") for one in (own, *ends)]
    assert band(own, "TMR") == (min(found), max(found)) and min(found) < ratio(own, "TMR") < max(found)


def test_the_model_meets_published_speeds():
    rows = VIEWS["redundancy_speeds"].table(runs(golden(1))).entries()
    assert [round(row["speed"], 2) for row in rows[:2]] == [row["published"] for row in rows[:2]] == [8.83, 1.57]
    assert all(row["speed"] == pytest.approx(row["published"], rel=0.07) for row in rows)


def test_a_users_own_vehicle_has_no_figure_of_the_paper_and_no_band():
    tables = redundancy_tables([toy()])
    assert [table.name for table in tables] == ["redundancy", "redundancy_speeds"]
    last = tables[0].entries()[-1]
    assert (last["scheme"], last["paper"], last["band"]) == ("TMR", None, None)
    assert last["time"] == pytest.approx(time_ratio(performance(toy(), 3), performance(toy(), 1, 0.000062)))
    assert summary([toy()]) == [f"toy (own): with TMR it takes {last['time']:.2f} times as long as with a detector."]


def test_the_summary_says_the_papers_figure_and_what_cannot_fly():
    said = summary([find_design("dji_spark")])
    assert said == [
        "dji_spark (logged power): with TMR it takes 1.88 times as long as with a detector, band 1.19–2.42; the paper: "
        "1.91 times."
    ]
    assert "with TMR it cannot hover" in summary([toy(max_thrust=11.2)])[0]
