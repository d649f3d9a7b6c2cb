"""Several vehicles: each with a frame, cameras and state of its own; collisions; faults in one of them."""

import json
import math

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.airsim.boundary import parse_fault
from mavfi.extras.airsim.frames import LEVEL, to_pose, to_vector3r
from tests.extras.airsim.test_calls import STILL, Client

NAN = math.nan
TWO = {"Vehicles": {"Left": {"VehicleType": "SimpleFlight"}, "Right": {"X": 4.0, "Y": 0.0, "Z": -2.0, "Yaw": 180.0}}}


def client_of(settings, tmp_path, **options):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(settings), encoding="utf-8")
    client = Client(settings=str(path), image="32x24", **options)
    for name in client("listVehicles"):
        client("enableApiControl", True, name)
    return client


@pytest.fixture
def two(tmp_path):
    return client_of(TWO, tmp_path)


def both_take_off(client):
    tasks = [client.post("takeoff", 20.0, name) for name in ("Left", "Right")]
    while any(client.answers[task] is None for task in tasks):
        client("mavfiPass", None, True, "")
    return [client.answers[task] for task in tasks]


def place_of(client, name, call="simGetVehiclePose"):
    return [round(value, 1) + 0.0 for value in client(call, name)["position"].values()]


def test_each_has_a_frame_of_its_own_in_that_of_the_scene(two):
    assert place_of(two, "Left") == [0.0, 0.0, 0.0] and place_of(two, "Right") == [0.0, 0.0, 2.0]
    assert place_of(two, "Right", "simGetObjectPose") == [4.0, 0.0, 0.0]
    assert two("simGetVehiclePose", "Right")["orientation"]["z_val"] == pytest.approx(1.0)
    north = [two("getGpsData", "", name)["gnss"]["geo_point"]["latitude"] for name in ("Left", "Right")]
    assert (north[1] - north[0]) * 111_195 == pytest.approx(4.0, abs=0.02)
    noise = [two("getImuData", "", name)["linear_acceleration"] for name in ("Left", "Right")]
    assert noise[0] != noise[1]


def test_tasks_run_at_the_same_time_and_a_target_is_in_the_vehicle_s_own_frame(two):
    assert both_take_off(two) == [(None, True), (None, True)] and two.vehicle.now_us < 5_000_000
    assert two("moveToPosition", 2.0, 3.0, 0.0, 2.0, 20.0, 0, STILL, -1.0, 1.0, "Right") is True
    north, east, _ = place_of(two, "Right", "simGetObjectPose")
    assert (north, east) == (pytest.approx(6.0, abs=0.6), pytest.approx(3.0, abs=0.6))
    assert place_of(two, "Left")[:2] == [0.0, 0.0]


def test_they_see_and_hit_one_another(two):
    both_take_off(two)
    assert two("getDistanceSensorData", "", "Left")["distance"] == pytest.approx(4.0 - 0.35, abs=0.05)
    two("simAddDetectionFilterMeshName", "0", 0, "*ight", "Left")
    (seen,) = two("simGetDetections", "0", 0, "Left")
    assert seen["name"] == "Right" and not two("simGetCollisionInfo", "Left")["has_collided"]
    two.post("moveByVelocityZ", 2.0, 0.0, -2.0, 3.0, 0, STILL, "Left")
    two("moveByVelocityZ", -2.0, 0.0, 0.0, 3.0, 0, STILL, "Right")
    hits = [two("simGetCollisionInfo", name) for name in ("Left", "Right")]
    assert [hit["object_name"] for hit in hits] == ["Right", "Left"]
    assert hits[0]["normal"]["x_val"] < -0.9 and hits[1]["normal"]["x_val"] > 0.9
    gap = place_of(two, "Right", "simGetObjectPose")[0] - place_of(two, "Left", "simGetObjectPose")[0]
    assert gap > 0.5, "they do not pass through one another"


def test_a_vehicle_is_added_while_others_fly(two):
    both_take_off(two)
    two("simSetWind", to_vector3r((0.0, 3.0, 0.0)))
    two("simSpawnObject", "wall", "Cube", to_pose((0.0, 9.0, -2.0), LEVEL), to_vector3r((1.0, 1.0, 1.0)))
    pose = to_pose((NAN, 3.0, 0.0), (NAN,) * 4)
    assert two("simAddVehicle", "New", "SimpleFlight", pose, "") is True
    assert two("listVehicles") == ["Left", "Right", "New"] and place_of(two, "New", "simGetObjectPose") == [0, 3, 0]
    two("enableApiControl", True, "New")
    assert two("takeoff", 20.0, "New") is True and place_of(two, "New")[2] < -1.4
    old, new = (two("getMultirotorState", name)["timestamp"] for name in ("Left", "New"))
    assert new - old == 4_000_000, "there is one time, of which a call takes 4 ms"
    for arguments, text in (
        (("New", "SimpleFlight", to_pose((8.0, 8.0, 0.0), LEVEL)), "allowed: a name that no vehicle has"),
        (("Car", "PhysXCar", to_pose((8.0, 8.0, 0.0), LEVEL)), "'PhysXCar': allowed: SimpleFlight"),
    ):
        with pytest.raises(RuntimeError, match=text):
            two("simAddVehicle", *arguments)
    two("reset")
    assert place_of(two, "New", "simGetObjectPose") == [0.0, 3.0, 0.0]


@pytest.mark.parametrize("vehicle", ["", "Right"])
def test_a_fault_is_in_the_calls_of_one_vehicle(tmp_path, vehicle):
    fault = parse_fault("moveToPosition.x:set=3.0")
    client = client_of(TWO, tmp_path, fault=fault, fault_vehicle=vehicle)
    both_take_off(client)
    for name in ("Left", "Right"):
        client("moveToPosition", 0.0, 1.0, -2.0, 2.0, 5.0, 0, STILL, -1.0, 1.0, name)
    went_north = [place_of(client, name)[0] > 2.0 for name in ("Left", "Right")]
    assert went_north == [vehicle == "", vehicle == "Right"]


def test_a_pose_keeps_what_is_nan(two):
    two("simSetVehiclePose", to_pose((1.0, 2.0, -5.0), (0.0, 0.0, 0.0, 1.0)), True, "Left")
    two("simSetVehiclePose", to_pose((NAN, 7.0, NAN), (NAN,) * 4), True, "Left")
    pose = two("simGetVehiclePose", "Left")
    assert pose["position"] == pytest.approx(to_vector3r((1.0, 7.0, -5.0)), abs=0.1)
    assert pose["orientation"]["z_val"] == pytest.approx(1.0)
    two("simSetCameraPose", "0", to_pose((0.5, 0.0, 0.0), LEVEL), "Left")
    two("simSetCameraPose", "0", to_pose((NAN,) * 3, (0.0, 0.0, 0.0, 1.0)), "Left")
    camera = two.server.api.cameras["front_center"]
    assert (camera.position, camera.orientation) == ((0.5, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_a_vehicle_in_an_obstacle_is_refused_in_one_line(tmp_path):
    world = Client().vehicle.sim.world
    north, west = 0.5 * (world.lower[0] + world.upper[0])[:2] - world.start[:2]
    with pytest.raises(BadInputError, match=r"settings.json: Vehicles.B: start on the ground: an obstacle stands at"):
        client_of({"Vehicles": {"A": {}, "B": {"X": north, "Y": -west}}}, tmp_path)
