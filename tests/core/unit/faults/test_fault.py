"""Faults of all levels are one union of plain data."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.extras.registers.fault import RegisterFault
from mavfi.faults.fault import NO_SITE, FaultSite, fault_from_json, find_level
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.sensor.fault import SensorFault
from mavfi.levels.state.fault import StateFault


@pytest.mark.parametrize(
    ("fault", "bit"),
    [
        (StateFault(FaultSite("control.command", "vx"), NO_SITE, 62), 62),
        (MemoryFault("pid", "remaining", None, "f8", NO_SITE), None),
        (InstructionFault("f", "", 0, NO_SITE, (3,)), 3),
        (InstructionFault("f", "", 0, NO_SITE, (3, 4)), None),
        (SensorFault("gyro", "drift", NO_SITE), None),
    ],
)
def test_a_fault_says_its_level_its_bit_and_whether_it_has_a_site(fault, bit):
    assert find_level(fault.level).fault is type(fault) and fault.bit == bit and not fault.has_site
    assert replace(fault, **{name: 5 for name in ("time_us", "call") if hasattr(fault, name)}).has_site


def test_what_only_lasting_faults_have_is_left_out_of_the_others():
    once = StateFault(FaultSite("control.command", "vx"), 5, 62)
    assert list(once.to_json()) == ["level", "where", "time_us", "bit", "stratum", "weight", "seed"]
    assert not once.lasting and not StateFault(FaultSite("control.command", "vx"), width=2).lasting
    stuck = StateFault(FaultSite("control.command", "vx"), 5, 62, lasts_s=float("inf"), times=2)
    vector = replace(once, bit=1, also=(("vy", 60), ("vz", 3)))
    assert vector.to_json() == {**once.to_json(), "bit": 1, "also": (("vy", 60), ("vz", 3))}
    assert fault_from_json(vector.to_json()) == vector
    assert stuck.lasting and stuck.to_json() == {**once.to_json(), "lasts_s": "inf", "times": 2}


def test_sites_as_text():
    assert StateFault(FaultSite("planning.path", "x", 2)).site == "planning.path.x[2]"
    assert StateFault(FaultSite("control.command", "vx")).site == "control.command.vx"
    assert MemoryFault("planner", "decisions.acted_seq").site == "memory:planner.decisions.acted_seq"
    assert MemoryFault("waypoint", "points", 12).site == "memory:waypoint.points[12]"
    assert SensorFault("motor", "off", instance=2).site == "motor2 off"
    assert SensorFault("gyro", "drift").site == "gyro drift"
    assert InstructionFault("m.f", "sha", 1, kernel="pid", entry="track").site == "pid.track"
    assert InstructionFault("m.f", "sha", 1).site == "m.f"
    assert MessageFault("/joints", "position[0]").site == "/joints.position[0]"
    assert (RegisterFault("fp", node="planner").site, RegisterFault("fp").site) == ("planner:fp", "fp")


@given(st.lists(st.integers(0, 63), min_size=1, max_size=4, unique=True), st.integers(0, 2**64 - 1))
def test_bits_are_flipped_or_the_whole_value_is_replaced(bits, value):
    for fault, wanted in (
        (InstructionFault("f", "", 0, bits=tuple(bits)), lambda v: v ^ sum(1 << bit for bit in bits)),
        (InstructionFault("f", "", 0, value=value), lambda v: value),
    ):
        keep, flip = fault.masks
        for before in (0, 2**64 - 1, value):
            assert (before & keep) ^ flip == wanted(before)
    assert InstructionFault("f", "", 0, bits=tuple(bits)).bit == (bits[0] if len(bits) == 1 else None)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StateFault(FaultSite("a", "x"), lasts_s=-1.0), "lasts_s: -1.0: allowed: 0 or more"),
        (
            lambda: fault_from_json({**StateFault(FaultSite("control.command", "vx"), bit=63, width=2).to_json()}),
            "bit 63; allowed: 0 to 62",
        ),
        (lambda: MemoryFault("pilot", "x"), "'pilot': not known; allowed: point_cloud, pid, "),
        (lambda: MemoryFault("pid", "law", 0, "f2"), "'f2': not known; allowed: f8, f4"),
        (lambda: MessageFault("t", "f", at=0), "at: 0: allowed: 1 or more"),
        (lambda: RegisterFault(thread=1), "thread: 1: allowed"),
        (lambda: fault_from_json({"level": "planet"}), "level 'planet': not known; allowed: state, memory"),
    ],
)
def test_what_is_not_allowed_is_named(make, message):
    with pytest.raises(BadInputError) as caught:
        make()
    assert message in str(caught.value)
