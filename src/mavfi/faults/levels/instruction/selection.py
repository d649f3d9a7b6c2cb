"""Selection of injectable instructions: all, floating point, data, one class or opcode, or some source lines."""

import re
from dataclasses import dataclass

from mavfi.errors import BadInputError
from mavfi.faults.levels.instruction.classify import ADDRESS, CONTROL, FLOATING, INTEGER
from mavfi.faults.levels.instruction.table import Site

FORM = "all, floating_point, data, address, control, integer, opcode:NAME, or line:FILE:FIRST[-LAST]"
_CLASSES = (ADDRESS, CONTROL, INTEGER)
_LINES = re.compile(r"line:(?P<file>[^:]+):(?P<first>\d+)(-(?P<last>\d+))?")


@dataclass(frozen=True, slots=True)
class Selection:
    """A class of instructions.

    Attributes:
        kind: "all"; "floating_point": by result type, whatever its use; "data": feeds neither an address nor a branch;
            "address", "control", "integer": by value class; "opcode"; "line".
        opcode: As in LLVM's language reference.
        file: End of a source file's path; lines `first` to `last` of it are in the class.
    """

    kind: str = "all"
    opcode: str = ""
    file: str = ""
    first: int = 0
    last: int = 0

    def __contains__(self, site: Site) -> bool:
        """Whether an instruction is in the class; any line of its chain of inlined calls counts."""
        if self.kind == "floating_point":
            return site.floating
        if self.kind == "data":
            return site.value_class in (FLOATING, INTEGER)
        if self.kind == "opcode":
            return site.opcode == self.opcode
        if self.kind == "line":
            return any(self._holds(frame.file, frame.line) for frame in site.chain)
        return self.kind in ("all", site.value_class)

    def _holds(self, file: str, line: int) -> bool:
        return f"/{file}".endswith(f"/{self.file}") and self.first <= line <= self.last


def parse_selection(text: str) -> Selection:
    """Parse a class of instructions; the BadInputError names the allowed ones."""
    if text in ("all", "floating_point", "data", *_CLASSES):
        return Selection(text)
    kind, _, rest = text.partition(":")
    if kind == "opcode" and rest.isalpha():
        return Selection("opcode", opcode=rest)
    lines = _LINES.fullmatch(text)
    if lines is None:
        raise BadInputError(f"instructions {text!r}: not understood; allowed: {FORM}")
    first = int(lines["first"])
    return Selection("line", file=lines["file"], first=first, last=int(lines["last"] or first))
