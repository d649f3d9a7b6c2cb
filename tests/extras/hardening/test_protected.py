"""Missions with a protected kernel: same bits, faults detected in flight, steps computed again."""

import pytest

from mavfi.config import PlatformConfig, shipped
from mavfi.errors import BadInputError
from mavfi.extras.hardening.plan import ModuleSite, ProtectionPlan, load_plan, save_plan
from mavfi.extras.hardening.protected import SOURCE
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.host import ArmSetup
from mavfi.flight.mission_flights import LocalHost
from mavfi.ir.injection.variant import signature_of
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.mission import MissionSpec
from mavfi.outcomes import Effect, effect_of
from mavfi.pipeline.functions import PLAIN
from mavfi.record import record_of
from mavfi.report.explain import injection_lines, verdict
from tests.extras.hardening.plans import full_plan

pytestmark = pytest.mark.slow

SEED = 7
COURSE = {"start": (2.0, 0.0, 3.0), "goal": (9.0, 0.0, 3.0)}


def mission(plan="", **more):
    return resolve(MissionSpec(environment="sparse", seed=SEED, protection=str(plan), **COURSE, **more))


@pytest.fixture(scope="module")
def golden():
    """The plain golden flight, and the signatures of the tracker's calls."""
    seen = set()

    def noting(_, function):
        def call(*args):
            seen.add(signature_of(args))
            return function(*args)

        return call

    return fly(mission(), functions=PLAIN.instrumented(("track",), noting)), seen


@pytest.fixture(scope="module")
def plan(golden):
    return ProtectionPlan(functions=tuple(full_plan("pid", PLAIN.track, types) for types in golden[1]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("plans")


@pytest.fixture(scope="module")
def protected(plan, folder):
    """The mission with the plan; its time is not charged, so that flights can be compared."""
    save_plan(plan, folder / "plan.yaml")
    return mission(folder / "plan.yaml")


@pytest.fixture(scope="module")
def plain_faults():
    """Faults in plain code."""
    return draw_instruction_faults(mission(), InstructionRequest({"pid": 5}), seed=2).faults["pid"]


@pytest.fixture(scope="module")
def plain_logs(plain_faults):
    return [flight.log for flight in fly_instruction_faults(mission(), plain_faults).flights]


@pytest.fixture(scope="module")
def paired_logs(protected, plain_faults):
    """The same faults in the same executions of the same instructions of protected code."""
    return [flight.log for flight in fly_instruction_faults(protected, plain_faults).flights]


def test_the_shipped_plan_is_that_of_the_code(plan):
    """Made again after a change of a kernel: mavfi harden DIR --kernels pid,rrt_connect --addresses --budget 10."""
    shipped = load_plan("full")
    pid_functions = [
        function.model_copy(update={"time": 1.0}) for function in shipped.functions if function.kernel == "pid"
    ]
    assert tuple(pid_functions) == plan.functions
    assert any(
        function.kernel == "rrt_connect" and function.function.endswith(".plan") for function in shipped.functions
    )
    assert shipped.cpu and all(function.time > 1.0 for function in shipped.functions), "measured"


def test_the_golden_flight_is_the_plain_one(golden, protected):
    assert fly(protected).log.digest() == golden[0].log.digest()
    assert protected.key() != mission().key()


def test_what_was_silent_is_detected_and_computed_again(plain_logs, paired_logs):
    assert {log.kernel.effect for log in paired_logs} <= {"masked", "detected"}
    effects = [
        (before.kernel.effect, after.kernel.effect) for before, after in zip(plain_logs, paired_logs, strict=True)
    ]
    assert effects.count(("sdc", "detected")) == sum(before == "sdc" for before, _ in effects) >= 2
    for log in paired_logs:
        raised = [alarm for alarm in log.alarms if alarm.source == SOURCE]
        assert len(raised) == (log.kernel.effect == "detected")
        assert all(
            (alarm.state, alarm.action, alarm.outcome) == ("control.command", "recompute", "repaired")
            for alarm in raised
        )
        assert log.status.label == "success"


def test_faults_are_drawn_over_the_protected_program(protected, golden):
    drawn = draw_instruction_faults(protected, InstructionRequest({"pid": 4}, which="all"), seed=5)
    again = draw_instruction_faults(mission(), InstructionRequest({"pid": 1}), seed=5)
    assert drawn.golden.log.digest() == golden[0].log.digest()
    assert drawn.counts["pid"]["instructions"] > 1.8 * again.counts["pid"]["instructions"]
    assert drawn.counts["pid"]["calls"] == again.counts["pid"]["calls"]
    logs = [flight.log for flight in fly_instruction_faults(protected, drawn.faults["pid"]).flights]
    assert {log.kernel.effect for log in logs} <= {"masked", "detected"}
    roles = {log.injections[0].details.get("role", "") for log in logs}
    assert roles & {"shadow", "check", "copy"}


def test_forks_from_checkpoints_have_the_records_of_those_from_take_off(protected, plain_faults, paired_logs):
    flights = LocalHost().mission({"": ArmSetup(protected)})
    flights.register_golden("", fly(protected))
    forked = dict(flights.injected([("", fault) for fault in plain_faults]))
    for index, log in enumerate(paired_logs):
        assert forked[index].record() == record_of(log)


def test_a_detected_fault_is_explained(golden, paired_logs):
    log = next(log for log in paired_logs if log.kernel.effect == "detected")
    effect = effect_of(record_of(golden[0].log), record_of(log))
    assert effect in (Effect.DETECTED, Effect.MASKED)
    lines = dict(injection_lines(log.injections[0], None, log))
    assert lines["kernel"].endswith("detected by its protection; its step was computed again by plain code")
    assert verdict(Effect.DETECTED, log, golden[0].log).startswith("detected by the protection of the kernel")


@pytest.mark.parametrize(
    ("changes", "function_changes", "message"),
    [
        ({}, {"ir_sha256": "ab" * 32}, r"^protection of \S+pid\.track: planned for IR abababababab, this is [^\n]*$"),
        ({}, {"sites": (ModuleSite(0, 999, 0),)}, r"site 999:0 of function 0: not in its code[^\n]*$"),
        ({}, {"kernel": "pidd"}, "kernel 'pidd': not known"),
        ({}, {"function": "m.f"}, "function 'm.f': not of kernel pid; allowed: mavfi.kernels.control.pid.track"),
        ({"numba": "0.1"}, {}, "planned with numba 0.1, this is"),
    ],
)
def test_a_plan_that_does_not_fit_is_refused_in_one_line(plan, folder, changes, function_changes, message):
    functions = tuple(function.model_copy(update=function_changes) for function in plan.functions)
    save_plan(plan.model_copy(update={"functions": functions, **changes}), folder / "bad.yaml")
    with pytest.raises(BadInputError, match=message):
        fly(mission(folder / "bad.yaml"))


def test_the_measured_time_is_charged(plan, folder):
    slow = plan.model_copy(
        update={"functions": tuple(function.model_copy(update={"time": 1.5}) for function in plan.functions)}
    )
    save_plan(slow, folder / "slow.yaml")
    plain, charged = shipped("platforms", PlatformConfig, "i9-9940x").latency_us, mission(folder / "slow.yaml").platform
    assert charged.latency_us == plain | {"pid": round(1.5 * plain["pid"])}
    assert mission(folder / "slow.yaml").key() != mission(folder / "plan.yaml").key()
