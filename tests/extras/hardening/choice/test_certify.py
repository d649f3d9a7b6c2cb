"""Certificates: pairs of injections in plain and protected code, verdicts, totals."""

import re

import numpy as np
import pytest

from mavfi.analysis.statistics import mcnemar
from mavfi.campaign.config import load_campaign
from mavfi.errors import BadInputError
from mavfi.extras.hardening.advise import HardeningStudy
from mavfi.extras.hardening.certify import (
    Certificate,
    Certification,
    FunctionPair,
    Unprotected,
    certify,
    check_fresh,
    combined_coverage,
    predicted_coverage,
)
from mavfi.extras.hardening.duplicate import candidates
from mavfi.extras.hardening.observed import GoldenCheck, ProtectedFunction
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, ProtectionPlan
from mavfi.extras.hardening.report import verdict_line
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source
from tests.extras.hardening.choice.kernels import calls, see, smooth


def certificate(before, after, growth=2.0, predicted=None):
    rows = [{"masked": 400 - n, **({"sdc": n} if n else {})} for n in (before, after)]
    return Certificate("pid", "m.f", "f8", 1000, rows[0], rows[1], growth, predicted, mcnemar([], []))


CLAIM = Coverage(estimate=0.9, low=0.86, high=0.94)
WIDE_CLAIM = Coverage(estimate=1.0, low=0.566, high=1.0)


def certification(*certificates):
    return Certification("ab" * 32, 400, (), certificates, GoldenCheck(1, 1, 9, 0))


@pytest.mark.parametrize(
    ("before", "after", "predicted", "verdict"),
    [
        (200, 10, CLAIM, "confirmed"),  # 1 - 2 x 10 / 200
        (200, 50, CLAIM, "refuted"),
        (200, 0, CLAIM, "better"),
        (200, 50, None, "unknown"),
        (0, 0, CLAIM, "unknown"),
        (5, 0, WIDE_CLAIM, "undecided"),  # any prediction from 0 to 1 would pass
        (200, 0, WIDE_CLAIM, "undecided"),  # the prediction itself says too little
        (200, 0, Coverage(estimate=1.0, low=0.9, high=1.0), "confirmed"),
        (30, 40, WIDE_CLAIM, "refuted"),  # wide, and yet clear
    ],
)
def test_verdicts(before, after, predicted, verdict):
    assert certificate(before, after, predicted=predicted).verdict == verdict


def test_verdicts_of_plans_that_say_too_little():
    few = certification(certificate(5, 0, predicted=WIDE_CLAIM))
    assert few.verdict == "undecided" and not few.refuted
    assert "The plan is undecided: " in verdict_line(few)
    assert "has no prediction" in verdict_line(certification(certificate(200, 0)))


def test_totals_weight_functions_by_their_silent_corruptions():
    whole = combined_coverage([certificate(200, 0), certificate(20, 10, growth=1.0)])
    assert whole.rate == pytest.approx(1 - 10 / 220) and whole.low < whole.rate <= whole.high
    assert combined_coverage([]).rate is None


def test_the_total_is_judged_by_predictions_with_the_same_weights():
    large, small = certificate(200, 10, predicted=CLAIM), certificate(20, 10, predicted=CLAIM)
    assert predicted_coverage([large, small]).rate == pytest.approx(0.9)
    assert predicted_coverage([large], [plain(3000, 200)]).rate == pytest.approx(0.225)
    partly = predicted_coverage([large, certificate(20, 10)])
    assert partly.rate == pytest.approx(0.9 * 10 / 11) and partly.high > 0.9, "one in eleven may be removed or not"
    assert predicted_coverage([certificate(20, 10)]).rate is None and predicted_coverage([]).rate is None
    assert certification(large).verdict == "confirmed" and not certification(large).refuted
    weak = certification(*[certificate(200, 15, predicted=CLAIM)] * 6)  # each within its prediction, all together not
    assert weak.certificates[0].verdict == "confirmed"
    assert weak.verdict == "refuted" and weak.refuted


def test_of_many_predictions_one_may_be_refuted_by_chance():
    good, low, wrong = (certificate(200, after, predicted=CLAIM) for after in (10, 18, 50))
    assert low.verdict == wrong.verdict == "refuted"
    assert (certification(low).wrong, certification(low).refuted) == (1, True)
    many = certification(low, *[good] * 9)
    assert (many.wrong, many.verdict, many.refuted) == (0, "confirmed", False)
    assert "1 of 10 predictions are refuted (0 with Holm's correction for so many)" in verdict_line(many)
    assert certification(wrong, *[good] * 9).refuted


def plain(instructions, sdc):
    return Unprotected("octomap", "m.g", "f8", instructions, {"masked": 400 - sdc, "sdc": sdc})


def test_unprotected_functions_count_in_the_total():
    half = combined_coverage([certificate(200, 0)], [plain(1000, 200)])
    assert half.rate == pytest.approx(0.5) and 0.4 < half.low < 0.5 < half.high < 0.6
    little = combined_coverage([certificate(200, 0)], [plain(499_000, 200)])
    assert little.rate == pytest.approx(0.002) and 0.0015 < little.low < little.high < 0.0025
    harmful = combined_coverage([certificate(200, 150)], [plain(1000, 200)])
    assert harmful.low < harmful.rate < harmful.high < 0 and harmful.rate == pytest.approx(-0.25)


@pytest.fixture(scope="module")
def planned():
    seen = see(smooth, calls())
    source = cached_source(smooth, seen.signature)
    sites = candidates(parse_module(source.text, source.kernel))
    return FunctionPlan(
        kernel="smooth",
        function=source.kernel,
        signature=seen.signature_text,
        ir_sha256=seen.variant.ir_sha256,
        sites=tuple(sites),
    )


def test_full_duplication_removes_the_corruptions_of_the_same_injections(planned):
    found = certify(FunctionPair.of(see(smooth, calls()), planned), 60)
    assert found.sdc_before.rate > 0.2 and found.growth > 1.5
    assert found.coverage.rate > 0.8 and found.after.get("detected", 0) > 0
    assert found.paired.n == 60 and found.paired.second_only == 0 and found.paired.p_value < 0.01
    assert sum(found.after.values()) == sum(found.before.values()) == 60


def test_a_guarded_function_gives_the_same_bits_and_no_alarm(planned):
    guarded, own, other = ProtectedFunction(smooth, ProtectionPlan(functions=(planned,))), calls()[0], calls()[0]
    assert np.float64(guarded(*own)).tobytes() == np.float64(smooth(*other)).tobytes()
    assert own[1].tobytes() == other[1].tobytes() and (guarded.calls, guarded.alarms) == (1, 0)


# ---- a plan and the ledger of its certificate ----------------------------------------------------------------------
@pytest.mark.parametrize(
    ("studied", "refusal"),
    [
        ({}, "ledger other, the plan was made from made: its seeds are not known to be fresh"),
        ({"dense": (10_000, 10_008)}, "mission dense 10008, the next after its own: the plan was made from it"),
        ({"dense": (10_000, 10_007)}, ""),
        ({"sparse": (0, 20_000)}, ""),
    ],
)
def test_a_plan_is_certified_with_missions_that_its_choice_has_not_seen(tmp_path, studied, refusal):
    study = HardeningStudy(tmp_path, load_campaign("hardening"), "other", ("pid",))
    plan = ProtectionPlan(ledger="made", studied=studied)
    check_fresh(study, ProtectionPlan(ledger="other"))
    if not refusal:
        check_fresh(study, plan)
        return
    with pytest.raises(BadInputError, match=re.escape(f"{tmp_path}: {refusal}")):
        check_fresh(study, plan)
