"""Flies lanes over a field, facing forward, and takes a depth image at the end of each.

Arguments: width (m), number of lanes.
"""

import sys

import airsim

width = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
lanes = int(sys.argv[2]) if len(sys.argv) > 2 else 3
HEIGHT, SPEED, APART = -8.0, 4.0, 4.0

client = airsim.MultirotorClient()
client.confirmConnection()
client.enableApiControl(True)
client.armDisarm(True)
client.takeoffAsync().join()
client.moveToZAsync(HEIGHT, 2.0).join()
for lane in range(lanes):
    ends = (0.0, width) if lane % 2 == 0 else (width, 0.0)
    path = [airsim.Vector3r(x, APART * lane, HEIGHT) for x in ends]
    mode = airsim.YawMode(False, 0)
    client.moveOnPathAsync(path, SPEED, 60, airsim.DrivetrainType.ForwardOnly, mode, 4, 1).join()
    depth = client.simGetImages([airsim.ImageRequest("0", airsim.ImageType.DepthPlanar, True, False)])[0]
    print(f"lane {lane}: nearest {min(depth.image_data_float):.3f} m")
client.goHomeAsync().join()
client.landAsync().join()
client.armDisarm(False)
client.enableApiControl(False)
