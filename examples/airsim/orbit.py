"""Circles a point, facing it, with a new velocity command every 0.1 s.

Argument: number of circles.
"""

import math
import sys
import time

import airsim

circles = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
RADIUS, SPEED, HEIGHT = 4.0, 2.0, -6.0

client = airsim.MultirotorClient()
client.confirmConnection()
client.enableApiControl(True)
client.armDisarm(True)
client.takeoffAsync().join()
client.moveToZAsync(HEIGHT, 2.0).join()
start = client.simGetVehiclePose().position
centre = start.x_val + RADIUS, start.y_val
begin, count = time.time(), 0
while time.time() - begin < 2.0 * math.pi * circles * RADIUS / SPEED:
    at = client.getMultirotorState().kinematics_estimated.position
    dx, dy = at.x_val - centre[0], at.y_val - centre[1]
    distance = math.hypot(dx, dy) or 1.0
    inward = 0.5 * (distance - RADIUS)
    vx = -SPEED * dy / distance - inward * dx / distance
    vy = SPEED * dx / distance - inward * dy / distance
    facing = airsim.YawMode(False, math.degrees(math.atan2(-dy, -dx)))
    client.moveByVelocityZAsync(vx, vy, HEIGHT, 1.0, airsim.DrivetrainType.MaxDegreeOfFreedom, facing)
    count += 1
    time.sleep(0.1)
print(f"{count} commands")
client.hoverAsync().join()
client.landAsync().join()
