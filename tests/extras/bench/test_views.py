"""Schemes on the same faults: what is lost, brought back, newly lost, detected."""

import pytest
from scipy.stats import binomtest

from mavfi.analysis.views import VIEWS
from tests.core.unit.analysis.handmade import INSTRUCTION, alarm, died, flown, golden, injected, runs


def row(campaign_runs, name="schemes", arm="one"):
    return {
        entry["scheme" if "scheme" in entry else "arm"]: entry for entry in VIEWS[name].table(campaign_runs).entries()
    }[arm]


def pair(seed, alone, watched, **more):
    return injected(seed, alone, **more), injected(seed, watched, arm="one", **more)


LOST, LATE, IN_TIME = flown(success=False), flown(flight_time_s=60.0), flown(flight_time_s=51.0)


def scenario():
    """Five faults: two lost of which one comes back, one late that comes in time, one that only the arm loses."""
    faults = [
        pair(1, LOST, flown(alarms=[alarm(0.3)])),
        pair(2, LOST, LOST),
        pair(3, LATE, IN_TIME),
        pair(4, flown(), LOST),
        pair(5, flown(), flown()),
    ]
    bare = [golden(seed) for seed in range(1, 6)]
    return [*bare, *(golden(seed, arm="one") for seed in range(1, 6)), *(run for both in faults for run in both)]


def test_what_is_lost_and_what_comes_back():
    scheme = row(runs(*scenario()))
    assert (scheme["pairs"], scheme["lost"]) == (5, 2)
    assert (scheme["back"].successes, scheme["back"].n) == (1, 2)
    assert (scheme["late_in_time"].successes, scheme["late_in_time"].n) == (1, 1)
    assert (scheme["detected"].successes, scheme["detected"].n) == (1, 2)
    assert scheme["newly_lost"] == 1
    assert scheme["p"] == 1.0, "one mission only with the scheme, one only without"


def test_the_p_value_is_that_of_the_binomial_test_of_discordant_pairs():
    faults = [pair(seed, LOST, flown()) for seed in range(1, 8)] + [pair(8, flown(), LOST), pair(9, LOST, LOST)]
    entries = [golden(seed, arm=arm) for seed in range(1, 10) for arm in ("", "one")]
    scheme = row(runs(*entries, *(run for both in faults for run in both)))
    assert scheme["p"] == pytest.approx(binomtest(1, 8).pvalue)


def test_false_alarms_are_those_of_golden_flights():
    entries = [run for run in scenario() if not (run.spec.kind == "golden" and run.spec.arm and run.spec.seed == 5)]
    noisy = golden(5, flown(injections=(), alarms=[alarm(1.0)], alarms_total=1), arm="one")
    scheme = row(runs(*entries, noisy))
    assert scheme["per_hour"].events == 1
    assert scheme["hours"] == 5 * 50.0 / 3600


def test_at_instruction_level_what_died_stands_apart():
    entries = [golden(1), golden(2), golden(1, arm="one"), golden(2, arm="one")]
    entries += [*pair(1, died(success=False), died(), fault=INSTRUCTION), *pair(2, LOST, LOST, fault=INSTRUCTION)]
    campaign_runs = runs(*entries)
    entry = row(campaign_runs, "schemes_instructions")
    assert (entry["died_back"].successes, entry["died_back"].n) == (1, 1)
    assert (entry["sdc_back"].successes, entry["sdc_back"].n) == (0, 1)


def test_at_instruction_level_a_fault_that_meets_another_value_is_not_the_schemes_harm():
    entries = [golden(seed, arm=arm) for seed in (1, 2, 3, 4) for arm in ("", "one")]
    elsewhere = flown(success=False, time_s=0.4)
    entries += [
        *pair(1, flown(), LOST, fault=INSTRUCTION),
        *pair(2, flown(), elsewhere, fault=INSTRUCTION),
        *pair(3, LOST, elsewhere, fault=INSTRUCTION),
        *pair(4, LOST, flown(time_s=0.4), fault=INSTRUCTION),
    ]
    entry = row(runs(*entries), "schemes_instructions")
    assert (entry["pairs"], entry["same_value"], entry["newly_lost"], entry["lost_under"]) == (4, 1, 1, 3)
    assert (entry["lost"], entry["back"].n, entry["sdc_back"].n, entry["p"]) == (2, 0, 0, 1.0), "nor its merit"
    assert row(runs(*entries), "schemes")["newly_lost"] == 2


def lasting_scenario():
    """One fault that comes back once and is lost for ever, one that only the scheme loses for ever; a golden loss."""
    once, stuck = {"target": "x, once"}, {"target": "x, for ever"}
    entries = [*pair(1, LOST, flown(), **once), *pair(1, LOST, LOST, **stuck), *pair(2, flown(), LOST, **stuck)]
    return runs(golden(1), golden(2), golden(1, flown(success=False), arm="one"), golden(2, arm="one"), *entries)


def test_faults_are_told_apart_by_their_duration():
    entries = VIEWS["schemes_by_duration"].table(lasting_scenario()).entries()
    keys = ("duration", "arm", "pairs", "lost", "lost_under", "newly_lost")
    assert [tuple(entry[key] for key in keys) for entry in entries] == [
        ("once", "one", 1, 1, 0, 0),
        ("for ever", "one", 2, 1, 2, 1),
    ]
    for key in ("back", "vehicle_saved"):
        assert [(entry[key].successes, entry[key].n) for entry in entries] == [(1, 1), (0, 1)]
    assert not VIEWS["schemes_by_duration"].applies(runs(*scenario()))  # groups without one
