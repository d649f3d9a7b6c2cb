"""Hardening of a planner that is none of mavfi: its functions are observed, protected, and found again by name."""

import pytest

from mavfi.extras.hardening.battery import Battery
from mavfi.extras.hardening.observed import check_golden, observe
from mavfi.extras.hardening.plan import FunctionPlan, ProtectionPlan
from mavfi.extras.hardening.protected import _called, check_plan
from mavfi.extras.hardening.target import FunctionTarget
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec

PLANNER = "tests.core.flights.plug_ins:Straight"


@pytest.fixture(scope="module")
def scenario():
    course = {"start": (2.0, 0.0, 3.0), "goal": (9.0, 0.0, 3.0), "v_max": 6.0}
    return resolve(MissionSpec(environment="sparse", seed=7, planner=PLANNER, **course))


def test_a_protected_planner_flies_as_the_plain_one(scenario):
    ((seen,),) = observe(scenario, ["Straight"]).values()
    assert seen.entry == "Straight.track" and seen.key.function == "tests.core.flights.plug_ins.track"
    assert Battery(seen.entry, seen.function, seen.variant, seen.calls).counts.all()

    target = FunctionTarget(("Straight",), seen)
    planned = FunctionPlan(
        kernel="Straight",
        function=target.name,
        signature=seen.signature_text,
        ir_sha256=seen.variant.ir_sha256,
        kind="duplicate",
        sites=tuple(value.site for value in target.values),
        time=1.5,
    )
    plan = ProtectionPlan(functions=(planned,))
    check_plan(plan, "mine.yaml")
    assert [called.function for called in _called(plan)] == [seen.function]
    golden = check_golden(scenario, plan, ["Straight"])
    assert golden.passed and golden.calls == seen.total
