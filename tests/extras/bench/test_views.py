"""Schemes on the same faults: what is lost, brought back, newly lost, detected."""

import pytest
from scipy.stats import binomtest

from mavfi.analysis import VIEWS
from mavfi.faults.fault import FaultSite, StateFault
from mavfi.faults.levels.sensor.fault import SensorFault
from tests.core.unit.analysis.handmade import GOLDEN, INSTRUCTION, alarm, died, flown, golden, injected, runs


def row(own, name="schemes", arm="one"):
    return {entry["scheme" if "scheme" in entry else "arm"]: entry for entry in VIEWS[name].table(own).entries()}[arm]


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
    found = row(runs(*scenario()))
    assert (found["pairs"], found["lost"]) == (5, 2)
    assert (found["back"].successes, found["back"].n) == (1, 2)
    assert (found["late_in_time"].successes, found["late_in_time"].n) == (1, 1)
    assert (found["detected"].successes, found["detected"].n) == (1, 2)
    assert found["newly_lost"] == 1
    assert found["p"] == 1.0, "one mission only with the scheme, one only without"


def test_what_comes_back_of_faults_in_monitored_fields():
    epoch = StateFault(FaultSite("planning.path", "future_collision_seq"), 1, 3)
    faults = [*pair(1, LOST, flown()), *pair(2, LOST, LOST), *pair(3, LOST, flown(), fault=epoch)]
    own = [golden(seed, arm=arm) for seed in range(1, 4) for arm in ("", "one")]
    found = row(runs(*own, *faults))
    assert (found["back"].successes, found["back"].n) == (2, 3)
    assert (found["back_monitored"].successes, found["back_monitored"].n) == (1, 2), "only way-points are monitored"


def test_the_p_value_is_that_of_the_binomial_test_of_discordant_pairs():
    faults = [pair(seed, LOST, flown()) for seed in range(1, 8)] + [pair(8, flown(), LOST), pair(9, LOST, LOST)]
    own = [golden(seed, arm=arm) for seed in range(1, 10) for arm in ("", "one")]
    found = row(runs(*own, *(run for both in faults for run in both)))
    assert found["p"] == pytest.approx(binomtest(1, 8).pvalue)


def test_the_ranking_of_detectors_is_tested_on_the_same_faults():
    ends = [(LOST, flown(), flown()), (LOST, LOST, flown()), (LOST, LOST, flown()), (LOST, flown(), LOST)]
    arms = ("", "autoencoder all", "limits")
    own = [golden(seed, arm=arm) for seed in range(1, 5) for arm in arms]
    own += [
        injected(seed, end, arm=arm) for seed, every in enumerate(ends, 1) for arm, end in zip(arms, every, strict=True)
    ]
    notes = VIEWS["schemes"].table(runs(*own)).notes
    assert "autoencoder all against limits: missions that only one of them flies to the end 1 : 2 of 4, p = 1" in notes
    assert not any(note.startswith("autoencoder against") for note in notes)


def test_a_golden_flight_that_only_the_scheme_loses_counts():
    own = [run for run in scenario() if not (run.spec.kind == "golden" and run.spec.arm and run.spec.seed == 5)]
    assert row(runs(*own, golden(5, flown(success=False), arm="one")))["newly_lost"] == 2


def test_false_alarms_are_those_of_golden_flights():
    own = [run for run in scenario() if not (run.spec.kind == "golden" and run.spec.arm and run.spec.seed == 5)]
    noisy = golden(5, flown(injections=(), alarms=[alarm(1.0)], alarms_total=1), arm="one")
    found = row(runs(*own, noisy))
    assert found["per_hour"].events == 1
    assert found["hours"] == 5 * 50.0 / 3600


def test_at_instruction_level_what_died_stands_apart():
    own = [golden(1), golden(2), golden(1, arm="one"), golden(2, arm="one")]
    own += [*pair(1, died(success=False), died(), fault=INSTRUCTION), *pair(2, LOST, LOST, fault=INSTRUCTION)]
    found = runs(*own)
    entry = row(found, "schemes_instructions")
    assert (entry["died_back"].successes, entry["died_back"].n) == (1, 1)
    assert (entry["sdc_back"].successes, entry["sdc_back"].n) == (0, 1)


def test_at_instruction_level_a_fault_that_meets_another_value_is_not_the_schemes_harm():
    own = [golden(seed, arm=arm) for seed in (1, 2, 3, 4) for arm in ("", "one")]
    elsewhere = flown(success=False, time_s=0.4)
    own += [
        *pair(1, flown(), LOST, fault=INSTRUCTION),
        *pair(2, flown(), elsewhere, fault=INSTRUCTION),
        *pair(3, LOST, elsewhere, fault=INSTRUCTION),
        *pair(4, LOST, flown(time_s=0.4), fault=INSTRUCTION),
    ]
    entry = row(runs(*own), "schemes_instructions")
    assert (entry["pairs"], entry["same_value"], entry["newly_lost"], entry["lost_under"]) == (4, 1, 1, 3)
    assert (entry["lost"], entry["back"].n, entry["sdc_back"].n, entry["p"]) == (2, 0, 0, 1.0), "nor its merit"
    assert row(runs(*own), "schemes")["newly_lost"] == 2


def test_the_time_to_an_alarm_is_that_of_lost_missions():
    own = [golden(seed, arm=arm) for seed in (1, 2, 3) for arm in ("", "one")]
    for seed, (end, after) in enumerate([(LOST, 0.2), (LOST, 0.4), (flown(), 9.0)], 1):
        own += pair(seed, end, flown(alarms=[alarm(0.3 + after)], alarms_total=1))
    assert row(runs(*own))["alarm_after"] == pytest.approx(0.3)


def test_missions_that_are_lost_anyway_are_nobodys():
    own = [golden(1, flown(success=False)), golden(1, arm="one"), *pair(1, LOST, GOLDEN)]
    assert row(runs(*own))["lost"] == 0


def lasting_scenario():
    """One fault that comes back once and is lost for ever, one that only the scheme loses for ever; a golden loss."""
    once, stuck = {"target": "x, once"}, {"target": "x, for ever"}
    own = [*pair(1, LOST, flown(), **once), *pair(1, LOST, LOST, **stuck), *pair(2, flown(), LOST, **stuck)]
    return runs(golden(1), golden(2), golden(1, flown(success=False), arm="one"), golden(2, arm="one"), *own)


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


def test_a_vehicle_is_saved_that_ends_in_the_air():
    ended = {"x, once": flown(success=False, status="timeout"), "x, 1 s": flown(), "x, 10 s": LOST}
    own = [run for target, end in ended.items() for run in pair(1, LOST, end, target=target)]
    own += pair(1, flown(success=False, status="timeout"), flown(), target="x, for ever")
    found = VIEWS["schemes_by_duration"].table(runs(golden(1), golden(1, arm="one"), *own)).entries()
    saved = {entry["duration"]: entry["vehicle_saved"] for entry in found}
    assert [(rate.successes, rate.n) for rate in saved.values() if rate.n] == [(1, 1), (1, 1), (0, 1)]
    assert saved["for ever"].n == 0, "there the vehicle is not lost without the scheme"


def test_by_site_only_flights_with_a_fault_count():
    entries = VIEWS["schemes_by_target"].table(lasting_scenario()).entries()
    assert [(entry["target"], entry["newly_lost"]) for entry in entries] == [("x, once", 0), ("x, for ever", 1)]


def test_failing_sensors_have_a_view_of_their_own():
    failing = {"fault": SensorFault("gyro", "drift", 1_000_000), "target": "gyro"}
    own = [golden(seed, arm=arm) for seed in (1, 2, 3) for arm in ("", "one")]
    own += [*pair(1, LOST, flown(), **failing), *pair(2, LOST, LOST, **failing), *pair(3, flown(), LOST, **failing)]
    entry = row(runs(*own), "schemes_sensor")
    assert (entry["pairs"], entry["lost"], entry["lost_under"], entry["newly_lost"]) == (3, 2, 2, 1)
    assert (entry["back"].successes, entry["back"].n, entry["hours"]) == (1, 2, 3 * 50.0 / 3600)
    assert VIEWS["schemes_sensor"].applies(runs(*own)) and not VIEWS["schemes_sensor"].applies(runs(*scenario()))
