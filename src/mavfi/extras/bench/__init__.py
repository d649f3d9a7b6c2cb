"""Detectors and recovery schemes compared on the same flights and faults, and what they are compared with.

Reference detectors: learned limits of all fields (`limits`), checksums, repeated steps, and bounds (`oracle`,
`random`).
"""
