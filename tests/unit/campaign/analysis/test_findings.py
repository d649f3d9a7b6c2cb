from mavfi.campaign.analysis import views_for
from mavfi.campaign.analysis.findings import MOST, findings
from mavfi.campaign.analysis.runs import Runs
from tests.unit.campaign.analysis.handmade import DUE, GOLDEN, INSTRUCTION, died, flown, golden, injected, runs


def test_the_headline_is_the_success_table_and_five_sentences(fake):
    sentences = findings(fake)
    assert views_for(fake)[0].name == "success_as_in_the_paper"
    assert len(sentences) == MOST
    assert sentences[0].startswith(
        "Without a fault 100.0 % [83.9, 100.0] of missions succeed, with one fault (sign + exp"
    )
    assert any("gaussian brings back" in line and "newly loses 0" in line for line in sentences)
    assert any(line.startswith("Missions that fail or take more than 5 % longer, by stage") for line in sentences)


def test_figures_are_those_of_the_frame():
    own = runs(golden(1), golden(2), injected(1, flown(success=False)), injected(2, flown(digest="g")))
    sentences = findings(own)
    assert "the fault loses 1 of 2 missions and saves 0" in sentences[0]
    half = "50.0 % [9.5, 90.5]"
    assert sentences[1] == f"{half} of 2 faults leave the flight as it was, bit for bit, {half} change it silently."


def test_kernels_that_die_are_said():
    own = runs(golden(1), golden(2), injected(1, died(), INSTRUCTION), injected(2, GOLDEN, INSTRUCTION))
    assert any(
        line.startswith("1 of 2 faults kill their kernel; if a dead node ended the mission") for line in findings(own)
    )


def test_flights_that_end_in_a_crash_have_a_share_with_interval():
    own = runs(golden(1), golden(2), injected(1, DUE), injected(2, flown()))
    assert any(line.endswith(", 50.0 % [9.5, 90.5] end in a crash or a hang.") for line in findings(own))


def test_nothing_flown_says_nothing():
    assert (views_for(Runs.of([])), findings(Runs.of([]))) == ([], [])
    assert findings(runs(golden(1))) == []
