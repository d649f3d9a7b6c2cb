"""Flips a bit in a register of a running process (x86-64 Linux), as the paper's injector does by system calls.

`inject` is the way in.  Nothing of mavfi needs to run in the target, and the target need not be a robot.
"""

from mavfi.faults.register.front import inject

__all__ = ["inject"]
