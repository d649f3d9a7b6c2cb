"""settings.json: cameras by vehicle and by default; what is refused, and what has no effect."""

import json
import math

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.airsim.settings import CaptureSize, read_settings
from tests.extras.airsim.test_calls import Client

DEFAULT = CaptureSize(256, 144, 90.0)
SETTINGS = {
    "SettingsVersion": 1.2,
    "SimMode": "Multirotor",
    "SubWindows": [],
    "Wind": {"X": 0.0, "Y": 3.0, "Z": 0.0},
    "CameraDefaults": {"CaptureSettings": [{"ImageType": 0, "Width": 64, "Height": 32, "FOV_Degrees": 60}]},
    "Vehicles": {
        "A": {
            "VehicleType": "SimpleFlight",
            "Cameras": {
                "high": {
                    "CaptureSettings": [{"Width": 40}, {"ImageType": 2, "Width": 20, "Height": 10, "TargetGamma": 1}],
                    "X": 0.5,
                    "Z": -0.1,
                    "Pitch": -90,
                    "Yaw": math.nan,
                }
            },
        },
        "B": {"VehicleType": "SimpleFlight", "X": 3.0, "Cameras": {"front_center": {"Yaw": 180}}},
        "C": {"VehicleType": "SimpleFlight", "AutoCreate": False},
    },
}


def written(tmp_path, content):
    path = tmp_path / "settings.json"
    text = content
    if not isinstance(content, str):
        text = json.dumps(content)
    path.write_text(text, encoding="utf-8-sig")
    return path


def test_cameras_have_their_own_size_view_and_place(tmp_path):
    client = Client(settings=str(written(tmp_path, SETTINGS)))
    request = {"camera_name": "high", "image_type": 0, "pixels_as_float": False, "compress": False}
    (scene,) = client("simGetImages", [request], "A")
    (depth,) = client("simGetImages", [{**request, "image_type": 2, "pixels_as_float": True}], "A")
    assert [(image["width"], image["height"]) for image in (scene, depth)] == [(40, 32), (20, 10)]
    assert client("simGetCameraInfo", "high", "A")["fov"] == 60.0
    assert scene["camera_position"] == pytest.approx({"x_val": 0.5, "y_val": 0.0, "z_val": -0.1}, abs=0.1)
    assert np.median(depth["image_data_float"]) == pytest.approx(0.45, abs=0.3), "it looks at the ground"
    with pytest.raises(RuntimeError, match="camera 'high': not known; allowed: 0, .*; more by --settings"):
        client("simGetCameraInfo", "high", "B")

    # cameras of AirSim begin with the defaults, and may be placed by name
    assert client("simGetCameraInfo", "1", "A")["fov"] == 60.0
    turned = client("simGetCameraInfo", "0", "B")["pose"]["orientation"]
    ahead = client("simGetVehiclePose", "B")["orientation"]
    assert abs(turned["w_val"] * ahead["w_val"] + turned["z_val"] * ahead["z_val"]) < 1e-6

    client("simSetCameraFov", "high", 100.0, "A")
    assert client("simGetCameraInfo", "high", "A")["fov"] == 100.0
    assert client("listVehicles") == ["A", "B"]
    assert json.loads(client("getSettingsString"))["Vehicles"]["B"]["X"] == 3.0
    client("enableApiControl", True, "A")
    client("takeoff", 20.0, "A")
    client.sleep(3.0)
    assert client("getMultirotorState", "A")["kinematics_estimated"]["linear_velocity"]["y_val"] != 0.0


def test_keys_without_effect_are_named(tmp_path):
    settings = read_settings(written(tmp_path, SETTINGS), DEFAULT)
    assert settings.unused == ("Vehicles.A.Cameras.high.CaptureSettings.1.TargetGamma", "SubWindows")
    assert settings.wind == (0.0, 3.0, 0.0)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("{", "is no JSON"),
        ([], "the file: []: allowed: an object"),
        ({"SimMode": "Car"}, "SimMode: 'Car': allowed: Multirotor"),
        (
            {"Vehicles": {"A": {"VehicleType": "PX4Multirotor"}}},
            "Vehicles.A.VehicleType: 'PX4Multirotor': allowed: SimpleFlight",
        ),
        (
            {"CameraDefaults": {"CaptureSettings": [{"Width": 9000}]}},
            "CameraDefaults.CaptureSettings.0.Width: 9000: allowed: 2 to 4096",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, content, text):
    with pytest.raises(BadInputError) as refused:
        read_settings(written(tmp_path, content), DEFAULT)
    assert f"settings.json: {text}" in str(refused.value) and "\n" not in str(refused.value)
