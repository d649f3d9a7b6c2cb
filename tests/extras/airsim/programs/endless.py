"""Never ends: argument `sleep` (simulated time passes), `pause` (only wall-clock time passes), `event`, `input`."""

import signal
import sys
import threading
import time

import airsim

client = airsim.MultirotorClient()
client.ping()
while True:
    if sys.argv[1] == "sleep":
        time.sleep(1.0)
    if sys.argv[1] == "pause":
        signal.pause()
    if sys.argv[1] == "event":
        threading.Thread(target=threading.Lock().acquire, daemon=True).start()
        threading.Event().wait()
    if sys.argv[1] == "input":
        input("more? ")
