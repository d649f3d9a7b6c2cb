"""Ends with an exception after its first calls."""

import airsim

client = airsim.MultirotorClient()
client.ping()
raise ValueError("the program's own error")
