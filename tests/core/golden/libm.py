"""Functions of the C library that MuJoCo's library calls, counted and changed by one unit in the last place.

The library calls them through its global offset table; the entries of an ELF file that is loaded can be replaced.
"""

import ctypes
import math
import mmap
import platform
import re
import struct
import sys
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

from elftools.elf.elffile import ELFFile

EXACT = frozenset({"sqrt", "floor", "llround"})
"""Correctly rounded (IEEE 754) or exact, on every CPU."""
_PROTECT, _READ, _WRITE = 10, 1, 2
_SYMBOL_JUMP, _SYMBOL_DATA = 7, 6  # R_X86_64_JUMP_SLOT, R_X86_64_GLOB_DAT
_TWO = frozenset({"pow", "powf", "atan2", "atan2f"})
_libc = ctypes.CDLL(None, use_errno=True)


def why_not():
    """Why calls cannot be redirected here; "" = they can."""
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        return "the offset table of x86-64 ELF files is known"
    return "" if loaded() else "MuJoCo's library is not an ELF file that is mapped"


def loaded():
    """Path and base address of MuJoCo's library in this process."""
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        match = re.match(r"(\w+)-\w+ \S+ 0+ \S+ \d+ +(\S*libmujoco\.so\S*)$", line)
        if match:
            return match[2], int(match[1], 16)
    return None


def imported(path):
    """Of an ELF file: symbols that it takes from libm, with the offsets of their entries in its offset table."""
    with open(path, "rb") as file:
        elf = ELFFile(file)
        symbols = elf.get_section_by_name(".dynsym")
        of_libm = {
            auxiliary["vna_other"]
            for library, versions in elf.get_section_by_name(".gnu.version_r").iter_versions()
            for auxiliary in versions
            if library.name.startswith("libm.")
        }
        kinds = elf.get_section_by_name(".gnu.version")
        functions = {
            symbol.name: []
            for number, symbol in enumerate(symbols.iter_symbols())
            if kinds.get_symbol(number)["ndx"] in of_libm
        }
        for section in (".rela.plt", ".rela.dyn"):
            for entry in elf.get_section_by_name(section).iter_relocations():
                name = symbols.get_symbol(entry["r_info_sym"]).name
                if entry["r_info_type"] in (_SYMBOL_JUMP, _SYMBOL_DATA) and name in functions:
                    functions[name].append(entry["r_offset"])
    return functions


def _signature(name):
    number = ctypes.c_float if name.endswith("f") else ctypes.c_double
    arguments = (number, number) if name in _TWO else (number,)
    return ctypes.CFUNCTYPE(ctypes.c_long if name == "llround" else number, *arguments)


def _next(name, value):
    """One unit in the last place away from zero; where exactness is certain (0 of a sine, NaN) the value itself."""
    if name.endswith("f"):
        bits = struct.unpack("i", struct.pack("f", value))[0]
        return struct.unpack("f", struct.pack("i", bits + 1))[0] if math.isfinite(value) and value else value
    return math.nextafter(value, math.copysign(math.inf, value)) if value else value


@contextmanager
def changed(names):
    """Have these functions called through Python, their results one unit off; gives the calls of all, counted.

    Functions that are not named are counted only.
    """
    path, base = loaded()
    calls, keep, before = Counter(), [], []

    def replacement(name, original):
        def call(*arguments):
            calls[name] += 1
            value = original(*arguments)
            return _next(name, value) if name in names else value

        return call

    for name, offsets in imported(path).items():
        for offset in offsets:
            entry = ctypes.c_size_t.from_address(base + offset)
            signature = _signature(name)
            stub = signature(replacement(name, signature(entry.value)))
            keep.append(stub)
            before.append((entry, entry.value))
            _write(entry, ctypes.cast(stub, ctypes.c_void_p).value)
    try:
        yield calls
    finally:
        for entry, value in before:
            _write(entry, value)


def _write(entry, value):
    """Replace an entry, which is protected once the library is loaded."""
    page = ctypes.addressof(entry) & -mmap.PAGESIZE
    if _libc.mprotect(ctypes.c_void_p(page), mmap.PAGESIZE, _READ | _WRITE):
        raise OSError(ctypes.get_errno(), "mprotect")
    entry.value = value
