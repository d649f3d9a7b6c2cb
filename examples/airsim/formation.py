"""Two vehicles fly one behind the other; a camera of settings.json, formation.json, looks back."""

import airsim

client = airsim.MultirotorClient()
client.confirmConnection()
names = client.listVehicles()
for name in names:
    client.enableApiControl(True, name)
    client.armDisarm(True, name)
for task in [client.takeoffAsync(vehicle_name=name) for name in names]:
    task.join()

# targets are relative to each vehicle's own start, so that both keep their distance
for task in [client.moveToPositionAsync(8, 0, -3, 2, vehicle_name=name) for name in names]:
    task.join()
distance = client.simGetObjectPose(names[0]).position.distance_to(client.simGetObjectPose(names[1]).position)
client.simAddDetectionFilterMeshName("rear", airsim.ImageType.Scene, "Wing", "Leader")
seen = [detection.name for detection in client.simGetDetections("rear", airsim.ImageType.Scene, "Leader")]
print(f"{distance:.1f} m apart, the leader sees {seen}")
