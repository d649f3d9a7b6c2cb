"""Hosts: each composes simulator, pipeline, faults and detectors into flights."""
