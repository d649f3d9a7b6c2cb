"""Faults: what they are, how they are drawn, and how they are injected."""
