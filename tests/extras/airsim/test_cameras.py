"""Calls about lenses and detections, and names before AirSim 1.3."""

import math

import pytest

from mavfi.extras.airsim.frames import LEVEL, to_pose, to_vector3r
from tests.extras.airsim.test_calls import Client

CAMERA, SEGMENTATION = "0", 5


@pytest.fixture
def client():
    return Client(image="64x48")


def fov(client):
    return client("simGetCameraInfo", CAMERA)["fov"]


@pytest.mark.parametrize(
    ("name", "arguments", "allowed"),
    [
        ("simSetFocalLength", (0.0,), "above 0"),
        ("simSetFocalLength", (math.nan,), "above 0"),
        ("simSetFocalLength", (1e9,), "1 to 170 deg"),
        ("simSetFilmbackSettings", (1e6, 1.0), "1 to 170 deg"),
        ("simSetFilmbackSettings", (10.0, -1.0), "above 0"),
        ("simSetPresetLensSettings", ("50mm",), "Pinhole"),
        ("simSetPresetFilmbackSettings", ("IMAX",), "16:9 Digital Film"),
    ],
)
def test_what_no_pinhole_can_be_is_refused(client, name, arguments, allowed):
    with pytest.raises(RuntimeError, match=allowed):
        client(name, *arguments, CAMERA)
    assert fov(client) == 90.0


# ---- detections ------------------------------------------------------------------------------------------------------
@pytest.fixture
def seeing(client):
    """A cube of 2 m, 10 m ahead and 3 m above the start, and a camera that looks at it."""
    client("simSetVehiclePose", to_pose((0.0, 0.0, -30.0), LEVEL), True)
    client("simSpawnObject", "cube_a", "Cube", to_pose((10.0, 0.0, -30.0), LEVEL), to_vector3r((2.0, 2.0, 2.0)))
    return client


def detections(client):
    return client("simGetDetections", CAMERA, SEGMENTATION)


def test_an_object_with_a_wanted_name_is_detected(seeing):
    assert detections(seeing) == [], "nothing is wanted yet"
    seeing("simAddDetectionFilterMeshName", CAMERA, SEGMENTATION, "cube*")
    (cube,) = detections(seeing)
    assert cube["name"] == "cube_a"
    near, far = cube["box3D"]["min"], cube["box3D"]["max"]
    assert [near["x_val"], far["x_val"]] == pytest.approx([9.0, 11.0], abs=1e-6)
    assert [near["y_val"], far["y_val"], near["z_val"], far["z_val"]] == pytest.approx([-1, 1, -1, 1], abs=1e-6)
    at = cube["relative_pose"]["position"]
    assert [at["x_val"], at["y_val"], at["z_val"]] == pytest.approx([10.0, 0.0, 0.0], abs=1e-6)
    assert cube["geo_point"]["latitude"] > seeing("getHomeGeoPoint")["latitude"]


# ---- names before AirSim 1.3 -----------------------------------------------------------------------------------------
def test_older_names_return_what_newer_ones_do():
    client = Client().ready()
    client("takeoff", 20.0, "")
    client("simPause", True)
    state = client("getMultirotorState")["kinematics_estimated"]
    assert client("getPosition") == state["position"] and client("getVelocity") == state["linear_velocity"]
    assert client("getOrientation") == state["orientation"]
    assert client("getCollisionInfo") == client("simGetCollisionInfo")
