"""What is judged of one run, from its record and the golden one."""

from dataclasses import replace

import pytest

from mavfi.analysis.rows import SCHEMA
from mavfi.analysis.runs import Runs
from mavfi.faults.fault import NO_SITE
from mavfi.record import EnergyTerms, Injection, KernelEffect
from tests.core.unit.analysis.handmade import (
    DUE,
    FAULT,
    GOLDEN,
    INSTRUCTION,
    UNKNOWN,
    alarm,
    died,
    flown,
    golden,
    injected,
    null,
    row,
    runs,
)


def test_runs_that_did_not_end_well():
    due, unknown = row(DUE), row(UNKNOWN)
    assert (due["effect"], due["status"], due["success"], due["judged"]) == ("crash", "due", False, True)
    assert (unknown["effect"], unknown["status"], unknown["judged"]) == ("unknown", "unknown", False)
    assert row(replace(DUE, kernel=KernelEffect("hang")))["effect"] == "hang", "a process that says how it died"


def test_effects_compare_with_the_golden_run():
    assert (row(GOLDEN)["effect"], row(flown())["effect"]) == ("masked", "sdc")
    orphan = row(flown(), twin=None)
    assert (orphan["effect"], orphan["inflation"], orphan["golden_success"]) == ("unknown", None, None)


def test_where_faults_went():
    assert row(flown())["site_outcome"] == "activated"
    assert row(flown(activated=False))["site_outcome"] == "not_activated"
    assert row(DUE)["site_outcome"] == "activated"
    assert row(GOLDEN, replace(FAULT, time_us=NO_SITE))["site_outcome"] == "no_site"


def test_golden_runs_that_are_not_known_give_no_pair():
    assert row(flown())["golden_success"] is True
    assert row(flown(), twin=UNKNOWN)["golden_success"] is None
    assert row(flown(), twin=DUE)["golden_success"] is False


def test_time_and_energy_are_compared_where_both_succeed():
    slow = row(flown(flight_time_s=60.0, energy=EnergyTerms(duration_s=75.0)))
    assert (slow["inflation"], slow["energy_inflation"]) == (pytest.approx(0.2), pytest.approx(0.5))
    assert row(flown(success=False))["inflation"] is None
    assert row(flown(), twin=replace(GOLDEN, status="collision"))["inflation"] is None


def test_time_is_compared_with_the_golden_run_without_a_detector():
    campaign_runs = runs(
        golden(1),
        golden(1, replace(GOLDEN, flight_time_s=100.0, digest="d"), arm="gaussian"),
        injected(1, flown(digest="d", flight_time_s=60.0), arm="gaussian"),
    )
    [entry] = campaign_runs.injected
    assert entry["inflation"] == pytest.approx(0.2)
    assert entry["effect"] == "masked", "compared with the golden run of its own arm"


def test_a_death_is_a_lost_mission_only_where_missions_end_with_it():
    entry = row(died(), INSTRUCTION)
    assert (entry["success"], entry["success_if_ended"], entry["kernel_effect"]) == (True, False, "crash")
    assert row(flown(kernel=KernelEffect("sdc")), INSTRUCTION)["success_if_ended"]


@pytest.mark.parametrize(
    ("alarms", "twins", "at_site", "downstream", "after"),
    [
        ([alarm(0.3)], [], True, True, 0.0),
        ([alarm(0.1 + 0.2)], [], True, True, 0.0),  # 0.30000000000000004: the same microsecond
        ([alarm(0.3 - 1e-9)], [], True, True, 0.0),
        ([alarm(0.3, "control.command")], [], False, True, 0.0),
        ([alarm(0.4, "control.command")], [alarm(0.4, "control.command")], False, False, None),
        ([alarm(0.4)], [], False, True, 0.1),
        ([alarm(1.4), alarm(0.2)], [], False, False, 1.1),
        ([], [], False, False, None),
    ],
)
def test_only_alarms_on_the_corrupted_publication_detect_the_fault(alarms, twins, at_site, downstream, after):
    campaign_runs = runs(
        golden(1), golden(1, replace(GOLDEN, alarms=tuple(twins)), arm="g"), injected(1, flown(alarms=alarms), arm="g")
    )
    [entry] = campaign_runs.injected
    assert (entry["detected_at_site"], entry["detected_downstream"]) == (at_site, downstream)
    assert entry["alarm_after_s"] == (None if after is None else pytest.approx(after))


def test_sites_of_every_level():
    state = row(flown())
    assert (state["level"], state["stage"], state["kernel"]) == ("state", "planning", "waypoint")
    assert (state["state"], state["field"], state["bit_class"]) == ("planning.waypoint", "x", "exponent")
    assert (state["population"], state["monitored"]) == ("sign_exponent", True)
    details = {"opcode": "fmul", "type": "double", "variable": "v", "replayable": True}
    call = Injection("instruction", "pid.track", 1.0, 3, 1.0, "nan", True, "a.py", 9, details)
    campaign_runs = row(flown(injections=(call,)), INSTRUCTION)
    assert (
        campaign_runs["stage"],
        campaign_runs["kernel"],
        campaign_runs["function"],
        campaign_runs["population"],
    ) == ("control", "pid", "track", "all_bits")
    assert (campaign_runs["file"], campaign_runs["line"], campaign_runs["opcode"], campaign_runs["value_type"]) == (
        "a.py",
        9,
        "fmul",
        "double",
    )
    assert campaign_runs["after"] != campaign_runs["after"] and campaign_runs["replayable"]


def test_every_run_has_every_column_and_runs_that_are_not_flown_are_left_out():
    campaign_runs = runs(golden(1), injected(1, flown()), null(1, GOLDEN), golden(2, None))
    assert campaign_runs.frame.columns == list(SCHEMA) and len(campaign_runs) == 3
    assert [len(part) for part in (campaign_runs.golden, campaign_runs.injected, campaign_runs.null)] == [1, 1, 1]
    assert campaign_runs.recorded()[0] is GOLDEN
    empty = Runs.of([])
    assert len(empty) == 0 and empty.settings() == [] and empty.frame.columns == list(SCHEMA)
