"""Recorded flights: readers and writers of file formats, detectors trained on them; viewers of a running flight."""
