"""Hosts compose simulator, pipeline, faults and detectors into a flight."""
