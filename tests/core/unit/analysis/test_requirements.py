"""Requirements are judged by the bounds of their intervals, not by the measured rate."""

from xml.etree import ElementTree

import pytest

from mavfi.analysis.effects import effect_rates
from mavfi.analysis.requirements import Holds, judge, judge_campaigns, write_junit
from mavfi.campaign.requirement import Requirement
from mavfi.errors import BadInputError
from mavfi.levels.state.fault import StateFault
from mavfi.record import End
from tests.core.unit.analysis import handmade as made

GOLDEN_OUTPUT = made.FlightRecord(End.FLOWN, digest="g")
PLAIN = StateFault(made.FAULT.where, 1, 62)


def verdict(text, *records, arm=""):
    fi = [made.injected(seed, record, PLAIN, arm=arm) for seed, record in enumerate(records)]
    golden = [made.golden(seed, arm=arm) for seed in range(len(records))]
    return judge(made.runs(*golden, *fi), [Requirement.parse(text)])[0]


@pytest.mark.parametrize(
    ("text", "lost", "n", "holds"),
    [
        ("success >= 90 %", 0, 40, Holds.YES),  # lower bound 91.2 %
        ("success >= 95 %", 0, 40, Holds.NOT_SHOWN),  # all succeed, but 40 do not show it
        ("success >= 95 %", 20, 40, Holds.NO),
        ("mission lost < 20 %", 1, 40, Holds.YES),  # upper bound 12.9 %
        ("mission lost <= 5 %", 1, 40, Holds.NOT_SHOWN),
        ("sdc < 5 %", 0, 40, Holds.NO),  # every record differs from the golden one
        ("masked > 1 %", 0, 0, Holds.NOT_SHOWN),  # no runs
    ],
)
def test_a_requirement_holds_if_the_bound_of_its_interval_does(text, lost, n, holds):
    judged = verdict(text, *[made.flown(success=number >= lost) for number in range(n)])
    assert judged.holds is holds and judged.rate.n == n and judged.line.startswith(holds.value)
    assert judged.line.endswith("n too small") == (holds is Holds.NOT_SHOWN and n > 0)


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("fi.lost - gad.lost > 45 %", Holds.YES),  # 30 of 40 less 4 of 40: 65 % [47, 78]
        ("gad.mission lost - fi.lost < -80 %", Holds.NO),
        ("gad.mission lost - fi.lost < -40 %", Holds.YES),
        ("fi.lost - gad.lost > 60 %", Holds.NOT_SHOWN),
        ("gad.sdc - fi.sdc <= 10 %", Holds.YES),  # every record differs from the golden one
    ],
)
def test_a_difference_of_settings_is_judged_in_pairs_of_the_same_fault(text, holds):
    entries = []
    for seed in range(40):
        entries += [made.golden(seed), made.golden(seed, arm="gad")]
        entries.append(made.injected(seed, made.flown(seed >= 30)))
        entries.append(made.injected(seed, made.flown(seed >= 4), arm="gad"))
    requirement = Requirement.parse(text).of({"gad": "gad"})
    (judged,) = judge(made.runs(*entries), [requirement])
    assert judged.holds is holds and judged.rate.n == 40, judged.line
    assert judged.golden is None and judged.to_json()["requirement"] == text


def test_a_difference_of_campaigns_is_judged_in_the_setting_that_is_named():
    def campaign(lost, lost_with_detector):
        entries = []
        for seed in range(40):
            entries += [made.golden(seed), made.golden(seed, arm="gad")]
            entries.append(made.injected(seed, made.flown(seed >= lost)))
            entries.append(made.injected(seed, made.flown(seed >= lost_with_detector), arm="gad"))
        return made.runs(*entries)

    texts = ("B.lost - A.lost > 10 %", "A.lost - B.lost < -10 %", "gad: A.lost - B.lost < 20 %")
    requirements = [Requirement.parse(text).of_campaigns() for text in texts]
    verdicts = judge_campaigns(campaign(0, 1), campaign(12, 1), requirements)
    assert [verdict.holds for verdict in verdicts] == [Holds.YES] * 3
    assert [round(verdict.rate.rate, 3) for verdict in verdicts] == [0.3, -0.3, 0.0]
    with pytest.raises(
        BadInputError, match="'aad: A.lost - B.lost < 2 %': dr_aad is not compared; compared: dr_gad, f"
    ):
        judge_campaigns(campaign(0, 0), campaign(0, 0), [Requirement.parse("aad: A.lost - B.lost < 2 %")])


def test_of_missions_the_rate_without_a_fault_stands_beside():
    judged = verdict("success >= 90 %", *[made.flown()] * 40)
    assert judged.line.endswith("n = 40; without a fault 100.0 % [91.2, 100.0], n = 40")


def test_arms_alarms_and_recovery_are_those_of_the_arm():
    lost, won = made.flown(success=False), made.flown(alarms=[made.alarm(0.3)])
    runs = made.runs(
        *[made.golden(seed) for seed in range(30)],
        *[made.golden(seed, arm="gad") for seed in range(30)],
        *[made.injected(seed, lost) for seed in range(30)],
        *[made.injected(seed, won, arm="gad") for seed in range(30)],
    )
    texts = ("gad: success > 85 %", "success < 15 %", "gad: detected > 85 %", "gad: recovered > 85 %")
    alarms = "gad: false alarms < 15 %"
    verdicts = judge(runs, [Requirement.parse(text) for text in (*texts, alarms)])
    assert [(verdict.holds, verdict.rate.n) for verdict in verdicts] == [(Holds.YES, 30)] * 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sdc < 5", "not understood; allowed: MEASURE < 5 %"),
        ("sdk < 5 %", r"measure 'sdk': not known \(did you mean 'sdc'\?\); allowed: masked, sdc"),
        ("sdc < 101 %", "101 %: allowed: 0 to 100"),
        ("fi.lost - gad.sdc < 2 %", "a difference of lost and sdc: allowed: one measure"),
        ("fi.lost - fi.lost < 2 %", "fi less itself; allowed: two names"),
        ("fi.recovered - gad.recovered < 2 %", "measure 'recovered': not known; allowed: masked, sdc"),
        ("fi.lost - gad.lost < -101 %", "-101 %: allowed: -100 to 100"),
    ],
)
def test_a_text_that_is_no_requirement_is_refused(text, message):
    with pytest.raises(BadInputError, match=message):
        Requirement.parse(text)


def test_a_difference_names_settings_of_the_campaign_or_two_campaigns():
    with pytest.raises(BadInputError, match=r"setting 'gat': not known .*; allowed: fi, gad"):
        Requirement.parse("fi.lost - gat.lost < 2 %").of({"gad": "gad"})
    with pytest.raises(BadInputError, match="no ARM: before a difference of settings"):
        Requirement.parse("gad: fi.lost - gad.lost < 2 %").of({"gad": "gad"})
    for text in ("success > 5 %", "fi.lost - gad.lost < 2 %"):
        with pytest.raises(BadInputError, match="is not about A and B; allowed: 'A.MEASURE - B.MEASURE < 2 %'"):
            Requirement.parse(text).of_campaigns()


def test_effects_of_programs_have_no_success():
    records = [GOLDEN_OUTPUT, made.FlightRecord(End.FLOWN, digest="x"), made.DUE, made.UNKNOWN]
    faults = [made.injected(1, record, PLAIN, index=number) for number, record in enumerate(records)]
    runs = made.runs(made.golden(1, GOLDEN_OUTPUT), *faults)
    rates = effect_rates(runs)["fi"]
    counts = {effect: (rate.successes, rate.n) for effect, rate in rates.items()}
    assert counts == {"masked": (1, 3), "sdc": (1, 3), "crash": (1, 3), "hang": (0, 3)}
    (judged,) = judge(runs, [Requirement.parse("success > 0 %")])
    assert judged.holds is Holds.NOT_SHOWN and judged.rate.n == 0


def test_junit_has_one_case_per_requirement_and_a_failure_for_each_that_does_not_hold(tmp_path):
    verdicts = [verdict(text, *[made.flown()] * 40) for text in ("success >= 90 %", "success >= 95 %")]
    write_junit(tmp_path / "junit.xml", "robot", verdicts)
    suites = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert (suites.tag, suites.get("tests"), suites.get("failures")) == ("testsuites", "2", "1")
    holding, failing = suites.iter("testcase")
    assert holding.get("name") == "success >= 90 %" and holding.find("failure") is None
    assert "n too small" in failing.find("failure").get("message")
