from dataclasses import replace

import pytest

from mavfi.analysis.views import table
from mavfi.extras.paper.failure_rate import (
    find_upsets,
    payoff,
    payoffs,
    summary,
    target_lines,
    upsets_per_instruction,
)
from mavfi.faults.fault import NO_SITE
from mavfi.levels.instruction.fault import InstructionFault
from tests.core.unit.analysis.handmade import GOLDEN, INSTRUCTION, died, flown, golden, injected, runs

HOUR = {
    kernel: {"instructions": count, "calls": 1, "lines": []}
    for kernel, count in (("pid", 10), ("gaussian", 30), ("acceptance", 5))
}
IN_DETECTOR = replace(INSTRUCTION, kernel="gaussian", entry="judge")
IN_RULES = replace(INSTRUCTION, kernel="acceptance", entry="judge_path")
NOWHERE = InstructionFault("", "", 0, NO_SITE, kernel="acceptance")


def counted(*kernels, seconds=1800.0):
    return replace(GOLDEN, flight_time_s=seconds, counts={name: HOUR[name] for name in kernels})


def campaign():
    """Ten missions: the fault in `pid` loses four, under the detector one; that in the detector loses two."""
    own = []
    for seed in range(10):
        own += [golden(seed, counted("pid")), golden(seed, counted("pid", "gaussian"), arm="gaussian")]
        own.append(injected(seed, flown(seed >= 4), INSTRUCTION, target="pid"))
        own.append(injected(seed, flown(seed >= 1), INSTRUCTION, arm="gaussian", target="pid"))
        own.append(injected(seed, flown(seed >= 2), IN_DETECTOR, arm="gaussian", target="gaussian"))
    return runs(*own)


def test_instructions_harm_and_failures_by_hand():
    rows = {(row["setting"], row["kernel"]): row for row in table(campaign(), "failures_per_hour").entries()}
    upset = upsets_per_instruction(find_upsets()).value
    # 10 values in half an hour of flight are 20 per hour
    assert rows["fi", "pid"]["instructions"] == 20 and rows["dr_gaussian", "gaussian"]["instructions"] == 60
    assert rows["fi", "pid"]["harm"].rate == pytest.approx(0.4)
    assert rows["fi", "all"]["failures"].value == pytest.approx(20 * 0.4 * upset)
    assert rows["dr_gaussian", "all"]["failures"].value == pytest.approx((20 * 0.1 + 60 * 0.2) * upset)
    assert rows["dr_gaussian", "all"]["against"] == pytest.approx(14 / 8)
    assert rows["fi", "all"]["against"] is None
    assert rows["fi", "all"]["ended"] == rows["fi", "all"]["failures"], "no kernel died"
    assert rows["fi", "all"]["n"] == 10 and rows["dr_gaussian", "all"]["n"] == 20


def with_rules(counts, fault, lost=range(0)):
    """The campaign, in which rules execute instructions only in missions with such counts; faults are elsewhere."""
    idle = {"instructions": 0, "calls": 0, "lines": []}
    own = []
    for seed in range(25):
        number = counts if seed < 10 else idle
        watched = replace(counted("pid", "gaussian"), counts={"pid": HOUR["pid"], "acceptance": number})
        own += [golden(seed, counted("pid")), golden(seed, watched, arm="gaussian")]
        own += [injected(seed, flown(), INSTRUCTION, arm=arm, target="pid") for arm in ("", "gaussian")]
        struck = fault if seed < 10 else NOWHERE
        own.append(injected(seed, flown(seed not in lost), struck, arm="gaussian", target="acceptance"))
    return runs(*own)


def rows_of(own):
    return {(row["setting"], row["kernel"]): row for row in table(own, "failures_per_hour").entries()}


def test_a_detector_adds_its_instructions_times_its_harm_in_the_missions_that_execute_it():
    rows = rows_of(with_rules(HOUR["acceptance"], IN_RULES, lost=(1,)))
    upset = upsets_per_instruction(find_upsets()).value
    rules = rows["dr_gaussian", "acceptance"]
    # 5 values in 10 of 25 flights of half an hour; a tenth of the faults that struck one loses the mission
    assert rules["instructions"] == pytest.approx(4) and rules["n"] == 10
    assert rules["harm"].rate == pytest.approx(0.1)
    assert rules["failures"].value == pytest.approx(4 * 0.1 * upset)
    assert rows["dr_gaussian", "all"]["failures"].value == pytest.approx(4 * 0.1 * upset)
    difference = payoff(with_rules(HOUR["acceptance"], IN_RULES, (1,)), "sparse", "dr_gaussian", 1.0)
    assert difference.value == pytest.approx(0.4)


def test_a_detector_pays_if_it_prevents_more_failures_than_its_own_instructions_cause():
    found = payoff(campaign(), "sparse", "dr_gaussian", upset=1.0)
    # three of ten missions fewer in `pid`, two of ten more by the detector itself
    assert found.value == pytest.approx(-20 * 0.3 + 60 * 0.2) and found.low < 0 < found.high
    assert payoff(campaign(), "sparse", "dr_gaussian", 1.0, ("rrt_connect",)) is None, "not injected"
    assert payoff(campaign(), "sparse", "fi", 1.0) is None
    assert payoffs(campaign(), 1.0) == [
        "does dr_gaussian pay in sparse? undecided at this n, "
        f"{found.value:+.1e} [{found.low:+.1e}, {found.high:+.1e}] failures per flight hour over the injected "
        "kernels and its own instructions"
    ]


@pytest.mark.parametrize(("saved", "word"), [(True, "yes"), (False, "no")])
def test_with_enough_pairs_the_answer_is_decided(saved, word):
    own = []
    for seed in range(40):
        own += [golden(seed, counted("pid")), golden(seed, counted("pid", "gaussian"), arm="gaussian")]
        own.append(injected(seed, flown(not saved), INSTRUCTION, target="pid"))
        own.append(injected(seed, flown(saved), INSTRUCTION, arm="gaussian", target="pid"))
        own.append(injected(seed, flown(), IN_DETECTOR, arm="gaussian", target="gaussian"))
    assert payoffs(runs(*own), 1.0)[0].startswith(f"does dr_gaussian pay in sparse? {word}, ")


def test_a_dead_kernel_counts_as_a_failure_if_it_ends_the_mission():
    own = [golden(seed, counted("pid")) for seed in range(12)]
    own += [injected(seed, died() if seed % 4 else flown(), INSTRUCTION, target="pid") for seed in range(12)]
    row = table(runs(*own), "failures_per_hour").entries()[0]
    assert row["failures"].value == 0
    assert row["ended"].value == pytest.approx(20 * 0.75 * upsets_per_instruction(find_upsets()).value)


# ---- what the first line says ----------------------------------------------------------------------------------------
def faults_in_pid(number, *kernels):
    """Missions that a fault in `pid` does not lose; other kernels have none."""
    own = [golden(seed, counted("pid", *kernels)) for seed in range(number)]
    return runs(*own, *(injected(seed, flown(), INSTRUCTION, target="pid") for seed in range(number)))


def test_a_rate_of_too_few_faults_has_no_number():
    one_fault = faults_in_pid(1)
    (line,) = summary(one_fault, find_upsets())
    assert line == (
        "sparse, fi: failures per flight hour by faults: too few: at least 9 more (1 fault); without a fault 0 of 1 "
        "missions fail, 0.0 % [0.0, 79.3]."
    )
    (row, total) = table(one_fault, "failures_per_hour").entries()
    assert row["failures"] == total["failures"] == total["ended"] == "too few: at least 9 more"


def test_the_band_of_the_upsets_is_part_of_the_interval():
    (row, _) = table(faults_in_pid(20), "failures_per_hour").entries()
    upsets = upsets_per_instruction(find_upsets())
    assert row["failures"].high == pytest.approx(20 * row["harm"].high * upsets.high)
    assert upsets.high > 1.4 * upsets.value
    lossy = campaign()
    (first, *_) = table(lossy, "failures_per_hour").entries()
    assert first["failures"].low == pytest.approx(20 * first["harm"].low * upsets.low)


def test_a_kernel_without_faults_may_do_any_harm():
    own = faults_in_pid(20, "acceptance")
    rows = rows_of(own)
    upsets = upsets_per_instruction(find_upsets())
    pid_bound = 20 * rows["fi", "pid"]["harm"].high
    assert rows["fi", "all"]["failures"].high == pytest.approx((pid_bound + 10) * upsets.high), "10 per hour, all lost"
    assert "acceptance" not in [kernel for _, kernel in rows]
    assert "(20 faults, none in acceptance)" in summary(own, find_upsets())[0]


def test_a_target_says_how_many_faults_show_it_and_what_widens_the_bound():
    own = faults_in_pid(20)
    upsets = find_upsets()
    highest = upsets_per_instruction(upsets).high
    shown, dominant, assumed = target_lines(own, upsets, 20 * 0.5 * highest)
    assert "fi: fewer than" in shown and ": shown, at most" in shown
    assert dominant.startswith(
        "  What widens the bound most: the harm of pid, 0.0 % to 16.1 % (20 faults); without it 0"
    )
    assert assumed.startswith("Assumed, without a band: 0.05 Mbit unprotected")
    # none of n lost has the upper bound z2 / (n + z2), which is below 1 % from n = 381 on
    (not_shown, *_) = target_lines(own, upsets, 20 * 0.01 * highest)
    assert "About 381 faults in each kernel would show it (361 more), if harm stays the same." in not_shown
    never, dominant, *_ = target_lines(campaign(), upsets, 1e-21)
    assert "fi: fewer than 1e-21" in never and "No number of faults shows it" in never
    assert "the harm of pid, 3.8 % to 68.7 % (10 faults)" in dominant
