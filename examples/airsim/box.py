"""Flies a square in front of the start, and lands."""

import airsim

SIDE, HEIGHT, SPEED = 8.0, -4.0, 3.0

client = airsim.MultirotorClient()
client.confirmConnection()
client.enableApiControl(True)
client.armDisarm(True)
client.takeoffAsync().join()
client.moveToZAsync(HEIGHT, 1.5).join()
for x, y in ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0)):
    client.moveToPositionAsync(x, y, HEIGHT, SPEED).join()
    at = client.simGetVehiclePose().position
    print(f"at {at.x_val:.2f} {at.y_val:.2f} {at.z_val:.2f}")
client.landAsync().join()
client.armDisarm(False)
print("collided" if client.simGetCollisionInfo().has_collided else "no collision")
