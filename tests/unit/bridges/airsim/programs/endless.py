"""Never ends by itself: argument `sleep` (its time passes) or `spin` (only the wall's does)."""

import sys
import time

import airsim

client = airsim.MultirotorClient()
client.ping()
while True:
    if sys.argv[1] == "sleep":
        time.sleep(1.0)
