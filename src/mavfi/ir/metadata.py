"""Debug metadata of LLVM IR: source lines with their chains of inlined calls, and variable names."""

import os
import re
from dataclasses import dataclass

_VALUE = re.compile(
    r'#dbg_value\([^%,!]+ (%(?:"[^"]*"|[-\w$.]+)), !(\d+), !DIExpression\((?:DW_OP_LLVM_fragment, \d+, \d+)?\),'
)
_FIELD = r'\b{}: (?:!(\d+)|"((?:[^"\\]|\\.)*)"|(\d+))'


@dataclass(frozen=True, slots=True)
class Frame:
    """A source line: path, line number from 1 (0 = unknown), and function name."""

    file: str
    line: int
    function: str


def variable_of(line: str, metadata: dict[int, str]) -> dict[str, str]:
    """Source variable of a `#dbg_value` line, by local name; empty if there is none, or if Numba generated it."""
    match = _VALUE.match(line)
    if match is None:
        return {}
    variable = re.split(r"[.$]", _field(metadata.get(int(match[2]), ""), "name"))[0]
    if variable:
        return {match[1]: variable}
    return {}


def _field(node: str, name: str) -> str:
    found = re.search(_FIELD.format(name), node)
    if found is None:
        return ""
    return next(part for part in found.groups() if part is not None)


class Locations:
    """Source lines of debug locations."""

    def __init__(self, metadata: dict[int, str]) -> None:
        self._metadata = metadata

    def chain(self, location: int) -> tuple[Frame, ...]:
        """Source lines, the innermost inlined call first."""
        frames = []
        here = str(location)
        while here:
            node = self._metadata.get(int(here), "")
            if not node.startswith("!DILocation("):
                break
            frames.append(self._frame(_field(node, "scope"), int(_field(node, "line") or 0)))
            here = _field(node, "inlinedAt")
        return tuple(frames)

    def function(self, subprogram: int) -> tuple[Frame, ...]:
        """The first line of a function."""
        node = self._metadata.get(subprogram, "")
        return (self._frame(str(subprogram), int(_field(node, "line") or 0)),)

    def _frame(self, scope: str, line: int) -> Frame:
        node = self._metadata.get(int(scope), "") if scope else ""
        while node.startswith("!DILexicalBlock"):
            node = self._metadata.get(int(_field(node, "scope")), "")
        file = self._metadata.get(int(_field(node, "file") or -1), "")
        path = os.path.join(_field(file, "directory"), _field(file, "filename"))
        return Frame(path, line, _field(node, "name"))
