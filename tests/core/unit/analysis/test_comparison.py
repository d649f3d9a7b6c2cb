"""Two campaigns: what is paired, what is not compared, and in which words."""

import pytest

import mavfi
from mavfi.analysis.comparison import compare
from mavfi.analysis.statistics import relative_difference, unpaired_difference
from mavfi.analysis.table import DIFFERENCE
from mavfi.errors import BadInputError
from mavfi.report.text import cell
from tests.core.unit.analysis.handmade import FAULT, INSTRUCTION, flown, golden, injected, runs

SAVED = range(1, 20)
"""Missions that the better campaign does not lose; it loses the other odd ones."""


def campaign(saved=(), *, first_seed=0, faults=2, time_s=50.0, fault=FAULT, setting_arm="", **about):
    """Forty missions with some faults each, which lose the odd ones unless they are saved."""
    entries = []
    for seed in range(1, 41):
        entries.append(golden(first_seed + seed))
        for number in range(faults):
            lost = seed % 2 == 1 and seed not in saved
            flight_time_s = 9.0 if lost else time_s + seed % 3
            record = flown(not lost, flight_time_s=flight_time_s, digest=f"{flight_time_s}")
            index = first_seed + seed + 40 * number
            entries.append(injected(first_seed + seed, record, fault, index=index, arm=setting_arm))
    return runs(*entries, **about)


def test_shared_runs_are_pairs_and_the_faults_of_a_mission_one_cluster():
    answer = mavfi.compare(campaign(), campaign(SAVED)).answer
    assert (answer.setting, answer.paired, answer.n_a, answer.missions) == ("fi", True, 80, 40)
    assert answer.failures.rate == pytest.approx(-0.25)
    one_fault = compare(campaign(faults=1), campaign(SAVED, faults=1)).answer
    assert answer.failures.low == pytest.approx(one_fault.failures.low), "a second fault that ends alike tells nothing"


def test_the_answer_is_a_sentence():
    first, second = compare(campaign(), campaign(SAVED, time_s=55.0)).sentences
    assert first.startswith("sparse, fi: B fails 25.0 % [1")
    assert (
        "fewer missions than A, on 80 shared runs with a fault in 40 missions: A fails 50.0 % [35.2, 64.8], B" in first
    )
    assert first.endswith("; without a fault A fails 0.0 % [0.0, 8.8], B 0.0 % [0.0, 8.8].")
    assert second.startswith("Where both succeed (n = 40), the flight time of B is 9.8 % ["), (
        "lost missions are no saving"
    )
    (same,) = compare(campaign(), campaign()).sentences
    assert same == "B flies as A: all 120 shared runs are equal bit for bit."
    (without_a_fault,) = compare(campaign(), campaign(fault=INSTRUCTION)).sentences
    assert without_a_fault == "Without a fault, B flies as A: all 40 shared runs are equal bit for bit."
    assert second.endswith("] longer, its energy not shown to differ, [0.0, 0.0] %."), "not 0.0 % more"
    (not_shown, _) = compare(campaign(), campaign(range(1, 2))).sentences
    assert not_shown.startswith("sparse, fi: no difference in failures is shown: -2.5")


def test_each_setting_stands_by_itself_and_the_headline_names_its_one():
    """Arms with and without a detector are no one population: with one, half as many missions are lost."""

    def both_arms(saved):
        entries = []
        for seed in range(1, 41):
            entries += [golden(seed), golden(seed, arm="gad")]
            lost = flown(seed in saved, digest=f"lost or not: {seed in saved}")
            entries += [injected(seed, lost), injected(seed, flown(), arm="gad")]
        return runs(*entries)

    comparison = compare(both_arms(range(0)), both_arms(range(1, 21)))
    assert comparison.answer.setting == "fi" and comparison.answer.n_a == 40
    assert comparison.answer.failures.rate == pytest.approx(-0.5), "not -0.25, pooled with the other arm"
    assert comparison.sentences[0].startswith("sparse, fi: B fails 50.0 % [")
    rows = [
        [cell(value, column.form) for value, column in zip(row, comparison.table.columns, strict=True)]
        for row in comparison.table.rows
    ]
    assert [row[0] for row in rows] == ["golden", "golden_gad", "fi", "dr_gad"], "no row over several settings"
    assert rows[0][2] == rows[3][2] == "all equal"


def test_a_difference_whose_interval_contains_none_has_no_number():
    comparison = compare(campaign(), campaign(range(1, 2), time_s=55.0))
    failures = [row for row in comparison.table.entries() if row["setting"] == "fi"][0]["failures"]
    assert cell(failures, DIFFERENCE).startswith("not shown [-")
    golden_only = compare(runs(golden(1)), runs(golden(1, flown(False))))
    assert golden_only.sentences[0].startswith("sparse, golden: no difference in failures is shown: +100.0 points")


def test_other_seeds_are_independent_samples_with_wider_intervals():
    pairs = compare(campaign(), campaign(SAVED)).answer
    samples = compare(campaign(), campaign(SAVED, first_seed=1000)).answer
    assert (samples.paired, samples.same, samples.missions) == (False, None, 80)
    assert samples.failures.rate == pytest.approx(pairs.failures.rate)
    assert samples.failures.low < pairs.failures.low
    assert samples.failures.high > pairs.failures.high


@pytest.mark.parametrize(
    ("about", "note"),
    [
        ({"fault": INSTRUCTION}, "not compared: they are of level state in A, instruction in B"),
        ({"versions": {"fault space": "2"}}, "not compared: their fault space has version 1 in A, 2 in B"),
        ({"host": "ros2"}, "other hosts (local in A, ros2 in B)"),
        ({"sampling": {"when": "published"}, "first_seed": 1000}, "sparse fi: no shared faults, not compared"),
        ({"setting_arm": "gaussian"}, "only in B: dr_gaussian"),
        ({"done": 5}, "B is not complete: 5 of 9 runs"),
    ],
)
def test_what_is_not_compared_is_said(about, note):
    comparison = compare(campaign(host="local", versions={"fault space": "1"}), campaign(**{"host": "local", **about}))
    assert note in "; ".join(comparison.notes)
    if "not compared" in note or "only in" in note:
        assert comparison.answer.setting == "golden"


def test_campaigns_without_a_common_setting_are_refused():
    with pytest.raises(BadInputError, match="A and B have nothing to compare: only in A: sparse; only in B: dense"):
        compare(runs(golden(1)), runs(golden(1, environment="dense")))


def test_intervals_of_differences():
    # Newcombe (1998), table II, example (a), method 10
    worlds = range(80)
    difference = unpaired_difference(
        [True] * 56 + [False] * 14, worlds[:70], [True] * 48 + [False] * 32, range(100, 180)
    )
    assert (difference.value, difference.low, difference.high) == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)
    # a ratio that no world differs from has no error, a single world no interval
    exact = relative_difference([2.2, 4.4], [1, 2], [2.0, 4.0], [1, 2])
    assert (exact.rate, exact.low, exact.high) == pytest.approx((0.1, 0.1, 0.1))
    assert relative_difference([2.2], [1], [2.0], [1]).low is None
