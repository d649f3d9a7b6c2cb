from dataclasses import replace

from mavfi.analysis.findings import MAX_SENTENCES, findings
from mavfi.analysis.listing import listing
from mavfi.analysis.runs import Runs
from mavfi.analysis.views import views_for
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

HALF = "50.0 % [9.5, 90.5]"


def figures_of(runs, *texts):
    """The one sentence with these words."""
    [sentence] = [sentence for sentence in findings(runs) if all(word in sentence for word in texts)]
    return sentence


def test_figures_are_those_of_the_frame(fake):
    assert len(findings(fake)) == MAX_SENTENCES
    assert "newly loses 0" in figures_of(fake, "gaussian brings back")
    campaign_runs = runs(golden(1), golden(2), injected(1, flown(success=False)), injected(2, flown(digest="g")))
    assert f"{HALF} (n = 2)" in figures_of(campaign_runs, "loses 1 of 2", "saves 0")
    assert figures_of(campaign_runs, "bit for bit", "silently").count(HALF) == 2


def test_kernels_that_die_are_said():
    campaign_runs = runs(golden(1), golden(2), injected(1, died(), INSTRUCTION), injected(2, GOLDEN, INSTRUCTION))
    assert f"{HALF} (n = 2)" in figures_of(campaign_runs, "1 of 2", "ended the mission")


def test_all_sentences_are_about_one_population():
    """Faults in the mantissa are drawn as well: no sentence mixes them with those that it leads with."""
    mantissa = replace(FAULT, bit=3, stratum="mantissa", weight=0.8125)
    harmless = [injected(seed, flown(digest="g"), mantissa, index=10 + seed) for seed in range(1, 7)]
    campaign_runs = runs(
        *(golden(seed) for seed in range(1, 7)), *(injected(s, flown(s > 2)) for s in range(1, 7)), *harmless
    )
    sentences = findings(campaign_runs)
    assert [sentence for sentence in sentences if "(sign + exponent bits)" not in sentence] == []
    assert figures_of(campaign_runs, "bit for bit").startswith(
        "0.0 % [0.0, 39.0] of 6 faults (sign + exponent bits) leave"
    )
    assert "(n = 6)" in sentences[0]


def test_a_kernel_that_dies_is_not_silent():
    """One word for the kernel, one for the flight: a run whose kernel crashed is no silent corruption."""
    own = runs(golden(1), golden(2), injected(1, died(), INSTRUCTION), injected(2, flown(), INSTRUCTION))
    sentence = figures_of(own, "bit for bit")
    assert f"{HALF} change it silently" in sentence and f"{HALF} change it after a failure that is noticed" in sentence
    words = listing(own, in_words=True).entries()
    assert [(row["effect"], row["kernel_effect"]) for row in words[2:]] == [("changed", "crash"), ("sdc", "")]
    assert [row["effect"] for row in listing(own).entries()[2:]] == ["sdc", "sdc"], "CSV and JSON as stored"


def test_stages_are_ordered_by_harm_each_with_its_n():
    lost, late = (injected(seed, flown(success=False), target="a") for seed in (1, 2))
    control = replace(FAULT, where=FaultSite("control.command", "vx"))
    campaign_runs = runs(golden(1), golden(2), injected(1, flown(), control, target="b"), lost, late)
    figures_of(campaign_runs, "by stage", "planning 100.0 % [34.2, 100.0] (n = 2); control 0.0 % [0.0, 79.3] (n = 1)")


def test_alarms_without_a_fault_have_an_interval_and_the_hours_that_were_flown():
    watched = replace(GOLDEN, alarms=(alarm(1.0), alarm(2.0)), alarms_total=2, flight_time_s=1800.0)
    campaign_runs = runs(golden(1), golden(1, watched, arm="fake"), injected(1, flown()))
    assert "4.0 per hour [0.5, 14.4]" in figures_of(campaign_runs, "Alarms", "2 in 0.5 h")


def test_nothing_flown_says_nothing():
    assert (views_for(Runs.of([])), findings(Runs.of([]))) == ([], [])
    assert findings(runs(golden(1))) == []
