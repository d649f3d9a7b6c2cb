"""Hardening of a custom planner: its functions are observed, protected, and found again by name."""

import pytest

from mavfi.extras.hardening.harden import Target
from mavfi.extras.hardening.ledger import CorruptionRates
from mavfi.extras.hardening.observed import observe
from mavfi.extras.hardening.plan import FunctionPlan, ProtectionPlan
from mavfi.extras.hardening.protected import REWRITER, _called
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec
from tests.extras.hardening.plans import calls_of_protected_code

PLANNER = "tests.core.flights.plug_ins:Straight"


@pytest.fixture(scope="module")
def scenario():
    course = {"start": (2.0, 0.0, 3.0), "goal": (9.0, 0.0, 3.0), "v_max": 6.0}
    return resolve(MissionSpec(environment="sparse", seed=7, planner=PLANNER, **course))


def test_a_protected_planner_flies_as_the_plain_one(scenario):
    (seen,) = observe([scenario], ["Straight"])
    assert seen.kernels == ("Straight",) and seen.key.function == "tests.core.flights.plug_ins.track"

    target = Target(seen, False, CorruptionRates([]))
    planned = FunctionPlan(
        kernel="Straight",
        function=seen.key.function,
        signature=seen.key.signature,
        ir_sha256=seen.variant.ir_sha256,
        kind="duplicate",
        sites=tuple(target.all_sites),
        time=1.5,
    )
    plan = ProtectionPlan(functions=(planned,))
    REWRITER.check(plan, "mine.yaml")
    assert [called.function for called in _called(plan)] == [seen.function]
    assert calls_of_protected_code(scenario, plan, ["Straight"]) == seen.recording.total
