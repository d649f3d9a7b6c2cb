"""Every method of the client has an effect that can be observed, or is refused in one line that says why."""

import inspect
from typing import NamedTuple

import pytest

from mavfi.extras.airsim.frames import LEVEL, to_pose, to_vector3r
from mavfi.extras.airsim.scene import REFUSED, WITHOUT_EFFECT
from tests.core.architecture.source import ROOT
from tests.extras.airsim.test_calls import STILL, Client

airsim = pytest.importorskip("cosysairsim", reason="needs the package cosysairsim (extra dev)")
msgpack = pytest.importorskip("msgpack")

METHODS = [name for name, _ in inspect.getmembers(airsim.MultirotorClient, callable) if not name.startswith("_")]
ASKING = ("get", "is", "list", "ping", "confirm", "simGet", "simIs", "simList", "simTest")
"""Beginnings of the names of methods that return something."""
POSE = airsim.Pose(airsim.Vector3r(3.0, 1.0, -5.0), airsim.Quaternionr(0.0, 0.0, 0.0, 1.0))
HOME = airsim.GeoPoint()
HOME.latitude, HOME.longitude, HOME.altitude = 47.641468, -122.140165, 125.0
STANDING = airsim.KinematicsState()
STANDING.position, STANDING.orientation = POSE.position, POSE.orientation
STANDING.linear_velocity = STANDING.angular_velocity = airsim.Vector3r()
VALUES = {
    "arm": False,
    "asset_name": "Cube",
    "camera_name": "0",
    "enable": True,
    "fov_degrees": 50.0,
    "ignore_collision": True,
    "image_type": 0,
    "is_enabled": False,
    "is_paused": True,
    "level_name": "farm",
    "mesh_name": "cube",
    "name_regex": ".*",
    "object_id": 77,
    "object_name": "cube",
    "param": 7,
    "path": [airsim.Vector3r(3.0, 0.0, -3.0)],
    "point": HOME,
    "point1": HOME,
    "point2": HOME,
    "pose": POSE,
    "preset_filmback_settings": "16:9 Digital Film",
    "preset_lens_settings": "50mm",
    "radius_cm": 100.0,
    "rcdata": airsim.RCData(throttle=0.9, pitch=0.5),
    "requests": [airsim.ImageRequest("0", 0, False, False)],
    "scale": airsim.Vector3r(2.0, 2.0, 2.0),
    "scale_vector": airsim.Vector3r(3.0, 3.0, 3.0),
    "state": STANDING,
    "val": 0.9,
    "vehicle_name": "",
    "vehicle_type": "SimpleFlight",
    "velocity_gains": airsim.VelocityControllerGains(),
    "z": -3.0,
    "wind": airsim.Vector3r(0.0, 4.0, 0.0),
}
"""Arguments by name; others are numbers or texts that do not matter."""
VALUES_OF = {
    "moveToGPSAsync": {"latitude": 47.641468, "longitude": -122.140165, "altitude": 126.0},
    "simAddDetectionFilterMeshName": {"mesh_name": "box_*"},
    "simEnableWeather": {"enable": False},
    "simSetDistortionParams": {"distortion_params": {"K1": 0.1}},
    "simAddVehicle": {"vehicle_name": "Second"},
    "simPlotStrings": {"strings": ["text"]},
    "simSpawnObject": {"object_name": "new"},
}
"""Those of single methods."""
CLIENTS_OWN = ("getClientVersion", "getMinRequiredServerVersion", "simGetSegmentationColorMap", "simIsValidColor")
"""Methods without a call."""
ONLY_THIS_VALUE = ("simSetPresetLensSettings",)
"""Calls that accept one value, which changes nothing, and refuse others by what is allowed."""
AT_REST = ("takeoffAsync",)
"""Methods that a flying vehicle refuses."""
PAGE = (ROOT / "docs" / "how-to" / "airsim.md").read_text(encoding="utf-8")


class Wire:
    """What the client's methods call, in this process."""

    def __init__(self, client):
        self.client = client
        self.called = []

    def call(self, name, *values):
        self.called.append(name)
        return self.client(name, *msgpack.unpackb(msgpack.packb(values, default=lambda value: value.to_msgpack())))

    def call_async(self, name, *values):
        return self.call(name, *values)


def fresh():
    return Client(image="32x24").ready()


def flying():
    """A flying vehicle with a task, a cube to see, and settings that differ from the defaults."""
    client = fresh()
    client("simSetVehiclePose", to_pose((0.0, 0.0, -2.0), LEVEL), True)
    client("simSpawnObject", "cube", "Cube", to_pose((6.0, 0.0, -2.0), LEVEL), to_vector3r((1.0, 1.0, 1.0)))
    client("simAddDetectionFilterMeshName", "0", 0, "cube")
    client("simEnableWeather", True)
    client("simSetFilmbackSettings", 20.0, 10.0, "0")
    client("simSetWeatherParameter", 7, 0.2)
    client("startRecording")
    client.post("moveByVelocity", 0.5, 0.0, 0.0, 60.0, 0, STILL, "")
    return client


def observed(client):
    """What a program can observe, now and a second later."""
    readings = [
        client(name, "0", "")
        for name in ("simGetCameraInfo", "simGetFilmbackSettings", "simGetFocusDistance", "simGetFocusAperture")
    ]
    for name in ("isRecording", "simIsPaused", "isApiControlEnabled", "listVehicles", "simListSceneObjects"):
        readings.append(client(name))
    readings.append(client("simGetSegmentationObjectID", "cube"))
    readings.append([client(name, "cube") for name in ("simGetObjectPose",)])
    if "cube" in client.server.api.scene.objects:
        readings.append(client("simGetObjectScale", "cube"))
    readings.append(client("simGetDetections", "0", 0))
    readings.append(client("simGetImage", "0", 0))
    client.sleep(1.0)
    readings.append(client("getMultirotorState"))
    return repr(readings)


class Outcome(NamedTuple):
    """What a method does: its calls, its result, why it is refused ("" = it is not), and what is seen afterwards."""

    called: list
    result: object
    refusal: str
    seen: str


def outcome_of(make, method):
    """Call a method of the client with a server in the state that `make` returns."""
    client = make()
    caller = airsim.MultirotorClient.__new__(airsim.MultirotorClient)
    caller.client = Wire(client)
    function = getattr(caller, method)
    values = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.default is inspect.Parameter.empty or name in VALUES:
            values[name] = {**VALUES, **VALUES_OF.get(method, {})}.get(name, 1.0)
    try:
        result = function(**values)
    except RuntimeError as error:
        return Outcome(caller.client.called, None, str(error), "")
    return Outcome(caller.client.called, result, "", observed(client))


@pytest.fixture(scope="module")
def undisturbed():
    """What is seen without a call that has an effect."""
    return {make: outcome_of(make, "ping").seen for make in (flying, fresh)}


@pytest.mark.parametrize("name", METHODS)
def test_no_method_is_accepted_silently(name, undisturbed):
    make = flying
    if name in AT_REST:
        make = fresh
    outcome = outcome_of(make, name)
    if name in CLIENTS_OWN:
        assert not outcome.called
        return
    call = outcome.called[-1]
    if name in ONLY_THIS_VALUE:
        assert outcome.refusal == f"{call}: '50mm': allowed: 'Pinhole'"
    elif outcome.refusal:
        assert outcome.refusal == f"{call}: {REFUSED.get(call)}" and "\n" not in outcome.refusal
    elif name.startswith(ASKING):
        assert outcome.result is not None or name == "confirmConnection"
    elif call in WITHOUT_EFFECT:
        assert outcome.seen == undisturbed[flying] and f"`{call}`" in PAGE
    else:
        is_seen = outcome.seen != undisturbed[flying] or outcome_of(fresh, name).seen != undisturbed[fresh]
        assert is_seen, f"{call} is accepted and changes nothing"
