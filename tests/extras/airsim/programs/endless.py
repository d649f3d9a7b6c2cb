"""Never ends: argument `sleep` (simulated time passes) or `spin` (only wall-clock time passes)."""

import sys
import time

import airsim

client = airsim.MultirotorClient()
client.ping()
while True:
    if sys.argv[1] == "sleep":
        time.sleep(1.0)
