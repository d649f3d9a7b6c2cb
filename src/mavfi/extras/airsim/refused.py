"""Calls of AirSim's API that are refused by name, each with the reason."""

from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.airsim.table import Api, call

_GAINS = "gains are those of the vehicle's file (--vehicle)"
_PAINT = "objects have no material, texture or light"
_STRAIGHT = "pictures have no distortion"
_SENSOR = "this sensor does not exist here"
_ONE_PLACE = "the sensor sits at the vehicle's centre"
_OF_COSYS = "annotations and instances are not drawn; simGetImages returns segmentation"

REFUSED = {
    "simAddVehicle": "one vehicle flies here",
    "simSetExtForce": "external forces are not applied; wind is (simSetWind)",
    "simRunConsoleCommand": "there is no Unreal Engine here",
    "simCreateVoxelGrid": "no file is written",
    "simGetMeshPositionVertexBuffers": "obstacles have no mesh; simGetObjectPose and simGetObjectScale give the boxes",
    **dict.fromkeys(("setCarControls", "getCarState", "getCarControls"), "the vehicle is a multirotor"),
    "getComputerVisionState": "the vehicle is a multirotor",
    **dict.fromkeys(
        ("setVelocityControllerGains", "setPositionControllerGains", "setAngleLevelControllerGains",
         "setAngleRateControllerGains"),
        _GAINS,
    ),
    **dict.fromkeys(
        ("simSetObjectMaterial", "simSetObjectMaterialFromTexture", "simSwapTextures", "simSetLightIntensity",
         "simSetVehicleLightIntensity", "simSetVehicleLightVisibility", "simSetWorldLightIntensity",
         "simSetWorldLightVisibility"),
        _PAINT,
    ),
    **dict.fromkeys(("simSetDistortionParam", "simSetDistortionParams"), _STRAIGHT),
    **dict.fromkeys(
        ("getEchoData", "getGPULidarData", "getUWBData", "getUWBSensorData", "getWifiData", "getWifiSensorData"),
        _SENSOR,
    ),
    **dict.fromkeys(
        ("simSetDistanceSensorPose", "simSetLidarPose", "simSetGPULidarPose", "simSetEchoPose"), _ONE_PLACE
    ),
    **dict.fromkeys(
        ("simListAnnotationObjects", "simListAnnotationPoses", "simListInstanceSegmentationObjects",
         "simListInstanceSegmentationPoses", "simListSceneObjectsTags", "simGetAnnotationObjectID",
         "simSetAnnotationObjectID", "simGetAnnotationObjectColor", "simSetAnnotationObjectColor",
         "simGetAnnotationObjectValue", "simSetAnnotationObjectValue", "simGetAnnotationObjectTexturePath",
         "simSetAnnotationObjectTextureByPath", "simEnableAnnotationObjectTextureByPath"),
        _OF_COSYS,
    ),
    **dict.fromkeys(
        ("simGetPhysicsRawKinematics", "simSetPhysicsRawKinematics"),
        "raw states are not exchanged; simGetGroundTruthKinematics and simSetKinematics are",
    ),
}  # fmt: skip
"""The reason by name of the call."""


def _refuse(name: str, reason: str) -> None:
    def refused(api: Api, *arguments: Any) -> None:
        raise BadInputError(f"{name}: {reason}")

    call(name)(refused)


for _name, _reason in REFUSED.items():
    _refuse(_name, _reason)
