"""Destination registers of the executed instructions in a recorded run of machine code.

They are the fault space of the machine-level reference, as in PINFI (Wei et al., DSN 2014).  The decoder's list of
written registers is larger; the following rules apply:

- an instruction with a general or vector register as destination has only this one, not the flags that it also sets;
- one that only sets flags (comparisons) has the flags tested by the next instruction that tests any of them: the others
  are overwritten unread;
- the stack pointer of push, pop, call, ret and leave is not a destination, that of `sub rsp, 48` is;
- stores, jumps, calls, and instructions that only clear registers between functions (vzeroupper) have none;
- mask registers (k0 to k7) and vector registers from 16 on are not accessible to `registers.py`: counted separately.
"""

import re
from collections.abc import Sequence

from mavfi.extras.registers.registers import MachineInstruction, Register

_STACK = ("push", "pop", "call", "ret", "leave", "enter")
_CLEAR = ("vzeroupper", "vzeroall")
_ENDS_FLAGS = ("call", "ret", "syscall")
_UNREACHED = re.compile(r"(k[0-7]|zmm\d+|[xy]mm(1[6-9]|2\d|3[01]))\b")
_NO_RESULT = ("cmp", "test", "bt", "ucomis", "comis", "vucomis", "vcomis", "vptest", "vtestp", "ktest", "kortest")


def destinations(run: Sequence[MachineInstruction | None]) -> list[tuple[Register, ...]]:
    """Destination registers of each executed instruction, in execution order.

    Args:
        run: Instructions as executed; None for those outside the kernel's own code, which are not injected.

    Returns:
        For each instruction the registers that can be injected after it; empty if it has no destination.
    """
    return [() if made is None else _of(made, run, place) for place, made in enumerate(run)]


def is_out_of_reach(instruction: MachineInstruction) -> bool:
    """Whether the destination (the first operand, unless only read) is a register that cannot be injected."""
    mnemonic, _, operands = instruction.text.partition(" ")
    return not mnemonic.startswith(_NO_RESULT) and _UNREACHED.match(operands) is not None


def _of(made: MachineInstruction, run: Sequence[MachineInstruction | None], place: int) -> tuple[Register, ...]:
    mnemonic = made.text.split(" ", 1)[0]
    if mnemonic in _CLEAR or is_out_of_reach(made):
        return ()
    on_stack = mnemonic.startswith(_STACK)
    named = tuple(
        register for register in made.writes if register.name != "rflags" and not (on_stack and register.name == "rsp")
    )
    if named or on_stack:
        return named
    flags = next((register for register in made.writes if register.name == "rflags"), None)
    return () if flags is None else _tested(flags, run, place)


def _tested(flags: Register, run: Sequence[MachineInstruction | None], place: int) -> tuple[Register, ...]:
    """The flags tested by the next instruction that tests any of them; empty if there is none."""
    alive = set(flags.bits)
    for later in run[place + 1 :]:
        if later is None or later.text.startswith(_ENDS_FLAGS):
            break  # flags are not preserved across calls (System V ABI)
        tested = alive & _flags(later.reads)
        if tested:
            return (Register("rflags", "rflags", 0, 0, tuple(sorted(tested))),)
        alive -= _flags(later.writes)
        if not alive:
            break
    return ()


def _flags(registers: tuple[Register, ...]) -> set[int]:
    return {bit for register in registers if register.name == "rflags" for bit in register.bits}
