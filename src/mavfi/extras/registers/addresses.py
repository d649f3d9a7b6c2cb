"""The target's address space: mapped files, functions by address, and addresses by function name."""

import bisect
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

from mavfi.errors import BadInputError

_SYMBOL = struct.Struct("<IBBHQQ")  # Elf64_Sym: name, info, other, section, value, size
_FUNCTIONS = (2, 10)  # STT_FUNC, STT_GNU_IFUNC
_NAMELESS = "/memfd:"
_MAX_NAMES = 5
"""Largest number of names in an error."""


@dataclass(frozen=True, slots=True)
class _Mapping:
    """A line of /proc/PID/maps: addresses, and what is mapped there."""

    start: int
    end: int
    executable: bool
    offset: int
    name: str


@dataclass(frozen=True, slots=True)
class CodeLocation:
    """Location of an address: file, offset in it, and function with the distance from its start."""

    library: str
    offset: int
    symbol: str


@dataclass(frozen=True, slots=True)
class _Symbols:
    """Functions of an ELF file; addresses as in the file, not as loaded."""

    functions: dict[int, tuple[int, str]]
    """Size and name, by ascending address."""
    segments: list[tuple[int, int, int]]
    """Offset in the file, size and address of each loaded segment."""

    def offset_of(self, address: int) -> int | None:
        """File offset of an address."""
        for start, size, first in self.segments:
            if first <= address < first + size:
                return start + address - first
        return None

    def address_of(self, offset: int) -> int | None:
        """Address of a file offset."""
        for start, size, first in self.segments:
            if start <= offset < start + size:
                return first + offset - start
        return None

    def name_at(self, offset: int) -> str:
        """Function that contains a file offset, and the distance from its start; "" = none."""
        address = self.address_of(offset)
        if address is None:
            return ""
        starts = list(self.functions)
        index = bisect.bisect_right(starts, address) - 1
        if index < 0:
            return ""
        distance = address - starts[index]
        size, name = self.functions[starts[index]]
        if size and distance >= size:
            return ""
        return f"{name.split('@')[0]}+{distance:#x}"


def _mappings(text: str) -> list[_Mapping]:
    """The mappings in the text of /proc/PID/maps."""
    mappings = []
    for line in text.splitlines():
        addresses, permissions, offset, _, _, *names = line.split(None, 5)
        start, _, end = addresses.partition("-")
        name = "[anon]"
        if names:
            name = names[0]
        mappings.append(_Mapping(int(start, 16), int(end, 16), "x" in permissions, int(offset, 16), name))
    return mappings


@lru_cache(maxsize=64)
def _symbols(path: str, identity: tuple[int, int]) -> _Symbols:
    """Functions of a file; empty if it is not a readable ELF file."""
    del identity  # a replaced file is read again
    functions: dict[int, tuple[int, str]] = {}
    segments: list[tuple[int, int, int]] = []
    try:
        with open(path, "rb") as file:
            elf = ELFFile(file)
            for segment in elf.iter_segments("PT_LOAD"):
                segments.append((segment["p_offset"], segment["p_filesz"], segment["p_vaddr"]))
            for kind in (".dynsym", ".symtab"):
                section = elf.get_section_by_name(kind)
                if section is None:
                    continue
                texts = elf.get_section(section["sh_link"]).data()
                for name, info, _, _, value, size in _SYMBOL.iter_unpack(section.data()):
                    if info & 15 in _FUNCTIONS and value:
                        functions[value] = (size, texts[name : texts.index(b"\0", name)].decode(errors="replace"))
    except (OSError, ELFError, struct.error, ValueError):
        pass
    return _Symbols(dict(sorted(functions.items())), segments)


class AddressSpace:
    """The target's memory map as last read; it remains usable after the target has ended."""

    def __init__(self, pid: int, nameless: str = "") -> None:
        """Read the map; an OSError if the target has ended or may not be inspected.  Must be closed.

        `nameless`: file with the content of a library that the target has loaded from memory without a name.
        """
        self._pid = pid
        self._nameless = nameless
        self._root = os.open(f"/proc/{pid}/root", os.O_PATH | os.O_DIRECTORY)
        self.read()

    def read(self) -> None:
        """Read the map again: only the text, which takes some 0.1 ms and is parsed later."""
        self._text = Path(f"/proc/{self._pid}/maps").read_text()

    def close(self) -> None:
        """Release the target's files."""
        os.close(self._root)

    def _symbols_of(self, mapping: _Mapping) -> _Symbols | None:
        """Functions of a mapped file; None if it cannot be read."""
        if not mapping.name.startswith("/"):
            return None
        # as seen by the target, which may run in a container
        path = f"/proc/self/fd/{self._root}{mapping.name}"
        if mapping.name.startswith(_NAMELESS):
            path = self._nameless
        try:
            status = os.stat(path)
        except OSError:
            return None
        return _symbols(path, (status.st_ino, status.st_mtime_ns))

    def location_of(self, address: int) -> CodeLocation:
        """Location of an address."""
        for mapping in _mappings(self._text):
            if not mapping.start <= address < mapping.end:
                continue
            offset = address - mapping.start + mapping.offset
            symbols = self._symbols_of(mapping)
            if symbols is None:
                return CodeLocation(mapping.name, offset, "")
            return CodeLocation(mapping.name, offset, symbols.name_at(offset))
        return CodeLocation("[anon]", address, "")

    def find(self, text: str) -> int:
        """Address of a function, by its exact name or a unique part of it.

        Raises a BadInputError if there is none, or more than one.
        """
        matches = dict(self._matches(text))
        exact = {address: name for address, name in matches.items() if name == text}
        functions = exact or matches
        if len(functions) == 1:
            return next(iter(functions))
        if not functions:
            raise BadInputError(f"symbol {text!r}: no function of process {self._pid} has this name or part of it")
        some = ", ".join(sorted(set(functions.values()))[:_MAX_NAMES])
        raise BadInputError(f"symbol {text!r}: {len(functions)} functions of process {self._pid} match; some: {some}")

    def function_in(self, name: str, file: str) -> int:
        """Address of a function by its exact name, in a file whose name contains a text; 0 = there is none."""
        for address, candidate in self._matches(name, file):
            if candidate == name:
                return address
        return 0

    def _matches(self, text: str, file: str = "") -> Iterator[tuple[int, str]]:
        """Functions whose names contain a text: load address, and name without a version."""
        for mapping in _mappings(self._text):
            if not mapping.executable or file not in os.path.basename(mapping.name):
                continue
            symbols = self._symbols_of(mapping)
            if symbols is None:
                continue
            end = mapping.offset + mapping.end - mapping.start
            for address, (_, versioned_name) in symbols.functions.items():
                name = versioned_name.split("@")[0]
                if text not in name:
                    continue
                offset = symbols.offset_of(address)
                if offset is not None and mapping.offset <= offset < end:
                    yield mapping.start + offset - mapping.offset, name

    def code_of(self, file: str) -> Iterator[tuple[int, int, int, str]]:
        """Executable mappings of files whose names contain a text: start, end, offset in the file, and a path to it."""
        for mapping in _mappings(self._text):
            if mapping.executable and file in os.path.basename(mapping.name):
                yield mapping.start, mapping.end, mapping.offset, f"/proc/{self._pid}/root{mapping.name}"
