"""What is asked of the register injector (`Request`), and what it did (`RegisterInjection`)."""

from dataclasses import asdict, dataclass
from typing import Any

from mavfi.errors import BadInputError

REGISTERS = ("all", "general", "fp")
ACCESSES = ("either", "read", "write")
DEFAULT_WALK = 16
"""Longer than the loops at whose few instructions stops come. From here on strikes spread no further, and the target
stands still for longer (docs/ros-attach.md)."""
LONGEST_WALK = 100_000
LONGEST_TIMEOUT = 3600.0


@dataclass(frozen=True, slots=True)
class Request:
    """Where and how to strike.

    Attributes:
        pid: Process.
        seed: All choices come from it; the instant does not: a process that runs freely cannot be replayed.
        registers: "general" (with the flags), "fp" (XMM and YMM), or "all".
        access: Strike a register that the next instruction reads, before it; or one that it has written, after it; or
            "either".
        symbol: Function at whose next call the target is stopped: its exact name, or a part that no other name has.
            "" = stop wherever the target is.
        thread: Thread; 0 = the busiest, or with a symbol whichever gets there first.
        walk: From the stop on, a random number of instructions below this is executed before the strike.  A stop
            between system calls comes at few, always the same instructions (skid); the walk spreads them.
        timeout: Longest wait (s).
        null: Do everything but flip the bit.
    """

    pid: int
    seed: int = 0
    registers: str = "all"
    access: str = "either"
    symbol: str = ""
    thread: int = 0
    walk: int = DEFAULT_WALK
    timeout: float = 10.0
    null: bool = False

    def __post_init__(self) -> None:
        if self.registers not in REGISTERS:
            raise BadInputError(f"registers: {self.registers!r}: allowed: {', '.join(REGISTERS)}")
        if self.access not in ACCESSES:
            raise BadInputError(f"access: {self.access!r}: allowed: {', '.join(ACCESSES)}")
        if not 1 <= self.walk <= LONGEST_WALK:
            raise BadInputError(f"walk: {self.walk}: allowed: 1 to {LONGEST_WALK} instructions")
        if not 0.0 < self.timeout <= LONGEST_TIMEOUT:
            raise BadInputError(f"timeout: {self.timeout}: allowed: above 0, to {LONGEST_TIMEOUT:g} s")
        if self.pid < 1 or self.thread < 0:
            name, value = ("pid", self.pid) if self.pid < 1 else ("thread", self.thread)
            raise BadInputError(f"{name}: {value}: allowed: the number of a running process")

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class RegisterInjection:
    """One strike.

    Attributes:
        pid: Process.
        thread: Thread that was struck.
        address: Of the instruction.
        library: File that holds it, or "[anon]" for code that was generated at run time.
        offset: In that file (bytes).
        symbol: Function and distance from its begin, "" if unknown.
        instruction: As text.
        access: "read": struck before the instruction, which reads the register; "write": after it had written it.
        register: As the instruction names it.
        width: Of the register, or of the part of a vector register that the instruction uses (bits).
        bit: Which one; of the flags register, the place of the flag in it.
        before: Value before.
        after: Value after, read back from the target.
        attempts: Stops until one was between system calls and near an instruction that qualifies.
        walked: Instructions executed one by one.
        stopped_us: How long the target stood still (us).
        hit: Whether the register read back is the one before with exactly this bit flipped (null: not flipped).
    """

    pid: int
    thread: int
    address: int
    library: str
    offset: int
    symbol: str
    instruction: str
    access: str
    register: str
    width: int
    bit: int
    before: int
    after: int
    attempts: int
    walked: int
    stopped_us: int
    hit: bool

    def to_json(self) -> dict[str, Any]:
        """Plain data; addresses and values as hexadecimal text."""
        shown = ("address", "offset", "before", "after")
        return {name: f"{value:#x}" if name in shown else value for name, value in asdict(self).items()}
