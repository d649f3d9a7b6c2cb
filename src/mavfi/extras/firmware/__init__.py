"""The firmware of a real flight controller as the vehicle's controller, in lock-step, and faults in its registers.

The firmware is an unmodified program of its own (Betaflight, GPL-3.0, is never part of mavfi); a small preloaded
library of ours replaces its clock and its sockets.
"""
