"""Registers read and written by an instruction, and bit flips in them."""

import re
from dataclasses import dataclass
from functools import lru_cache

import capstone
from capstone import x86_const as x86

from mavfi.extras.registers.ptrace import Tracee

_FLAGS = {"CF": 0, "PF": 2, "AF": 4, "ZF": 6, "SF": 7, "OF": 11}
"""Injectable flags, with their bits in RFLAGS."""
_VECTOR = re.compile(r"([xy])mm(\d+)$")
"""Name of a vector register, with its number."""
_LAST_VECTOR = 15
"""Largest number of a vector register that ptrace can write in the standard area."""
_COMPARES = ("vucomis", "vcomis")
"""Comparisons for which the decoder omits that they set flags: all six (Intel SDM, vol. 2, UCOMISD)."""
_MASKED = re.compile(r"[xy]mm\d+(?= \{k[1-7]\})")
"""A masked first operand, whose write the decoder omits."""


@dataclass(frozen=True, slots=True)
class Register:
    """A register as named by an instruction, e.g. "eax", "xmm3", "rflags".

    Attributes:
        name: As in the instruction.
        holder: The general register of which it is a part; "" = a vector register.
        index: Number of a vector register; 0 for others.
        shift: Bit of the holder at which it starts.
        bits: The injectable bits, counted from its start.
    """

    name: str
    holder: str
    index: int
    shift: int
    bits: tuple[int, ...]

    @property
    def width(self) -> int:
        """Size in bits."""
        if self.name == "rflags":
            return max(self.bits) + 1
        return len(self.bits)

    @property
    def is_vector(self) -> bool:
        """Whether it is XMM or YMM."""
        return not self.holder


def _general() -> dict[str, Register]:
    """General registers by name, with their parts: of "rax", "ah" starts at bit 8."""
    # from the widest name to the narrowest; "h" is the second byte
    families = [[(f"r{x}x", 64), (f"e{x}x", 32), (f"{x}x", 16), (f"{x}l", 8), (f"{x}h", 8)] for x in "abcd"]
    families += [[(f"r{x}", 64), (f"e{x}", 32), (x, 16), (f"{x}l", 8)] for x in ("si", "di", "bp", "sp")]
    families += [[(f"r{x}", 64), (f"r{x}d", 32), (f"r{x}w", 16), (f"r{x}b", 8)] for x in range(8, 16)]
    registers = {}
    for family in families:
        holder = family[0][0]
        for name, width in family:
            shift = 0
            if name[-1] == "h":
                shift = 8
            registers[name] = Register(name, holder, 0, shift, tuple(range(width)))
    return registers


_GENERAL = _general()
"""General registers and their parts, by name."""


@lru_cache(maxsize=1)
def _decoder() -> capstone.Cs:
    """Capstone's decoder, built once."""
    decoder = capstone.Cs(capstone.CS_ARCH_X86, capstone.CS_MODE_64)
    decoder.detail = True
    return decoder


@dataclass(frozen=True, slots=True)
class MachineInstruction:
    """A decoded instruction: mnemonic and operands, and the registers that it reads and writes.

    Stepping over an instruction that enters the kernel (a system call) may block.
    """

    text: str
    enters_kernel: bool
    reads: tuple[Register, ...]
    writes: tuple[Register, ...]


_PREFIXES = b"\x66\x67\xf0\xf2\xf3\x2e\x36\x3e\x26\x64\x65" + bytes(range(0x40, 0x50))
"""Prefixes of instructions (Intel SDM, vol. 2, 2.1.1 and 2.2.1)."""
_SYSCALL = b"\x0f\x05"
"""Opcode of a system call."""
_SYSENTER = b"\x0f\x34"
"""Opcode of a system call of 32-bit programs."""
_INT = b"\xcd"
"""Opcode of a software interrupt."""


@lru_cache(maxsize=4096)
def enters_kernel(code: bytes) -> bool:
    """Whether the instruction at the start of `code` enters the kernel, without decoding it (Intel SDM, vol. 2)."""
    return code.lstrip(_PREFIXES).startswith((_SYSCALL, _SYSENTER, _INT))


@lru_cache(maxsize=4096)
def decode(code: bytes, address: int) -> MachineInstruction | None:
    """The instruction at the start of up to 15 bytes at an address; None if unknown to the decoder."""
    decoded = next(_decoder().disasm(code, address, 1), None)
    if decoded is None:
        return None
    text = f"{decoded.mnemonic} {decoded.op_str}".rstrip()
    read, written = decoded.regs_access()
    reads = _registers(decoded, read, _FLAGS_READ)
    writes = _registers(decoded, written, _FLAGS_WRITTEN)
    # What the decoder omits.
    if decoded.mnemonic.startswith(_COMPARES):
        writes += _ALL_FLAGS
    masked = _MASKED.match(decoded.op_str)
    if masked and all(register.name != masked[0] for register in writes):
        writes += _vector(masked[0], decoded.mnemonic)
    return MachineInstruction(text, decoded.mnemonic in ("syscall", "sysenter", "int"), reads, writes)


def _flag_masks(*verbs: str) -> dict[str, int]:
    """Capstone's `eflags` bits for the given actions on each flag."""
    return {flag: sum(getattr(x86, f"X86_EFLAGS_{verb}_{flag}", 0) for verb in verbs) for flag in _FLAGS}


_FLAGS_READ = _flag_masks("TEST")
"""Capstone's bits of flags that an instruction reads."""
_FLAGS_WRITTEN = _flag_masks("MODIFY", "SET", "RESET")
"""Capstone's bits of flags that an instruction writes."""
_ALL_FLAGS = (Register("rflags", "rflags", 0, 0, tuple(_FLAGS.values())),)
"""The register of flags, of which every flag is injectable."""


def _registers(decoded: capstone.CsInsn, numbers: list[int], flags: dict[str, int]) -> tuple[Register, ...]:
    """The injectable registers with these numbers; `flags` are Capstone's bits for each flag."""
    registers: list[Register] = []
    for number in numbers:
        name = decoded.reg_name(number)
        if name in _GENERAL:
            registers.append(_GENERAL[name])
        elif name == "rflags":  # only flags that the instruction tests or sets: the others would all be masked
            bits = tuple(bit for flag, bit in _FLAGS.items() if decoded.eflags & flags[flag])
            if bits:
                registers.append(Register("rflags", "rflags", 0, 0, bits))
        else:
            registers += _vector(name, decoded.mnemonic)
    return tuple(registers)


def _vector(name: str, mnemonic: str) -> tuple[Register, ...]:
    """An injectable vector register; empty if the name is not one."""
    match = _VECTOR.match(name)
    if match is None or int(match[2]) > _LAST_VECTOR:
        return ()
    return (Register(name, "", int(match[2]), 0, tuple(range(_used_bits(mnemonic, match[1])))),)


def _used_bits(mnemonic: str, kind: str) -> int:
    """Bits of a vector register that the instruction uses: one number for scalar arithmetic."""
    if kind == "y":
        return 256
    if mnemonic.endswith("sd"):
        return 64
    if mnemonic.endswith("ss"):
        return 32
    return 128


def value_of(tracee: Tracee, register: Register) -> int:
    """Value of a register of a stopped thread."""
    if register.is_vector:
        holder = tracee.vector(register.index)
    else:
        holder = tracee.general()[register.holder]
    return (holder >> register.shift) % (1 << register.width)


def flip(tracee: Tracee, register: Register, bit: int) -> None:
    """Flip a bit of a register of a stopped thread."""
    mask = 1 << (register.shift + bit)
    if register.is_vector:
        tracee.set_vector(register.index, tracee.vector(register.index) ^ mask)
        return
    registers = tracee.general()
    registers[register.holder] ^= mask
    tracee.set_general(registers)
