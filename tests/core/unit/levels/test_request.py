import pytest

from mavfi.errors import BadInputError
from mavfi.faults.fault import FaultSite, InstructionFault, MemoryFault, StateFault
from mavfi.flight.compose import resolve
from mavfi.flight.host import ArmSetup
from mavfi.levels.level import parse, text_of
from mavfi.levels.memory import MemoryRequest
from mavfi.mission import MissionSpec


@pytest.mark.parametrize(
    "fault",
    [
        StateFault(FaultSite("planning.waypoint", "x"), 20_020_001, 62),
        StateFault(FaultSite("planning.trajectory", "x", 3), 5_000_000, 60, lasts_s=1.5, share=0.2, width=4, times=3),
        StateFault(FaultSite("control.command", "vx"), 0, 1, lasts_s=float("inf")),
    ],
)
def test_the_text_of_a_fault_names_all_of_it(fault):
    assert parse(text_of(fault)).resolve(0, "published") == fault


def test_the_text_of_a_fault_in_memory_or_in_none():
    fault = MemoryFault("waypoint", "points", 33, "f8", 20_000_000, 62)
    assert text_of(fault) == "memory:waypoint.points[33]:bit=62@20.0"
    assert parse(text_of(fault)) == MemoryRequest("waypoint", "points[33]", 62, 20_000_000)
    assert text_of(InstructionFault("m.f", "ab", 7, bits=(3,))) is None


@pytest.mark.parametrize(
    "changed",
    [{"bits": (62,)}, {"bits": (3, 60), "model": "bits", "restart_s": 0.2}, {"value": 1 << 90, "model": "random"}],
)
def test_the_text_of_a_fault_in_an_instruction_names_all_of_it(changed):
    fault = InstructionFault("", "ab" * 32, 42, 7, budget=10_300, kernel="pid", entry="track", **changed)
    assert parse(text_of(fault)).draw(ArmSetup(resolve(MissionSpec())), 0) == (fault, None)


@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        ("pid.insert_scan", "kernel 'pid': no function 'insert_scan'; allowed: track"),
        ("rrt.plan_rrt", "the planner of this mission is 'rrt_connect'"),
        ("lidar.scan", "kernel 'lidar': not known"),
    ],
)
def test_instructions_of_functions_that_are_not_flown_are_refused(kernel, message):
    text = f"instruction:{kernel}:call=0:index=0:bit=3:budget=100:ir={'ab' * 32}"
    with pytest.raises(BadInputError, match=message):
        parse(text).draw(ArmSetup(resolve(MissionSpec())), 0)
