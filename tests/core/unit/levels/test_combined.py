"""Several faults of a mission as text and as data, and what is refused."""

import pytest

from mavfi.errors import BadInputError
from mavfi.faults.combined import Start
from mavfi.faults.fault import FaultSite, fault_from_json
from mavfi.flight.host import ArmSetup
from mavfi.levels.combined import fewer_faults
from mavfi.levels.combined.fault import CombinedFault
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.level import parse, text_of
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.state.fault import StateFault
from tests.core.flights.missions import mission

SPEED = StateFault(FaultSite("control.command", "vx"), 4_000_000, 62)
POINT = MemoryFault("waypoint", "points", 3, "f8", 5_000_000, 62, lasts_s=2.0)


def drawn(text):
    """The faults of a text in which everything is given."""

    return parse(text, "truth").draw(ArmSetup(mission()), 0)


@pytest.mark.parametrize(
    "text",
    [
        "state:control.command.vx:bit=62@4.0 + state:control.command.vy:bit=3@5.0",
        "state:control.command.vx:bit=62@4.0 + state:planning.waypoint.x:set=nan@alarm",
        "state:control.command.vx:bit=62@4.0 + message:control.command:drop:times=3@injection+0.5",
        "sensor:gyro:off:lasts=1.0@4.0 + sensor:position:wrong@alarm+2",
    ],
)
def test_several_faults_are_read_back_from_their_text_and_from_their_data(text):
    fault, _ = drawn(text)
    assert text_of(fault) == text
    assert fault_from_json(fault.to_json()) == fault
    assert len(fault.faults) == 2


def test_equal_texts_draw_different_faults():
    fault, _ = drawn(" + ".join(["state:control.command.vx@4.0"] * 3))
    assert len({member.bit for member in fault.faults}) > 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("state:control.command.vx:bit=62@alarm", "no fault precedes it"),
        ("state:control.command.vx:bit=62@4 + instruction:pid@alarm", "not understood"),
        ("state:control.command.vx:bit=62@4 + pid", "fault 'pid': not understood"),
        ("state:control.command.vx:bit=62@4 + state:control.command.vx:bit=62@injection+1e9", "not understood|instant"),
    ],
)
def test_what_cannot_be_combined_is_refused(text, message):
    with pytest.raises(BadInputError, match=message):
        parse(text, "truth")


@pytest.mark.parametrize(
    ("faults", "starts", "message"),
    [
        ((), (), "0 faults"),
        ((SPEED, InstructionFault("", "", 0, kernel="pid")), (None, Start("alarm")), "@alarm: allowed for faults of"),
        ((CombinedFault((SPEED,), (None,)),), (None,), "allowed: faults of other levels"),
    ],
)
def test_combinations_that_no_flight_can_have_are_refused(faults, starts, message):
    with pytest.raises(BadInputError, match=message):
        CombinedFault(faults, starts)


def test_a_stored_start_that_is_none_is_refused():
    data = CombinedFault((SPEED, POINT), (None, Start("alarm"))).to_json()
    data["faults"][1]["start"] = "sunrise"
    with pytest.raises(BadInputError, match="key 'start': 'sunrise'"):
        fault_from_json(data)


def test_shrinking_tries_each_fault_alone_and_then_all_but_one():
    fault = CombinedFault((SPEED, POINT, SPEED), (None, None, Start("alarm")))
    alone = [SPEED, POINT]
    two = [
        CombinedFault((SPEED, SPEED), (None, Start("alarm"))),
        CombinedFault((SPEED, POINT), (None, None)),
    ]
    assert list(fewer_faults(fault, None)) == alone + two


def test_a_fault_that_lasts_in_memory_is_read_back_from_its_text():
    for text in (
        "memory:waypoint.points[3]:bit=62:lasts=2.0@5.0",
        "memory:waypoint.points[3]:set=nan:times=0@5..8",
        "memory:waypoint.points[3]:bias=0.5:every=10:times=4@5",
    ):
        request = parse(text, "truth")
        bit = 62 if request.change is None else None
        fault = MemoryFault(
            "waypoint", "points", 3, "f8", request.time_us, bit, "", 1.0, 0, request.lasts_s, request.change
        )
        assert parse(text_of(fault), "truth") == request
        assert fault_from_json(fault.to_json()) == fault


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("memory:planner.x:drop@5", "drop: of whole messages"),
        ("memory:planner.x:set=nan@n=4", "no message arrives in memory"),
        ("memory:planner.x:set=nan@vx>3", "no message arrives in memory"),
        ("memory:planner.x:lasts=long@5", "lasts: 'long'"),
    ],
)
def test_changes_that_a_memory_cannot_have_are_refused(text, message):
    with pytest.raises(BadInputError, match=message):
        parse(text, "truth")
