"""A MAVLink link with faults, between a program and the autopilot that it flies."""
