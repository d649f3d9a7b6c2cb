"""The planned flip of a bit in a register of a live process."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import Fault

DEFAULT_WALK = 16
"""Default of `RegisterFault.walk` with a symbol.

It is longer than the loops at whose few instructions stops occur.  Longer walks spread injections no further, and stop
the target for longer (docs/reference/registers.md).
"""
REGISTERS = ("all", "general", "fp")
"""Values of `RegisterFault.registers`."""
ACCESSES = ("either", "read", "write")
"""Values of `RegisterFault.access`."""
MAX_WALK = 100_000
"""Largest number of instructions in a walk."""
MAX_TIMEOUT_S = 3600.0
"""Longest wait for an injection."""


@dataclass(frozen=True, slots=True)
class RegisterFault(Fault):
    """One bit of a register that an instruction of a live process reads or writes, once.

    Attributes:
        registers: "general" (including flags), "fp" (XMM and YMM), or "all".
        access: "read": a register that the next instruction reads, injected before it; "write": one that it writes,
            injected after it; or "either".  "" = "either" with a symbol, "read" without.
        symbol: Function at whose next call the target is stopped: its exact name, or a unique part of it.  "" = stop
            at the current instruction.
        thread: Always 0: the busiest thread, or with a symbol the first to call it.
        walk: A random number of instructions below this is single-stepped between stop and injection.  Stops between
            system calls occur at few instructions, always the same (skid); the walk spreads them.  1 = none.
            0 = 16 (`DEFAULT_WALK`) with a symbol, 1 without.
        timeout: Longest wait (s).
        null: Do everything but flip the bit.
        node: ROS node that owns the process; "" = the process is given by its pid.
        time_us: Earliest instant in the flight (us).
        stratum: Always "": not drawn by stratum.
        weight: Always 1.
        seed: Determines all choices but the instant: a free-running process cannot be replayed.

    Raises:
        BadInputError: A value that is not allowed.
    """

    level: ClassVar[Literal["register"]] = "register"
    registers: str = "all"
    access: str = ""
    symbol: str = ""
    thread: int = 0
    walk: int = 0
    timeout: float = 10.0
    null: bool = False
    node: str = ""
    time_us: int = 0
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        # A target that is single-stepped dies with its tracer: no steps unless there is a breakpoint anyway.
        default_access = "read"
        default_walk = 1
        if self.symbol:
            default_access = "either"
            default_walk = DEFAULT_WALK
        object.__setattr__(self, "access", self.access or default_access)
        object.__setattr__(self, "walk", self.walk or default_walk)
        if self.registers not in REGISTERS:
            raise BadInputError(f"registers: {not_known(self.registers, REGISTERS)}")
        if self.access not in ACCESSES:
            raise BadInputError(f"access: {not_known(self.access, ACCESSES)}")
        if not 1 <= self.walk <= MAX_WALK:
            raise BadInputError(f"walk: {self.walk}: allowed: 0 to {MAX_WALK} instructions")
        if not 0.0 < self.timeout <= MAX_TIMEOUT_S:
            raise BadInputError(f"timeout: {self.timeout}: allowed: above 0, to {MAX_TIMEOUT_S:g} s")
        if self.thread:
            raise BadInputError(f"thread: {self.thread}: allowed: 0, the busiest or the first to call the symbol")

    @property
    def steps(self) -> bool:
        """Whether the target is single-stepped."""
        return self.walk > 1 or self.access != "read"

    @property
    def site(self) -> str:
        """Node and kind of register as text."""
        if self.node:
            return f"{self.node}:{self.registers}"
        return self.registers

    @property
    def bit(self) -> None:
        """None: the bit is drawn after the process has stopped."""
        return None
