"""Flips a bit in a register of a running process (x86-64 Linux) by system calls, as the paper's injector does.

`inject` is the entry point.  The target need not run any part of mavfi, nor be a robot.
"""

from mavfi.extras.registers.front import inject

__all__ = ["inject"]
