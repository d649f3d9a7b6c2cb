import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.faults.fault import FaultSite
from mavfi.flight.compose import resolve
from mavfi.flight.host import ArmSetup
from mavfi.levels.instruction.drawing import InstructionRequest
from mavfi.levels.level import parse, text_of
from mavfi.levels.memory.request import MemoryRequest
from mavfi.levels.sensor import parse_sensor
from mavfi.levels.sensor.fault import SensorFault
from mavfi.mission import MissionSpec
from mavfi.record import Profile
from mavfi.states import AUTOPILOTS

PROFILE = Profile(
    {
        "planning.waypoint": np.array([100, 200, 300], np.int64),
        "planning.trajectory": np.array([50, 250], np.int64),
    },
    {"planning.waypoint": np.zeros(3, np.int32), "planning.trajectory": np.array([0, 7], np.int32)},
)


def test_everything_named():
    request = parse("state:planning.trajectory.x[3]:bit=62@5.0")
    assert not request.needs_profile
    fault = request.resolve(0, "published")
    assert fault.where == FaultSite("planning.trajectory", "x", 3)
    assert (fault.bit, fault.time_us) == (62, 5_000_000)


def test_states_of_one_localization_can_be_named_with_it_alone():
    fault = parse("state:perception.odometry.x:bit=62@5.0", "estimator").resolve(0, "published")
    assert (fault.where, fault.site) == (FaultSite("perception.odometry", "x"), "perception.odometry.x")
    for text, localization in (("state:perception.odometry.x", "truth"), ("state:sensor.odometry", "estimator")):
        with pytest.raises(BadInputError, match="is published with localization"):
            parse(text, localization)


def test_instant_and_bit_are_drawn_from_the_seed():
    request = parse("state:planning.waypoint.x")
    assert request.needs_profile
    faults = [request.resolve(seed, "published", PROFILE) for seed in range(1000)]
    assert request.resolve(5, "published", PROFILE) == faults[5]
    assert {fault.time_us for fault in faults} == {100, 200, 300}
    assert {fault.bit for fault in faults} == set(range(64))


def test_the_field_is_drawn_from_those_that_are_read():
    request = parse("state:planning.waypoint")
    drawn = {
        autopilot: {request.resolve(seed, autopilot, PROFILE).where.field for seed in range(300)}
        for autopilot in AUTOPILOTS
    }
    assert drawn["hardened"] - drawn["published"] == {"ax", "ay", "az"}
    assert {"x", "y", "z", "yaw", "vx", "vy", "vz", "duration"} <= drawn["published"]


def test_a_named_bit_leaves_only_fields_that_have_it():
    request = parse("state:perception.collision_status:bit=40@1")
    assert {request.resolve(seed, "published").where.field for seed in range(50)} == {"time_to_collision"}


def test_the_element_is_drawn_from_the_publication_that_is_injected():
    request = parse("state:planning.trajectory.x:bit=3@0.0001")
    assert request.needs_profile
    faults = [request.resolve(seed, "published", PROFILE) for seed in range(100)]
    assert {fault.where.element for fault in faults} == set(range(7))
    assert {fault.time_us for fault in faults} == {100}


def test_null_is_an_empty_mask_at_a_drawn_instant():
    fault = parse("null").resolve(3, "published", PROFILE)
    assert fault.bit is None
    assert fault.time_us in (100, 200, 300)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("", "null, state:..."),
        ("state:", "not understood; allowed: state:STATE"),
        ("state:planning.waypoint.x:bit=x", "bit: 'x': allowed: a whole number"),
        ("state:planning.waypoint.x@-3", "instant '-3': allowed: a number of seconds from 0 on"),
        ("state:planning.waypoint.roll", "x, y, z, yaw"),
        ("state:planning.waipoint.x", "sensor.depth"),
        ("state:planning.waypoint.x[3]", "no element"),
        ("state:planning.waypoint.x:bit=63:width=2", "no bit 64 in planning.waypoint.x; allowed: 0 to 63"),
        ("state:planning.waypoint.x:bit=3:also=y", "also: 'y': allowed: further fields and their bits, e.g. y.60+z.3"),
        ("state:planning.waypoint.x:also=y.3", "also: goes with a field and its bit; allowed: FIELD:bit=N:also="),
        ("state:planning.waypoint.x:bit=3:also=y.4:times=2", "also: 1 further fields: allowed: in one bit of one"),
        ("state:planning.waypoint.x:bits=3", "'bits': not known (did you mean 'bit='?); allowed: bit=, also=, width="),
        (
            "planning.waypoint.x",
            "not understood (did you mean 'state:planning.waypoint.x'?); allowed: null, state:...",
        ),
        ("instruction:pid.track:call=1:index=2:bit=3", "allowed: instruction:KERNEL"),
        ("instruction:pid:model=two_bits", "model 'two_bits': not known (did you mean 'one_bit'?); allowed: one_bit"),
        ("sensor:radar:off@3", "'radar': not known; allowed: gyro, accelerometer, compass, position, depth_camera"),
        ("sensor:gyro", "no type of failure; allowed: sensor:gyro:TYPE, with TYPE one of off, stuck, garbage"),
        ("register:1234", "registers are injected by mavfi inject; allowed: state, memory"),
    ],
)
def test_errors_are_one_line_that_says_what_is_allowed(text, names):
    with pytest.raises(BadInputError) as caught:
        parse(text)
    message = str(caught.value)
    assert "\n" not in message
    assert names in message
    assert repr(text) in message
    assert "allowed:" in message


def test_further_fields_can_be_named_and_are_written_again():
    text = "state:planning.trajectory.x[3]:bit=62:also=y.60+z.3@5.0"
    fault = parse(text).resolve(0, "published")
    assert fault.also == (("y", 60), ("z", 3))
    assert text_of(fault) == text


def test_a_lifetime_can_be_named():
    fault = parse("state:planning.waypoint.x:bit=60:lasts=1@5").resolve(0, "published")
    assert (fault.bit, fault.time_us, fault.lasts_s, fault.lasting) == (60, 5_000_000, 1.0, True)
    fault = parse("state:planning.waypoint.x:width=3:times=2:lasts=inf:share=0.25@5").resolve(0, "published")
    assert (fault.width, fault.times, fault.lasts_s, fault.share) == (3, 2, float("inf"), 0.25)
    drawn = {parse("state:planning.waypoint:width=40@5").resolve(seed, "published").bit for seed in range(300)}
    assert drawn == set(range(25)), "a burst lies within a word that can hold it"


def test_faults_in_memory_name_kernel_and_word():
    assert parse("memory:octomap") == MemoryRequest("octomap")
    assert parse("memory:planner.acted_seq:bit=3@5") == MemoryRequest("planner", "acted_seq", 3, 5_000_000)
    assert parse("memory:collision_check.trajectories[1].x[12]@0.5") == MemoryRequest(
        "collision_check", "trajectories[1].x[12]", None, 500_000
    )
    assert parse("memory:state_estimation.filter", "estimator") == MemoryRequest("state_estimation", "filter")


def test_failures_name_unit_type_duration_and_instant():
    for text in ("sensor:gyro:drift@10.0", "sensor:motor2:off:lasts=5.0@0.5", "sensor:depth_camera:stuck@3.25"):
        request = parse(text)
        fault = request.resolve(7, 0)
        assert not request.draws_start and fault.seed == 7 and text_of(fault) == text
    drawn = {parse("sensor:position:wrong").resolve(seed, 5_000_000).time_us for seed in range(100)}
    assert parse("sensor:position:wrong").draws_start and 0 <= min(drawn) < max(drawn) < 5_000_000 and len(drawn) > 90
    assert parse_sensor("sensor:motor:off@2", 3) == SensorFault("motor", "off", 2_000_000, seed=3)
    with pytest.raises(BadInputError, match="without an instant"):
        parse_sensor("sensor:motor:off", 3)


def test_faults_in_instructions_name_kernel_class_and_model():
    assert parse("instruction:octomap") == InstructionRequest({"octomap": 1})
    assert parse("instruction:pid:which=line:pid.py:74-90:model=zero") == InstructionRequest(
        {"pid": 1}, "line:pid.py:74-90", "zero"
    )
    assert parse("instruction:pid:which=opcode:fmul") == InstructionRequest({"pid": 1}, "opcode:fmul")


@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        ("pid.insert_scan", "kernel 'pid': function 'insert_scan': not known; allowed: track"),
        ("rrt.plan_rrt", "the planner of this mission is 'rrt_connect'"),
        ("lidar.scan", "kernel 'lidar': not known"),
    ],
)
def test_instructions_of_functions_that_are_not_flown_are_refused(kernel, message):
    text = f"instruction:{kernel}:call=0:index=0:bit=3:budget=100:ir={'ab' * 32}"
    with pytest.raises(BadInputError, match=message):
        parse(text).draw(ArmSetup(resolve(MissionSpec())), 0)
