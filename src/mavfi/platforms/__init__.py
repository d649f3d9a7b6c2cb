"""Modelled computers: latencies charged as simulated time."""
