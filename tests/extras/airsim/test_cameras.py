"""Calls about lenses and detections, and names before AirSim 1.3."""

import math

import numpy as np
import pytest

from mavfi.extras.airsim.frames import LEVEL, pose, rotation, vector
from tests.extras.airsim.test_calls import Client

CAMERA, SEGMENTATION = "0", 5


@pytest.fixture
def client():
    return Client(image="64x48")


def fov(client):
    return client("simGetCameraInfo", CAMERA)["fov"]


# ---- lenses ----------------------------------------------------------------------------------------------------------
def test_the_focal_length_sets_the_field_of_view(client):
    assert client("simGetFocalLength", CAMERA) == pytest.approx(23.76 / 2) and fov(client) == 90.0
    client("simSetFocalLength", 23.76, CAMERA)
    assert fov(client) == pytest.approx(math.degrees(2 * math.atan(0.5))) == pytest.approx(53.13, abs=0.01)
    assert client("simGetFocalLength", CAMERA) == pytest.approx(23.76)
    other = Client(image="64x48")
    other("simSetCameraFov", CAMERA, fov(client))
    assert client("simGetImage", CAMERA, 1) == other("simGetImage", CAMERA, 1)


def test_a_smaller_film_narrows_the_field_of_view(client):
    assert client("simSetFilmbackSettings", 11.88, 5.94, CAMERA) == 2.0
    assert client("simGetFocalLength", CAMERA) == pytest.approx(11.88), "the focal length stays"
    assert fov(client) == pytest.approx(53.13, abs=0.01)
    assert "Sensor Width: 11.88; \t Sensor Height: 5.94" in client("simGetFilmbackSettings", CAMERA)
    assert "Horizontal Field Of View: 53.13" in client("simGetCurrentFieldOfView", CAMERA)
    assert "Vertical Field Of View: 28.07" in client("simGetCurrentFieldOfView", CAMERA)
    client("simSetPresetFilmbackSettings", "16:9 Digital Film", CAMERA)
    assert fov(client) == pytest.approx(90.0)


def test_focus_is_kept_and_changes_no_picture(client):
    before = client("simGetImage", CAMERA, 0)
    client("simEnableManualFocus", True, CAMERA)
    client("simSetFocusDistance", 300.0, CAMERA)
    client("simSetFocusAperture", 1.4, CAMERA)
    client("simEnableFocusPlane", True, CAMERA)
    assert client("simGetFocusDistance", CAMERA) == 300.0 and client("simGetFocusAperture", CAMERA) == 1.4
    assert client("simGetImage", CAMERA, 0) == before
    assert client("simGetDistortionParams", CAMERA) == [0.0] * 5


def test_presets_are_those_that_can_be_set(client):
    (lens,), (film,) = client("simGetPresetLensSettings", CAMERA), client("simGetPresetFilmbackSettings", CAMERA)
    assert lens == client("simGetLensSettings", CAMERA) and film == client("simGetFilmbackSettings", CAMERA)
    client("simSetPresetLensSettings", lens.removeprefix("Name: "), CAMERA)


@pytest.mark.parametrize(
    ("name", "given", "allowed"),
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
def test_what_no_pinhole_can_be_is_refused(client, name, given, allowed):
    with pytest.raises(RuntimeError, match=allowed):
        client(name, *given, CAMERA)
    assert fov(client) == 90.0


# ---- detections ------------------------------------------------------------------------------------------------------
@pytest.fixture
def seeing(client):
    """A cube of 2 m, 10 m ahead and 3 m above the start, and a camera that looks at it."""
    client("simSetVehiclePose", pose((0.0, 0.0, -30.0), LEVEL), True)
    client("simSpawnObject", "cube_a", "Cube", pose((10.0, 0.0, -30.0), LEVEL), vector((2.0, 2.0, 2.0)))
    return client


def found(client):
    return client("simGetDetections", CAMERA, SEGMENTATION)


def test_an_object_with_a_wanted_name_is_detected(seeing):
    assert found(seeing) == [], "nothing is wanted yet"
    seeing("simAddDetectionFilterMeshName", CAMERA, SEGMENTATION, "cube*")
    (cube,) = found(seeing)
    assert cube["name"] == "cube_a"
    near, far = cube["box3D"]["min"], cube["box3D"]["max"]
    assert [near["x_val"], far["x_val"]] == pytest.approx([9.0, 11.0], abs=1e-6)
    assert [near["y_val"], far["y_val"], near["z_val"], far["z_val"]] == pytest.approx([-1, 1, -1, 1], abs=1e-6)
    at = cube["relative_pose"]["position"]
    assert [at["x_val"], at["y_val"], at["z_val"]] == pytest.approx([10.0, 0.0, 0.0], abs=1e-6)
    assert cube["geo_point"]["latitude"] > seeing("getHomeGeoPoint")["latitude"]


def test_the_box_in_the_picture_is_that_of_its_pixels(seeing):
    seeing("simAddDetectionFilterMeshName", CAMERA, SEGMENTATION, "cube_a")
    request = {"camera_name": CAMERA, "image_type": SEGMENTATION, "pixels_as_float": False, "compress": False}
    (image,) = seeing("simGetImages", [request])
    pixels = np.frombuffer(image["image_data_uint8"], np.uint8).reshape(48, 64, 3)
    rows, columns = np.nonzero((pixels == pixels[24, 32]).all(axis=2))
    (cube,) = found(seeing)
    box = [cube["box2D"][end][axis] for end in ("min", "max") for axis in ("x_val", "y_val")]
    assert box == [columns.min(), rows.min(), columns.max(), rows.max()]
    expected = 32 / 9  # half of the picture is 45 deg: pixels of 1 m at 9 m
    assert [box[0], box[2]] == pytest.approx([32 - expected, 31 + expected], abs=1.0)


def test_the_radius_the_name_and_the_direction_decide(seeing):
    seeing("simAddDetectionFilterMeshName", CAMERA, SEGMENTATION, "cube_a")
    seeing("simSetDetectionFilterRadius", CAMERA, SEGMENTATION, 999.0)
    assert found(seeing) == [], "its centre is 10 m away"
    seeing("simSetDetectionFilterRadius", CAMERA, SEGMENTATION, 1001.0)
    assert len(found(seeing)) == 1
    assert seeing("simGetDetections", CAMERA, 0) == [], "names are those of a camera and a kind of image"
    seeing("simClearDetectionMeshNames", CAMERA, SEGMENTATION)
    assert found(seeing) == []
    seeing("simAddDetectionFilterMeshName", CAMERA, SEGMENTATION, "Cube_A")
    assert found(seeing) == []
    seeing("simAddDetectionFilterMeshName", "back_center", SEGMENTATION, "cube_a")
    assert seeing("simGetDetections", "back_center", SEGMENTATION) == []
    with pytest.raises(RuntimeError, match="0 or more"):
        seeing("simSetDetectionFilterRadius", CAMERA, SEGMENTATION, -1.0)


def test_the_pose_is_relative_to_a_camera_that_is_turned(seeing):
    half = math.radians(30.0) / 2
    turned = (math.cos(half), 0.0, 0.0, math.sin(half))  # 30 deg to the right
    seeing("simSetCameraPose", CAMERA, pose((0.0, 0.0, 0.0), turned))
    seeing("simAddDetectionFilterMeshName", CAMERA, SEGMENTATION, "cube_a")
    (cube,) = found(seeing)
    at = cube["relative_pose"]["position"]
    angle = math.radians(30.0)
    assert [at["x_val"], at["y_val"]] == pytest.approx([10 * math.cos(angle), -10 * math.sin(angle)], abs=1e-6)
    own = cube["relative_pose"]["orientation"]
    assert [own["w_val"], own["z_val"]] == pytest.approx([math.cos(half), -math.sin(half)])


# ---- names before AirSim 1.3 -----------------------------------------------------------------------------------------
def test_older_names_return_what_newer_ones_do():
    client = Client().ready()
    client("takeoff", 20.0, "")
    client("simPause", True)
    state = client("getMultirotorState")["kinematics_estimated"]
    assert client("getPosition") == state["position"] and client("getVelocity") == state["linear_velocity"]
    assert client("getOrientation") == state["orientation"]
    assert client("getCollisionInfo") == client("simGetCollisionInfo")


def test_an_angle_is_flown_by_both_names():
    old, new = Client().ready(), Client().ready()
    for client, name in ((old, "moveByAngle"), (new, "moveByAngleZ")):
        client("takeoff", 20.0, "")
        client(name, -0.1, 0.05, -3.0, 0.2, 1.0)
    assert old.at.tolist() == new.at.tolist()


def test_an_orientation_turns_a_camera_that_stays_where_it_is(client):
    half = math.radians(90.0) / 2
    turned = (math.cos(half), 0.0, math.sin(half), 0.0)
    client("simPause", True)
    client("simSetCameraPose", CAMERA, pose((0.5, 0.0, 0.0), LEVEL))
    before = client("simGetCameraInfo", CAMERA)["pose"]["position"]
    client("simSetCameraOrientation", CAMERA, rotation(turned))
    after = client("simGetCameraInfo", CAMERA)["pose"]
    assert after["position"] == before and after["orientation"]["y_val"] == pytest.approx(math.sin(half), abs=1e-3)
    with pytest.raises(RuntimeError, match="other than zero"):
        client("simSetCameraOrientation", CAMERA, rotation((0.0, 0.0, 0.0, 0.0)))
