"""The shipped plans fit the code; with its time charged, `ten_percent` detects a fault that would change the flight."""

import pytest

from mavfi.analysis.runs import Runs
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.replay import replay
from mavfi.config import names, parse
from mavfi.extras.hardening.plan import load_plan, save_plan, signature_text
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.ir.build import name_of
from mavfi.ir.sources import cached_shape
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE, PLANNERS
from tests.campaigns import run_campaign
from tests.extras.hardening.plans import calls_of_protected_code

pytestmark = pytest.mark.long


def mission(plan, **more):
    return resolve(MissionSpec(environment="sparse", seed=7, protection=str(plan), **more))


@pytest.fixture(scope="module")
def golden():
    """The golden flight with the shipped plan."""
    return fly(mission("ten_percent")).log


@pytest.fixture(scope="module")
def timed(tmp_path_factory):
    """The mission with the time of the plan, but plain code."""
    plan = load_plan("ten_percent")
    bare = tuple(function.model_copy(update={"kind": "none", "sites": ()}) for function in plan.functions)
    path = tmp_path_factory.mktemp("plans") / "timed.yaml"
    save_plan(plan.model_copy(update={"functions": bare}), path)
    return mission(path)


def test_golden_flights_are_those_of_plain_code_with_this_latency(golden, timed):
    assert golden.digest() == fly(timed).log.digest()
    assert golden.digest() != fly(mission("")).log.digest(), "its time is charged"
    assert golden.status.label == "success" and not golden.alarms


def test_protected_code_computes_what_plain_code_does_in_a_whole_flight():
    kernels = ("pid", "rrt_connect", "collision_check")
    assert calls_of_protected_code(mission(""), load_plan("ten_percent"), kernels) > 1000


@pytest.mark.parametrize("name", names("protections"))
def test_each_shipped_plan_is_that_of_the_code(golden, name):
    """Made again by `mavfi harden` after a change of a kernel."""
    plan = load_plan(name)
    for planner in {planned.kernel for planned in plan.functions} & (PLANNERS.keys() - {"rrt_connect"}):
        fly(mission("", planner=planner))  # its types are known then
    functions = {
        name_of(getattr(PLAIN, entry)): getattr(PLAIN, entry) for entries in INJECTABLE.values() for entry in entries
    }
    assert plan.functions
    for planned in plan.functions:
        function = functions[planned.function]
        (signature,) = (entries for entries in function.overloads if signature_text(entries) == planned.signature)
        assert cached_shape(function, signature)[0] == planned.ir_sha256, planned.function


def test_protection_flies_with_a_detector_and_its_restarts_in_a_campaign(tmp_path):
    shipped = load_campaign("protected").to_json()
    arms = {name: shipped["arms"][name] for name in ("ten_percent", "ten_percent_recommended")}
    sampling = {**shipped["sampling"], "kernels": ["pid"]}
    changes = {"environments": ["sparse"], "missions": 1, "faults": 6, "sampling": sampling, "arms": arms}
    run_campaign(parse(Campaign, {**shipped, **changes}, "protected"), tmp_path, executor=LocalExecutor(1))
    runs = Runs.read(tmp_path)
    both = runs.injected.where(arm="ten_percent_recommended")
    assert replay(tmp_path, both["run_id"][0]).same
    assert len(both) == len(runs.injected.where(arm="ten_percent")) == 6
    assert len(both.where(kernel_effect="detected")) > 0 and all(both["success"])
    assert both["kernel_effect"] == runs.injected.where(arm="ten_percent")["kernel_effect"], "the detector changes none"
    assert runs.golden.where(arm="ten_percent_recommended")["alarms_total"] == [0]
