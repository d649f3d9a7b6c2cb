"""Calls of the API in this process: what they return, how tasks end, what is refused."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.airsim.boundary import Boundary, parse_fault
from mavfi.extras.airsim.frames import LEVEL, to_geo_point, to_pose, to_vector3r
from mavfi.extras.airsim.host import make_api
from mavfi.extras.airsim.scene import REFUSED
from mavfi.extras.airsim.server import AirsimServer, RealClock, StepClock
from mavfi.extras.airsim.table import CALLS
from mavfi.mission import MissionSpec
from mavfi.report.text import percent
from mavfi.sim.environments import build_world
from mavfi.sim.simulator import Simulator
from tests.core.architecture.source import ROOT

STILL = {"is_rate": True, "yaw_or_rate": 0.0}
AHEAD = {"is_rate": False, "yaw_or_rate": 0.0}
FORWARD_ONLY = 1
SPEC = MissionSpec(environment="sparse", seed=7)


class Client:
    """Calls a server as its own protocol does; `wait` lets its task end first."""

    def __init__(self, *, clock=None, fault=None, boundary=None, fault_vehicle="", **options):
        boundary = boundary or Boundary(fault)
        boundary.vehicle = fault_vehicle
        self.server = AirsimServer(make_api(SPEC, **options), clock or StepClock(limit_us=10**9), boundary)
        self.vehicle = self.server.api.vehicle
        self.answers = {}

    def post(self, name, *arguments):
        number = len(self.answers)
        self.answers[number] = None
        self.server.serve_call(
            name, list(arguments), lambda error, result: self.answers.update({number: (error, result)})
        )
        return number

    def __call__(self, name, *arguments):
        number = self.post(name, *arguments)
        while self.answers[number] is None:  # until its task ends, not that of another vehicle
            self("mavfiPass", None, True, "")
        error, result = self.answers[number]
        if error is not None:
            raise RuntimeError(error)
        return result

    def sleep(self, seconds):
        self("mavfiPass", self("mavfiClock") + round(1e6 * seconds), False, "time.sleep")

    def ready(self):
        self("enableApiControl", True, "")
        self("armDisarm", True, "")
        return self

    @property
    def at(self):
        return np.array(self.vehicle.position)


@pytest.fixture(scope="module")
def flying():
    client = Client().ready()
    assert client("takeoff", 20.0, "")
    return client


def test_whole_calls_are_lost_late_repeated_and_frozen():
    def client(fault):
        made = Client(fault=parse_fault(fault)).ready()
        assert made("takeoff", 20.0, "") is True
        return made

    # lost: the second reading is the first one's answer
    lost = client("getMultirotorState:drop@n=2")
    first = lost("getMultirotorState", "")
    lost.sleep(1.0)
    assert lost("getMultirotorState", "") == first != lost("getMultirotorState", "")
    assert lost.server.boundary.injection.details["calls"] == 1

    # late: simulated time passes first
    late = client("simGetVehiclePose:delay=0.5")
    before_us = late.vehicle.now_us
    late("simGetVehiclePose", "")
    assert 500_000 <= late.vehicle.now_us - before_us < 600_000

    # frozen: later readings are the first one, and later commands have its arguments
    frozen = client("simGetVehiclePose:freeze@n=2")
    poses = []
    for _ in range(4):
        poses.append(frozen("simGetVehiclePose", "")["position"]["z_val"])
        frozen("moveByVelocity", 0.0, 0.0, -1.0, 1.0, 0, STILL, "")
    assert poses[1] == poses[2] == poses[3] != poses[0]
    up = client("moveByVelocity:freeze")
    for speed in (-1.0, 1.0):
        height = up.at[2]
        up("moveByVelocity", 0.0, 0.0, speed, 1.0, 0, STILL, "")
        assert up.at[2] < height

    # repeated: two tasks are started, the later one is answered
    twice = client("moveByVelocity:duplicate")
    started = []
    start = twice.vehicle.start
    twice.vehicle.start = lambda task: started.append(task) or start(task)
    assert twice("moveByVelocity", 1.0, 0.0, 0.0, 1.0, 0, STILL, "") is True and len(started) == 2


def test_a_server_in_real_time_refuses_late_calls():
    with pytest.raises(BadInputError, match="delay: simulated time passes in real time"):
        Client(clock=RealClock(), fault=parse_fault("hover:delay=1"))


def test_take_off_land_and_what_the_state_says():
    client = Client().ready()
    assert client("getMultirotorState", "")["landed_state"] == 0
    assert client("takeoff", 20.0, "") is True and -2.0 < client.at[2] < -1.4
    state = client("getMultirotorState", "")
    assert state["landed_state"] == 1 and not state["collision"]["has_collided"]
    assert state["kinematics_estimated"]["position"] == to_vector3r(client.vehicle.position)
    assert client("land", 60.0, "") is True and client("getMultirotorState", "")["landed_state"] == 0
    assert client("armDisarm", False, "") and not client("simGetCollisionInfo", "")["has_collided"]
    with pytest.raises(RuntimeError, match="takeoff: the motors are off; allowed: after armDisarm"):
        client("takeoff", 20.0, "")


@pytest.mark.parametrize(
    ("name", "arguments", "wanted"),
    [
        ("moveToPosition", (3.0, 2.0, -4.0, 2.0, 60.0, 0, STILL, -1.0, 1.0, ""), (3.0, 2.0, -4.0)),
        ("moveToZ", (-5.0, 2.0, 60.0, STILL, -1.0, 1.0, ""), (None, None, -5.0)),
        ("goHome", (60.0, ""), (0.0, 0.0, 0.0)),
        (
            "moveOnPath",
            ([to_vector3r((2, 0, -4)), to_vector3r((2, 3, -4))], 2.0, 60.0, FORWARD_ONLY, AHEAD, 2.0, 1.0, ""),
            (2, 3, -4),
        ),
    ],
)
def test_a_place_is_reached_within_half_a_metre(flying, name, arguments, wanted):
    assert flying(name, *arguments) is True
    off = [abs(is_at - should) for is_at, should in zip(flying.at, wanted, strict=True) if should is not None]
    assert max(off) <= 0.5


def test_velocities_in_both_frames_and_yaw(flying):
    assert flying("rotateToYaw", 90.0, 20.0, 2.0, "") and flying.vehicle.yaw == pytest.approx(math.pi / 2, abs=0.06)
    before = flying.at
    assert flying("moveByVelocityBodyFrame", 1.0, 0.0, 0.0, 3.0, 0, STILL, "")
    east, north = flying.at[1] - before[1], flying.at[0] - before[0]
    assert east == pytest.approx(2.6, abs=0.4) and abs(north) < 0.3
    assert flying("moveByVelocityZ", -1.0, 0.0, -5.0, 4.0, 0, STILL, "") and flying.at[2] == pytest.approx(
        -5.0, abs=0.3
    )
    assert flying("rotateByYawRate", 30.0, 1.0, "") and flying("hover", "")


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("moveByRollPitchYawZ", (0.0, 0.0, 0.0, -5.0, 3.0, "")),
        ("moveByRollPitchYawThrottle", (0.0, 0.0, 0.0, 0.5866, 1.0, "")),
        ("moveByRollPitchYawrateZ", (0.0, 0.0, 0.5, -5.0, 3.0, "")),
        ("moveByAngleRatesZ", (0.0, 0.0, 0.0, -5.0, 2.0, "")),
        ("moveByMotorPWMs", (0.5866, 0.5866, 0.5866, 0.5866, 0.5, "")),
    ],
)
def test_commands_below_the_velocity_loop_fly(flying, name, arguments):
    flying("moveToZ", -5.0, 2.0, 60.0, STILL, -1.0, 1.0, "")
    assert flying(name, *arguments) and flying.at[2] == pytest.approx(-5.0, abs=0.8)
    flying("hover", "")


def test_a_new_task_ends_the_one_before_with_false(flying):
    first = flying.post("moveToPosition", 50.0, 0.0, -5.0, 1.0, 60.0, 0, STILL, -1.0, 1.0, "")
    assert flying("hover", "") is True and flying.answers[first] == (None, False)
    last = flying.post("moveByVelocity", 1.0, 0.0, 0.0, 60.0, 0, STILL, "")
    flying("cancelLastTask", "")
    assert flying.answers[last] == (None, False)


def test_reset_answers_the_task_and_goes_back_to_the_start():
    client = Client().ready()
    client("takeoff", 20.0, "")
    task = client.post("moveToPosition", 50.0, 0.0, -5.0, 1.0, 60.0, 0, STILL, -1.0, 1.0, "")
    before = client.vehicle.now_us
    client("reset")
    assert client.answers[task] == (None, False) and client.vehicle.now_us >= before
    assert not client.at.any() and client.vehicle.landed and not client("isApiControlEnabled", "")
    with pytest.raises(RuntimeError, match="API control is off"):
        client("hover", "")


def test_time_passes_in_calls_only_and_a_pause_stops_it():
    client = Client().ready()
    client("simPause", True)
    before = client.vehicle.now_us
    for _ in range(5):
        client("simGetVehiclePose", "")
    assert client.vehicle.now_us == before and client("simIsPaused")
    first, second = client("mavfiNow"), client("mavfiNow")
    assert second > first  # a program that waits by polling its clock does not wait for ever
    client("simContinueForTime", 0.5)
    assert client.vehicle.now_us == before + 500_000 and client("simIsPaused")
    client("simContinueForFrames", 3)
    assert client.vehicle.now_us == before + 560_000
    client("simPause", False)
    client.sleep(1.0)
    assert client.vehicle.now_us >= before + 1_560_000


def test_depth_is_that_of_the_mission_s_camera_bit_for_bit():
    client = Client(on_ground=False)
    scenario = client.vehicle.scenario
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    ranges, _ = Simulator(world, scenario).depth()
    request = {"camera_name": "0", "image_type": 2, "pixels_as_float": True, "compress": False}
    (image,) = client("simGetImages", [request], "", False)
    ranges_of_image = np.array(image["image_data_float"], np.float32)
    ranges_of_image[ranges_of_image >= scenario.camera.range] = np.inf
    assert (image["width"], image["height"]) == (64, 48) and ranges_of_image.tobytes() == ranges.tobytes()
    (planar,) = client("simGetImages", [{**request, "image_type": 1}], "", False)
    assert (np.array(planar["image_data_float"]) <= np.array(image["image_data_float"]) + 1e-6).all()


def test_sensors_agree_with_the_state(flying):
    flying("hover", "")
    flying.sleep(2.0)
    imu = flying("getImuData", "", "")
    assert imu["linear_acceleration"]["z_val"] == pytest.approx(-9.80665, abs=0.3)
    assert flying("getBarometerData", "", "")["altitude"] == pytest.approx(122.0 - flying.at[2])
    assert flying("getGpsData", "", "")["gnss"]["geo_point"]["altitude"] == pytest.approx(122.0 - flying.at[2])
    cloud = np.array(flying("getLidarData", "", "")["point_cloud"]).reshape(-1, 3)
    ground = cloud[np.abs(cloud[:, 2] - 0.35) < 0.05]  # NED: the origin is one radius above the ground
    assert len(ground) > 0.3 * len(cloud) > 100
    assert 0.2 <= flying("getDistanceSensorData", "", "")["distance"] <= 40.0
    rotors = flying("getRotorStates", "")["rotors"]
    assert sum(rotor["thrust"] for rotor in rotors) == pytest.approx(9.80665, rel=0.02)
    full_thrust, full_speed = 4.179446268, 6396.667 * 2.0 * math.pi / 60.0  # AirSim's RotorParams
    expected = full_speed * math.sqrt(rotors[0]["thrust"] / full_thrust)
    assert rotors[0]["speed"] == pytest.approx(expected, rel=1e-4)
    assert flying("getMagnetometerData", "", "")["magnetic_field_body"]["z_val"] > 0.3


def test_objects_are_listed_moved_spawned_and_met():
    client = Client().ready()
    names = client("simListSceneObjects", "box_.*")
    assert len(names) == len(client.vehicle.sim.world.lower) > 3
    assert (
        client("simSpawnObject", "wall", "Cube", to_pose((5.0, 0.0, -2.0), LEVEL), to_vector3r((1, 6, 8)), False, False)
        == "wall"
    )
    assert client("simGetObjectPose", "wall", True)["position"] == pytest.approx(to_vector3r((5.0, 0.0, -2.0)))
    a, b = to_geo_point((0, 0, -2)), to_geo_point((9, 0, -2))
    assert client("simTestLineOfSightBetweenPoints", a, b) is False
    client("takeoff", 20.0, "")
    client("moveToPosition", 9.0, 0.0, -2.0, 2.0, 8.0, 0, STILL, -1.0, 1.0, "")
    hit = client("simGetCollisionInfo", "")
    assert hit["has_collided"] and hit["object_name"] == "wall" and hit["time_stamp"] > 1_600_000_000_000_000_000
    assert hit["normal"]["x_val"] == pytest.approx(-1.0) and hit["impact_point"]["x_val"] == pytest.approx(
        4.5, abs=0.05
    )
    assert client("simDestroyObject", "wall") and client("simTestLineOfSightBetweenPoints", a, b) is True
    assert client("simGetCollisionInfo", "")["object_name"] == ""
    assert math.isnan(client("simGetObjectPose", "wall", True)["position"]["x_val"])


@pytest.mark.parametrize(
    ("name", "arguments", "text"),
    [
        ("simFly", (), "could not find function 'simFly'"),
        ("moveByVelocity", (1.0,), "moveByVelocity: 1 arguments; allowed: vx, vy, vz"),
        ("hover", ("Drone2",), "hover: vehicle 'Drone2': not known; allowed: SimpleFlight"),
        ("simSetWeatherParameter", (0, 1.0), r"0 \(Rain\): not drawn; allowed: 7 \(Fog\)"),
        ("simGetImage", ("periscope", 0, ""), "camera 'periscope': not known; allowed: 0, 1"),
        ("moveToPosition", (math.nan, 0.0, 0.0, 1.0, 9.0, 0, STILL, -1, 1, ""), "allowed: finite points"),
    ],
)
def test_what_cannot_be_is_answered_with_an_error_that_names_it(flying, name, arguments, text):
    with pytest.raises(RuntimeError, match=text):
        flying(name, *arguments)


CALLS_OF_A_METHOD = {
    "confirmConnection": ("ping", "getServerVersion", "getMinRequiredClientVersion"),
    "getClientVersion": (),
    "getPitchRollYaw": ("getOrientation",),
}
"""Methods of the client that are no calls of the server."""


def test_the_page_counts_what_public_programs_use_and_what_of_it_is_served():
    with Path(__file__).with_name("survey.csv").open(encoding="utf-8", newline="") as file:
        pairs = list(csv.DictReader(file))
    page = (ROOT / "docs" / "how-to" / "airsim.md").read_text(encoding="utf-8")
    refused = set()
    for read in ("before", "after"):
        methods = [pair["call"] for pair in pairs if pair["read"] == read]
        unserved = {
            method
            for method in methods
            if not all(call in CALLS and call not in REFUSED for call in CALLS_OF_A_METHOD.get(method, (method,)))
        }
        served = sum(method not in unserved for method in methods)
        assert f"{served} of {len(methods)} ({percent(served / len(methods))})" in page
        refused |= unserved
    assert f"Not served: {', '.join(f'`{method}`' for method in sorted(refused))}." in page
