"""Recorded flights: readers of file formats, and detectors trained on and applied to them."""
