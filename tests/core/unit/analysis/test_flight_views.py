"""Tables of a campaign with faults in states: they add up, and agree with the frame."""

import pytest

from mavfi.analysis import published as paper
from mavfi.analysis.flight_views import separable_note
from mavfi.analysis.table import RATE
from mavfi.analysis.views import table
from tests.core.unit.analysis.handmade import DUE, UNKNOWN, flown, golden, injected, runs


def entries(runs, name, **wanted):
    return [e for e in table(runs, name).entries() if all(e[key] == value for key, value in wanted.items())]


def test_success_table(fake):
    for environment in ("sparse", "dense"):
        [without] = entries(fake, "success", environment=environment, setting="golden")
        assert (without["success"].n, without["success"].rate) == (10, 1.0)
        [faulty] = entries(fake, "success", environment=environment, setting="fi")
        counts = [faulty[key].n for key in ("success", "success_whole_word", "success_mantissa")]
        assert counts == [39, 60, 21]
        cell_runs = fake.where(environment=environment, setting="fi", stratum="sign_exponent")
        assert faulty["success"].successes == sum(cell_runs["success"]) < len(cell_runs)
        assert faulty["paper"] == paper.success(environment, "fi")
        whole = faulty["success_whole_word"]
        assert whole.low <= whole.rate <= whole.high


def test_the_papers_layout_holds_the_same_rates(fake):
    rows = {(row[0], row[1]): row[2:] for row in table(fake, "success_as_in_the_paper").rows}
    assert list(rows)[:3] == [("Golden run", "here"), ("Golden run", "paper"), ("Injection run", "here")]
    assert ("Gaussian-based", "here") in rows
    assert list(rows["Injection run", "here"]) == [
        entries(fake, "success", environment=name, setting="fi")[0]["success"] for name in ("sparse", "dense")
    ]


@pytest.mark.parametrize("name", ["by_stage", "by_state", "by_bits"])
def test_tables_by_property_part_the_faults(fake, name):
    whole = [e["success"].n if e["success"] else 0 for e in entries(fake, name, setting="fi")]
    rest = [e["success_mantissa"].n if e["success_mantissa"] else 0 for e in entries(fake, name, setting="fi")]
    assert sum(whole) + sum(rest) == 2 * 60


def test_who_is_hurt_has_interval_n_and_the_runs_behind_it(fake):
    hurt_table = table(fake, "by_stage")
    hurt_column = [column.key for column in hurt_table.columns].index("hurt")
    assert hurt_table.columns[hurt_column].form == RATE
    for row, behind in zip(hurt_table.rows, hurt_table.behind, strict=True):
        assert row[hurt_column].low < row[hurt_column].high and row[hurt_column].n == len(behind[hurt_column])
    assert sum(rate.n for rate in hurt_table.column("hurt")) < len(fake.injected), "of the first column's bits alone"


def test_effects_and_endings_add_up(fake):
    [entry] = entries(fake, "endings", environment="dense", setting="fi")
    assert entry["success"] + entry["collision"] == entry["n"] == 60
    for entry in table(fake, "outcomes").entries():
        assert sum(entry[name] for name in ("masked", "sdc", "due", "unknown")) == entry["n"] == 60
        assert entry["activated"] + entry["no_site"] + entry["not_activated"] == entry["n"]
        assert entry["due"] == entry["unknown"] == 0
    no_site = fake.where(site_outcome="no_site", setting="fi")
    assert len(no_site), "missions without an acted-on collision status are in the plan"
    assert no_site.values("effect") == ["masked"]


def test_a_difference_of_rates_is_no_more_than_100_points():
    few = runs(golden(1), golden(2), *(injected(seed, flown(success=seed > 1)) for seed in range(1, 3)))
    assert separable_note(few) == [
        "smaller differences, in points, are not distinguished (golden – fi / fi – dr, power 80 %): sparse 100 / 100"
    ]


def test_unknown_flights_are_counted_apart():
    campaign_runs = runs(golden(1), injected(1, flown()), injected(2, DUE), injected(3, UNKNOWN))
    [_, entry] = table(campaign_runs, "success").entries()
    assert (entry["success"].n, entry["success"].successes) == (2, 1)
    assert any(note.startswith("1 flights could not be judged") for note in table(campaign_runs, "success").notes)


def test_recovery_and_paired_tests(fake):
    [entry] = entries(fake, "recovery", environment="all", setting="dr_gaussian", bits="sign + exponent")
    assert entry["newly_lost"] == 0 and entry["only_dr"] > 0
    assert entry["recovery"].rate == pytest.approx(1.0)
    assert entry["recovery"].low < 1.0, "a few missions prove nothing"
    assert entry["lost"] == entry["brought_back"] == entry["only_dr"]


def test_undefined_recovery_is_said_so():
    campaign_runs = [golden(1), injected(1, flown()), injected(1, flown(), arm="gaussian")]
    [entry] = table(runs(*campaign_runs), "recovery").entries()
    assert (entry["recovery"], entry["lost"], entry["brought_back"], entry["newly_lost"]) == ("no estimate", 0, 0, 0)


def test_false_alarms_have_exposure_and_bound(fake):
    [entry] = entries(fake, "false_alarms", environment="all", setting="golden_gaussian")
    watched = fake.where(setting="golden_gaussian")
    assert (entry["flights"], entry["systematic"]) == (20, 0)
    assert entry["alarms"] == sum(seed % 3 == 0 for seed in watched["seed"])
    assert entry["hours"] == pytest.approx(sum(watched["flight_time_s"]) / 3600)
    assert entry["upper"] > entry["per_hour"].per_hour
    assert entry["kinds"] == f"recompute accepted {entry['alarms']}"


def test_detections(fake):
    entries = table(fake, "detections").entries()
    assert {entry["detected"].rate for entry in entries} == {entry["downstream"].rate for entry in entries} == {1.0}
    assert {entry["in_monitored_set"] for entry in entries} == {"yes", "no"}


def test_tables_on_faults_say_that_rates_are_conditional(fake):
    expected = "rates are conditional on one fault per mission"
    for name in ("success", "recovery", "flight_times", "by_stage"):
        assert expected in table(fake, name).notes
    assert any("recovery equals detection by construction" in note for note in table(fake, "recovery").notes)
    assert paper.STATE_LEVEL in table(fake, "success").notes
