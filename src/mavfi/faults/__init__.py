"""Faults: types, draws and injectors for each level."""

DEFAULT_WALK = 16
"""Default of `RegisterFault.walk` with a symbol.

It is longer than the loops at whose few instructions stops occur.  Longer walks spread injections no further, and stop
the target for longer (docs/reference/registers.md).
"""
