import pytest

from mavfi.campaign.samplers.request import text_of
from mavfi.faults.fault import FaultSite, InstructionFault, MemoryFault, StateFault
from mavfi.faults.spec import MemoryRequest, parse


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
