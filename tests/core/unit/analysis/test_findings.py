from dataclasses import replace

from mavfi.analysis import views_for
from mavfi.analysis.findings import MOST, findings
from mavfi.analysis.runs import Runs
from mavfi.faults.fault import FaultSite
from tests.core.unit.analysis.handmade import (
    FAULT,
    GOLDEN,
    INSTRUCTION,
    alarm,
    died,
    flown,
    golden,
    injected,
    runs,
)


def test_figures_are_those_of_the_frame(fake):
    assert len(findings(fake)) == MOST
    assert any("gaussian brings back" in line and "newly loses 0" in line for line in findings(fake))
    own = runs(golden(1), golden(2), injected(1, flown(success=False)), injected(2, flown(digest="g")))
    sentences = findings(own)
    half = "50.0 % [9.5, 90.5]"
    assert (
        f"with one fault (sign + exponent bits) {half} (n = 2): the fault loses 1 of 2 missions and saves 0"
        in sentences[0]
    )
    assert sentences[1] == f"{half} of 2 faults leave the flight as it was, bit for bit, {half} change it silently."


def test_kernels_that_die_are_said():
    own = runs(golden(1), golden(2), injected(1, died(), INSTRUCTION), injected(2, GOLDEN, INSTRUCTION))
    assert (
        "1 of 2 faults kill their kernel; if a dead node ended the mission, 50.0 % [9.5, 90.5] (n = 2) would succeed."
        in findings(own)
    )


def test_stages_are_ordered_by_harm_each_with_its_n():
    lost, late = (injected(seed, flown(success=False), target="a") for seed in (1, 2))
    control = replace(FAULT, where=FaultSite("control.command", "vx"))
    own = runs(golden(1), golden(2), injected(1, flown(), control, target="b"), lost, late)
    assert (
        "Missions that fail or take more than 5 % longer, by stage of the fault (sign + exponent bits): "
        "planning 100.0 % [34.2, 100.0] (n = 2); control 0.0 % [0.0, 79.3] (n = 1)."
    ) in findings(own)


def test_alarms_without_a_fault_have_an_interval_and_the_hours_that_were_flown():
    watched = replace(GOLDEN, alarms=(alarm(1.0), alarm(2.0)), alarms_total=2, flight_time_s=1800.0)
    own = runs(golden(1), golden(1, watched, arm="fake"), injected(1, flown()))
    (line,) = [line for line in findings(own) if line.startswith("Alarms")]
    assert line == "Alarms on flights without a fault: fake 4.0 per hour [0.5, 14.4] (2 in 0.5 h)."


def test_nothing_flown_says_nothing():
    assert (views_for(Runs.of([])), findings(Runs.of([]))) == ([], [])
    assert findings(runs(golden(1))) == []
