"""Goes through the API with the real client; prints what it saw as one JSON object."""

import hashlib
import json
import time

import numpy as np

import airsim

seen_values = {}
client = airsim.MultirotorClient()
client.confirmConnection()
seen_values["version"] = client.getServerVersion()
client.simPause(True)
depth = client.simGetImages([airsim.ImageRequest("0", airsim.ImageType.DepthPerspective, True, False)])[0]
seen_values["size"] = [depth.width, depth.height]
seen_values["depth"] = hashlib.sha256(np.array(depth.image_data_float, np.float32).tobytes()).hexdigest()
client.simPause(False)
client.enableApiControl(True)
client.armDisarm(True)
seen_values["takeoff"] = client.takeoffAsync().get()
seen_values["state"] = client.getMultirotorState().landed_state
seen_values["position"] = client.moveToPositionAsync(5, 0, -4, 2).get()
path = [airsim.Vector3r(5, 4, -4), airsim.Vector3r(0, 4, -4)]
ahead = airsim.DrivetrainType.ForwardOnly, airsim.YawMode(False, 0)
seen_values["path"] = client.moveOnPathAsync(path, 2, 60, *ahead, 3, 1).get()
at = client.simGetVehiclePose().position
seen_values["at"] = [at.x_val, at.y_val, at.z_val]
seen_values["collided"] = client.simGetCollisionInfo().has_collided
client.hoverAsync().join()
time.sleep(2)
seen_values["imu"] = client.getImuData().linear_acceleration.z_val
points = client.getLidarData().point_cloud
seen_values["lidar"] = len(points)
client.simEnableWeather(True)
client.simSetWeatherParameter(airsim.WeatherParameter.Fog, 0.5)
(scene,) = client.simGetImages([airsim.ImageRequest("0", airsim.ImageType.Scene, False, False)])
seen = [points, client.simGetCameraInfo("0").proj_mat.matrix, scene.image_data_uint8]
seen_values["seen"] = hashlib.sha256(repr(seen).encode()).hexdigest()
begin = time.time()
time.sleep(1.5)
seen_values["slept"] = time.time() - begin
client.simPause(True)
before = client.getMultirotorState().timestamp
client.simContinueForTime(0.5)
seen_values["continued"] = client.getMultirotorState().timestamp - before
seen_values["paused"] = client.simIsPause()
client.simPause(False)
late = client.moveToPositionAsync(50, 0, -4, 1)
client.reset()
seen_values["cancelled"] = late.get()
seen_values["api"] = client.isApiControlEnabled()
try:
    client.takeoffAsync().get()
except Exception as error:
    seen_values["refused"] = str(error)
client.enableApiControl(True)
client.armDisarm(True)
client.takeoffAsync().join()
client.simSpawnObject("wall", "Cube", airsim.Pose(airsim.Vector3r(4, 0, -2)), airsim.Vector3r(1, 6, 6))
client.moveByVelocityAsync(2, 0, 0, 4).join()
seen_values["hit"] = client.simGetCollisionInfo().object_name
print(json.dumps(seen_values))
