"""Requirements are judged by the bounds of their intervals, not by the measured rate."""

from xml.etree import ElementTree

import pytest

from mavfi.analysis.effects import effect_rates
from mavfi.analysis.requirements import Holds, judge, write_junit
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
    ],
)
def test_a_text_that_is_no_requirement_is_refused(text, message):
    with pytest.raises(BadInputError, match=message):
        Requirement.parse(text)


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
