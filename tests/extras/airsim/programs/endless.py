"""Never ends: argument `sleep` (simulated time passes), `pipe` (only wall-clock time passes), `event`, `input`."""

import os
import sys
import threading
import time

import airsim

client = airsim.MultirotorClient()
client.ping()
while True:
    if sys.argv[1] == "sleep":
        time.sleep(1.0)
    if sys.argv[1] == "pipe":
        os.read(os.pipe()[0], 1)
    if sys.argv[1] == "event":
        threading.Thread(target=threading.Lock().acquire, daemon=True).start()
        threading.Event().wait()
    if sys.argv[1] == "input":
        input("more? ")
