"""Fault injection, anomaly detection and recovery for autonomous UAVs, measured on whole missions.

A flight is a pure function of a scenario, a fault and a detector; a campaign is many flights, paired by seed.
"""

__version__ = "0.1.0"
