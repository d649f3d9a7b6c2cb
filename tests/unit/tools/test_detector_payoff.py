"""Whether a detector pays, from what its own instructions cause in one campaign and what it prevents in another."""

from dataclasses import replace

import pytest

from mavfi.campaign.analysis.failure_rate import find_upsets, upsets_per_instruction
from mavfi.campaign.analysis.failure_views import payoff
from tests.unit.campaign.analysis.handmade import GOLDEN, INSTRUCTION, flown, golden, injected, runs
from tests.unit.campaign.analysis.test_failure_views import IN_DETECTOR, campaign, counted
from tools.detector_payoff import scheme_of, section

UPSET = upsets_per_instruction(find_upsets()).value
GAUSSIAN = {"detector": "gaussian", "profile": "paper", "mission": {}}
PLANNER = replace(INSTRUCTION, kernel="rrt_connect", entry="plan_rrt_connect")
PLANNED = {"rrt_connect": {"instructions": 50, "calls": 1, "lines": []}}


def in_detectors(*arms, lost=0, seeds=10):
    """Faults in a detector of several arms, of which the golden runs count the instructions."""
    own = []
    for seed in range(seeds):
        own.append(golden(seed, counted("pid")))
        for arm in arms:
            own.append(golden(seed, counted("gaussian"), arm=arm))
            own.append(injected(seed, flown(seed >= lost), IN_DETECTOR, arm=arm, target="gaussian"))
    return runs(*own, name="detectors", arms=dict.fromkeys(arms, GAUSSIAN))


def planner(name, arm, seeds, saved=True):
    """Faults in the planner that lose every mission; the golden runs of the arm are not counted, as in a bench."""
    own = []
    for seed in range(seeds):
        own += [golden(seed, replace(GOLDEN, flight_time_s=1800.0, counts=PLANNED)), golden(seed, arm=arm)]
        own.append(injected(seed, flown(False), PLANNER, target="rrt_connect"))
        own.append(injected(seed, flown(saved), PLANNER, arm=arm, target="rrt_connect"))
    return runs(*own, name=name, arms={arm: GAUSSIAN})


def replace_about(own, **about):
    return replace(own, campaign={**own.campaign, **about})


def cells(text):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:4] == "| `d"]


def test_a_detector_prevents_failures_and_causes_its_own():
    one = replace_about(campaign(), name="kernels", arms={"gaussian": GAUSSIAN})
    rows = cells(section([in_detectors("x1", "x2", lost=2)], [one]))
    whole = payoff(campaign(), "sparse", "dr_gaussian", UPSET)
    assert [row[0] for row in rows] == ["`dr_x1`", "`dr_x2`"] and {row[2] for row in rows} == {"all kernels"}
    assert rows[0][3] == f"{whole.value:+.1e} [{whole.low:+.1e}, {whole.high:+.1e}]", "as in one campaign"
    assert rows[0][5:] == ["10 (detectors)", "10 (kernels)"]
    assert "- faults in kernels: " in section([in_detectors("x1")], [one]) and "digest" in section(
        [in_detectors("x1")], [one]
    )


@pytest.mark.parametrize(("saved", "word"), [(True, "yes"), (False, "undecided at this n")])
def test_without_counts_of_the_arm_those_of_plain_flights_are_taken(saved, word):
    (row,) = cells(section([in_detectors("x1", seeds=300)], [planner("bench", "of another name", 60, saved)]))
    assert (row[2], row[4], row[6]) == ("the planner", word, "60 (bench)")
    prevented = -100 * UPSET if saved else 0.0  # 50 instructions in half an hour
    assert float(row[3].split()[0]) == pytest.approx(prevented, rel=0.05)


def test_the_campaign_with_most_faults_counts():
    (row,) = cells(
        section([in_detectors("x1")], [planner("small", "a", 5), planner("large", "b", 20), planner("mid", "c", 9)])
    )
    assert row[6] == "20 (large)"


def test_a_detector_that_nobody_flew_with_faults_in_kernels_has_no_verdict_but_a_command():
    text = section([in_detectors("x1")], [planner("bench", "a", 5).where(setting="fi")])
    assert cells(text) == [] and "no verdict: `dr_x1`; needed: " in text and "--part instruction" in text


def test_schemes_are_known_by_what_they_fly_with():
    assert scheme_of({**GAUSSIAN, "profile": "tuned"}) != scheme_of(GAUSSIAN)
    assert scheme_of({**GAUSSIAN, "mission": {"grain": "kernel"}}) != scheme_of(GAUSSIAN)
    limits = {"detector": "limits", "profile": "paper", "mission": {}}
    assert scheme_of(limits) == scheme_of({**limits, "profile": "tuned"}), "it has one profile"
