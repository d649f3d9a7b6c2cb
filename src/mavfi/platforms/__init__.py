"""Modelled computers: latencies that are charged as simulated time."""
