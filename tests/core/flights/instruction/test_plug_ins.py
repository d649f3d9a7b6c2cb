"""Faults in the compiled functions, and in the memory, of custom planners, maps, detectors and flight controllers."""

import pytest
from pydantic import ValidationError

from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.host import ArmSetup
from mavfi.flight.targets import Targets
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.levels.level import parse
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.numerics.jit import KernelDispatcher
from tests.core.flights import plug_ins
from tests.core.flights.plug_ins import Largest

OF = "tests.core.flights.plug_ins:"
MISSION = {"planner": f"{OF}Straight", "map": f"{OF}Wrapped", "flight_controller": f"{OF}Limited"}
COURSE = {"start": (2.0, 0.0, 3.0), "goal": (9.0, 0.0, 3.0), "v_max": 6.0}
NAMES = ("Straight", "Wrapped", "Limited")


def scenario(**keys):
    return resolve(MissionSpec(environment="sparse", seed=7, **COURSE, **keys))


def campaign(level, kernels, **keys):
    return Campaign.model_validate(
        {
            "name": "mine",
            "environments": ["sparse"],
            "first_seed": 7,
            "missions": 2,
            "faults": 2,
            "null_runs": 0,
            "sampling": {"level": level, "kernels": kernels, "share": "kernel"},
            "mission": {**COURSE, "planner": f"{OF}Straight", "map": f"{OF}Wrapped"},
            **keys,
        }
    )


def setup(detector=None, **keys):
    return ArmSetup(scenario(**keys), detector)


# ---- flights --------------------------------------------------------------------------------------------------------
def test_functions_are_counted_injected_and_replayed_under_the_names_of_the_plug_ins():
    mission = scenario(**MISSION)
    golden = fly(mission).log
    drawn = draw_instruction_faults(mission, InstructionRequest(dict.fromkeys(NAMES, 4)), seed=2)
    assert drawn.golden.log.digest() == golden.digest()
    faults = [fault for name in NAMES for fault in drawn.faults[name]]
    assert [(fault.kernel, fault.entry, fault.role) for fault in faults[::4]] == [
        ("Straight", "track", "planner"),
        ("Wrapped", "insert", "map"),
        ("Limited", "limited", "flight_controller"),
    ]
    files = {name: {line[0].rpartition("/")[2] for line in drawn.counts[name]["lines"]} for name in NAMES}
    assert files["Straight"] == files["Limited"] == {"plug_ins.py"}, "callees are part of a function's machine code"

    first, second = (fly_instruction_faults(mission, faults).flights for _ in range(2))
    assert [flight.log.digest() for flight in first] == [flight.log.digest() for flight in second]
    injections = [flight.log.injections[0] for flight in first]
    assert all(injection.activated for injection in injections)
    assert {injection.file.rpartition("/")[2] for injection in injections[:4]} == {"plug_ins.py"}
    assert all(type(function) is KernelDispatcher for function in (plug_ins.track, plug_ins.limited))


def test_setpoint_generators_and_trackers_are_replaced_and_injected():
    mission = scenario(waypoint=f"{OF}Higher", pid=f"{OF}Proportional")
    golden = fly(mission).log
    assert golden.status is MissionStatus.SUCCESS and golden.digest() != fly(scenario()).log.digest()
    request = InstructionRequest({"Higher": 3, "pid": 3})
    drawn = draw_instruction_faults(mission, request, seed=2)
    faults = [*drawn.faults["Higher"], *drawn.faults["pid"]]
    assert [fault.site for fault in faults[::3]] == ["Higher.shifted", "Proportional.steer"]
    first, second = (fly_instruction_faults(mission, faults).flights for _ in range(2))
    assert [flight.log.digest() for flight in first] == [flight.log.digest() for flight in second]
    assert first[0].log.kernel.effect in ("sdc", "masked", "crash", "exception", "hang")
    with pytest.raises(BadInputError, match="pid .*allowed: a subclass of mavfi.pipeline.control.Tracker"):
        scenario(pid=f"{OF}Higher")


@pytest.mark.parametrize("name", ["detector", "Largest", "too_large"])
def test_a_detector_is_called_by_its_class_or_the_source_of_its_alarms(name):
    fault, _ = parse(f"instruction:{name}").draw(setup(Largest), 5)
    assert (fault.kernel, fault.entry, fault.in_detector) == ("Largest", "judge", True)
    flown = [fly_instruction_faults(scenario(), [fault], Largest()).flights[0].log.digest() for _ in range(2)]
    assert flown[0] == flown[1]


@pytest.mark.long
def test_a_dead_flight_controller_stops_the_rotors_until_it_is_back():
    mission = scenario(**MISSION)
    wish = InstructionRequest({"flight_controller": 30}, which="address", restart_s=0.2)
    faults = [fault for fault in draw_instruction_faults(mission, wish, seed=1).faults["flight_controller"]]
    flights = fly_instruction_faults(mission, faults).flights
    died = [flight.log for flight in flights if flight.log.kernel.effect == "crash"]
    assert died
    assert all(log.digest() != fly(mission).log.digest() for log in died)


def test_the_memory_that_a_plug_in_declares_is_drawn_and_injected():
    for name, key in (("Straight.heights", "planner"), ("Wrapped", "map"), ("Limited.memory", "flight_controller")):
        fault, golden = parse(f"memory:{name}").draw(setup(**MISSION), 4)
        assert (fault.kernel, fault.role) == (name.partition(".")[0], key)
        assert fly(scenario(**MISSION), fault).log.injections[0].activated
    fault, _ = parse("memory:detector.limits:bit=62@1").draw(setup(Largest), 4)
    log = fly(scenario(), fault, Largest()).log
    assert log.injections[0].activated and fault.in_detector


# ---- refusals -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("Plain", "names no compiled function, and plain Python is not injected; allowed: functions of kernel_jit"),
        ("Uncompiled", "compiled: 'plain': is not compiled by kernel_jit"),
        ("Twice", "compiled: 'track': twice; allowed: {'name': function} with two names"),
        ("Text", "compiled: 'track': allowed: a tuple of functions"),
    ],
)
def test_what_names_no_compiled_function_is_refused_in_one_line(name, why):
    with pytest.raises(BadInputError) as caught:
        parse("instruction:planner").draw(setup(planner=f"{OF}{name}"), 0)
    message = str(caught.value)
    assert why in message and f"planner '{OF}{name}'" in message and "\n" not in message


def test_what_does_not_exist_is_answered_by_what_this_mission_has():
    with pytest.raises(BadInputError, match="'lidar': not known; allowed: point_cloud, Wrapped, collision_check, Stra"):
        Targets(scenario(**MISSION)).find("lidar")
    with pytest.raises(
        BadInputError, match="kernel 'lidar': not known; allowed: point_cloud, .* Wrapped, Straight, Limited"
    ):
        parse("memory:lidar").draw(setup(**MISSION), 0)
    with pytest.raises(BadInputError, match=f"the planner of this mission is '{OF}Straight'"):
        Targets(scenario(**MISSION)).find("rrt_connect")
    with pytest.raises(ValidationError, match="'lidar': not known; allowed: point_cloud, .*, Wrapped, Straight, Larg"):
        campaign("instruction", ["lidar"], arms={"mine": {"detector": f"{OF}Largest"}})


def test_a_plug_in_with_the_name_of_a_kernel_is_called_by_its_key():
    targets = Targets(scenario(planner=f"{OF}pid"))
    assert targets.find("planner").role == "planner" and targets.find("pid").role == ""


def test_a_function_may_make_the_plug_in():
    assert list(Targets(scenario(planner=f"{OF}make_straight")).find("planner").functions) == ["track"]
