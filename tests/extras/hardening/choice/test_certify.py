"""Certificates: pairs of injections in plain and protected code, verdicts, totals."""

import re

import numpy as np
import pytest

from mavfi.analysis.statistics import mcnemar
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.errors import BadInputError
from mavfi.extras.hardening.advise import HardeningStudy
from mavfi.extras.hardening.battery import SDC
from mavfi.extras.hardening.certify import (
    Certificate,
    Certification,
    FunctionPair,
    Unprotected,
    certify,
    certify_plan,
    check_fresh,
    combined_coverage,
    observe_plain,
    predicted_coverage,
    unprotected,
)
from mavfi.extras.hardening.duplicate import candidates
from mavfi.extras.hardening.observed import GoldenCheck, ProtectedFunction
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, ProtectionPlan, load_plan, save_plan
from mavfi.extras.hardening.report import verdict_line
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source
from tests.extras.hardening.choice.kernels import calls, see, smooth


def certificate(before, after, growth=2.0, predicted=None):
    rows = [{"masked": 400 - n, **({"sdc": n} if n else {})} for n in (before, after)]
    return Certificate("pid", "m.f", "f8", 1000, rows[0], rows[1], growth, predicted, mcnemar([], []))


def test_verdicts():
    claim = Coverage(estimate=0.9, low=0.86, high=0.94)
    assert certificate(200, 10, predicted=claim).verdict == "confirmed"  # 1 - 2 x 10 / 200
    assert certificate(200, 50, predicted=claim).verdict == "refuted"
    assert certificate(200, 0, predicted=claim).verdict == "better"
    assert certificate(200, 50).verdict == certificate(0, 0, predicted=claim).verdict == "unknown"


def test_a_prediction_that_could_not_have_failed_is_undecided():
    claim = Coverage(estimate=1.0, low=0.566, high=1.0)
    assert certificate(5, 0, predicted=claim).verdict == "undecided"  # any prediction from 0 to 1 would pass
    assert certificate(200, 0, predicted=claim).verdict == "undecided"  # the prediction itself says too little
    assert certificate(200, 0, predicted=Coverage(estimate=1.0, low=0.9, high=1.0)).verdict == "confirmed"
    assert certificate(30, 40, predicted=claim).verdict == "refuted"  # wide, and yet clear
    few = Certification("ab" * 32, 400, (), (certificate(5, 0, predicted=claim),), GoldenCheck(1, 1, 9, 0))
    assert few.verdict == "undecided" and not few.refuted
    assert verdict_line(few).startswith("The plan is undecided: ")
    assert "0 of 1 predictions are refuted, 1 undecided;" in verdict_line(few)


def test_a_plan_without_predictions_is_not_confirmed():
    found = Certification("ab" * 32, 400, (), (certificate(200, 0),), GoldenCheck(1, 1, 9, 0))
    assert verdict_line(found).startswith("The plan is measured; it has no prediction: ")
    assert "0 of 0 predictions are refuted" in verdict_line(found)


def test_totals_weight_functions_by_their_silent_corruptions():
    whole = combined_coverage([certificate(200, 0), certificate(20, 10, growth=1.0)])
    assert whole.rate == pytest.approx(1 - 10 / 220) and whole.low < whole.rate <= whole.high
    assert combined_coverage([]).rate is None


def test_the_total_is_judged_by_predictions_with_the_same_weights():
    claim = Coverage(estimate=0.9, low=0.86, high=0.94)
    large, small = certificate(200, 10, predicted=claim), certificate(20, 10, predicted=claim)
    assert predicted_coverage([large, small]).rate == pytest.approx(0.9)
    assert predicted_coverage([large], [plain(1000, 200)]).rate == pytest.approx(0.45)
    assert predicted_coverage([large], [plain(3000, 200)]).rate == pytest.approx(0.225)
    assert predicted_coverage([large, certificate(20, 10)]).rate is None and predicted_coverage([]).rate is None

    def whole(*certificates):
        return Certification("ab" * 32, 400, (), certificates, GoldenCheck(1, 1, 9, 0))

    assert whole(large).verdict == "confirmed" and not whole(large).refuted
    weak = [certificate(200, 15, predicted=claim) for _ in range(6)]  # each within its prediction, all together not
    assert all(one.verdict == "confirmed" for one in weak)
    assert whole(*weak).verdict == "refuted" and whole(*weak).refuted


def test_of_many_predictions_one_may_be_refuted_by_chance():
    claim = Coverage(estimate=0.9, low=0.86, high=0.94)
    good, low, wrong = (certificate(200, after, predicted=claim) for after in (10, 18, 50))
    assert low.verdict == wrong.verdict == "refuted"

    def whole(*certificates):
        return Certification("ab" * 32, 400, (), certificates, GoldenCheck(1, 1, 9, 0))

    assert (whole(low).wrong, whole(low).refuted) == (1, True)
    many = whole(low, *[good] * 9)
    assert (many.wrong, many.verdict, many.refuted) == (0, "confirmed", False)
    assert "1 of 10 predictions are refuted (0 with Holm's correction for so many), 0 undecided" in verdict_line(many)
    assert (whole(wrong, *[good] * 9).wrong, whole(wrong, *[good] * 9).refuted) == (1, True)
    assert whole(certificate(200, 50)).wrong == 0, "no prediction"


def plain(instructions, sdc):
    return Unprotected("octomap", "m.g", "f8", instructions, {"masked": 400 - sdc, "sdc": sdc})


def test_unprotected_functions_count_in_the_total():
    half = combined_coverage([certificate(200, 0)], [plain(1000, 200)])
    assert half.rate == pytest.approx(0.5) and 0.4 < half.low < 0.5 < half.high < 0.6
    little = combined_coverage([certificate(200, 0)], [plain(499_000, 200)])
    assert little.rate == pytest.approx(0.002) and 0.0015 < little.low < little.high < 0.0025
    harmful = combined_coverage([certificate(200, 150)], [plain(1000, 200)])
    assert harmful.low < harmful.rate < harmful.high < 0 and harmful.rate == pytest.approx(-0.25)
    assert (
        combined_coverage([certificate(200, 10)], [plain(1000, 0)]).rate
        == combined_coverage([certificate(200, 10)]).rate
    )
    assert combined_coverage([], [plain(1000, 200)]).rate is None


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
    assert found.time >= 1.0 and found.to_json()["time"] == found.time
    assert found.to_json()["planned_time"] == planned.time
    assert found.to_json()["verdict"] == "unknown" and found.before[SDC] == found.to_json()["before"]["sdc"]


def test_a_function_without_sites_is_observed_as_it_is(planned):
    seen, bare = see(smooth, calls()), planned.model_copy(update={"sites": ()})
    assert unprotected([seen], ProtectionPlan(functions=(planned,))) == []
    assert unprotected([seen], ProtectionPlan()) == unprotected([seen], ProtectionPlan(functions=(bare,))) == [seen]
    found = observe_plain("smooth", seen, 60)
    assert found.sdc.n == 60 and found.sdc.rate > 0.2 and found.instructions == seen.instructions
    assert found.to_json()["sdc"]["successes"] == found.effects[SDC]


def test_a_guarded_function_gives_the_same_bits_and_no_alarm(planned):
    guarded, own, other = ProtectedFunction(smooth, ProtectionPlan(functions=(planned,))), calls()[0], calls()[0]
    assert np.float64(guarded(*own)).tobytes() == np.float64(smooth(*other)).tobytes()
    assert own[1].tobytes() == other[1].tobytes() and (guarded.calls, guarded.alarms) == (1, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kernel": "pidd"}, "^protection plan: kernel 'pidd': not known; allowed: [^\n]*$"),
        ({"kernel": "pid"}, "^protection plan: function '[^\n]*smooth': not of kernel pid; allowed: [^\n]*$"),
        ({}, "^protection: planned with llvmlite 0.1, this is [^\n]*$"),
    ],
)
def test_a_plan_that_a_flight_refuses_is_not_certified(planned, change, message):
    plan = ProtectionPlan(functions=(planned.model_copy(update=change),), **({} if change else {"llvmlite": "0.1"}))
    with pytest.raises(BadInputError, match=message):
        certify_plan(None, plan, 1)


def test_a_plan_of_other_code_is_refused(planned):
    with pytest.raises(BadInputError, match="planned for IR 000000000000"):
        FunctionPair.of(see(smooth, calls()), planned.model_copy(update={"ir_sha256": "0" * 64}))


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


def test_studied_seeds_are_those_of_an_environments_own_name(tmp_path):
    parts = {"fast": {"environment": "dense"}, "slow": {"environment": "dense", "platform": "cortex-a57"}}
    own = load_campaign("hardening").model_dump() | {"parts": parts, "environments": ("fast", "slow")}
    study = HardeningStudy(tmp_path, Campaign.model_validate(own), "other", ("pid",))
    assert study.worlds == ["dense"]
    with pytest.raises(BadInputError, match="mission dense 10008"):
        check_fresh(study, ProtectionPlan(ledger="made", studied={"dense": (10_000, 10_008)}))


@pytest.mark.parametrize("seeds", [(2, 1), (-1, 5)])
def test_studied_seeds_ascend(seeds):
    with pytest.raises(ValueError, match="studied"):
        ProtectionPlan(studied={"dense": seeds})


def test_the_seeds_that_a_choice_has_seen_do_not_identify_a_plan(tmp_path):
    plan = ProtectionPlan(studied={"dense": (10_000, 10_007)}, budget=0.1)
    save_plan(plan, tmp_path / "plan.yaml")
    assert load_plan(tmp_path / "plan.yaml") == plan
    assert plan.digest == ProtectionPlan().digest and not {"studied", "budget"} & set(ProtectionPlan().model_dump())
