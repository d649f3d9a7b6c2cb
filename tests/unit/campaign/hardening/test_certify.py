"""Certificates: pairs of injections in plain and protected code, verdicts, totals."""

import numpy as np
import pytest

from mavfi.campaign.analysis.pairs import mcnemar
from mavfi.campaign.hardening.battery import SDC
from mavfi.campaign.hardening.certify import Certificate, Pair, certify, together
from mavfi.campaign.hardening.golden import Guarded
from mavfi.campaign.hardening.kernel import see
from mavfi.errors import BadInputError
from mavfi.hardening.candidates import candidates
from mavfi.hardening.plan import Coverage, FunctionPlan, Plan
from mavfi.hardening.sources import cached_source
from mavfi.ir.parser import parse_module
from tests.unit.campaign.hardening.kernels import calls, smooth


def certificate(before, after, growth=2.0, predicted=None):
    rows = [{"masked": 400 - n, **({"sdc": n} if n else {})} for n in (before, after)]
    return Certificate("pid", "m.f", "f8", 1000, rows[0], rows[1], growth, predicted, mcnemar([], []))


def test_verdicts():
    claim = Coverage(estimate=0.9, low=0.86, high=0.94)
    assert certificate(200, 10, predicted=claim).verdict == "confirmed"  # 1 - 2 x 10 / 200
    assert certificate(200, 50, predicted=claim).verdict == "refuted"
    assert certificate(200, 0, predicted=claim).verdict == "better"
    assert certificate(200, 50).verdict == certificate(0, 0, predicted=claim).verdict == "unknown"


def test_totals_weight_functions_by_their_silent_corruptions():
    whole = together([certificate(200, 0), certificate(20, 10, growth=1.0)])
    assert whole.rate == pytest.approx(1 - 10 / 220) and whole.low < whole.rate <= whole.high
    assert together([]).rate is None


@pytest.fixture(scope="module")
def planned():
    seen = see(smooth, calls())
    source = cached_source(smooth, seen.signature)
    sites = candidates(parse_module(source.text, source.kernel))
    return FunctionPlan(
        kernel="smooth", function=source.kernel, signature=seen.signature_text, ir_sha256=seen.variant.ir_sha256,
        sites=tuple(sites),
    )  # fmt: skip


def test_full_duplication_removes_the_corruptions_of_the_same_injections(planned):
    found = certify(Pair.of(see(smooth, calls()), planned), 60)
    assert found.sdc_before.rate > 0.2 and found.growth > 1.5
    assert found.coverage.rate > 0.8 and found.after.get("detected", 0) > 0
    assert found.paired.n == 60 and found.paired.second_only == 0 and found.paired.p_value < 0.01
    assert sum(found.after.values()) == sum(found.before.values()) == 60
    assert found.to_json()["verdict"] == "unknown" and found.before[SDC] == found.to_json()["before"]["sdc"]


def test_a_guarded_function_gives_the_same_bits_and_no_alarm(planned):
    guarded, own, other = Guarded(smooth, Plan(functions=(planned,))), calls()[0], calls()[0]
    assert np.float64(guarded(*own)).tobytes() == np.float64(smooth(*other)).tobytes()
    assert own[1].tobytes() == other[1].tobytes() and (guarded.calls, guarded.alarms) == (1, 0)


def test_a_plan_of_other_code_is_refused(planned):
    with pytest.raises(BadInputError, match="planned for IR 000000000000"):
        Pair.of(see(smooth, calls()), planned.model_copy(update={"ir_sha256": "0" * 64}))
