"""Debug metadata of LLVM IR: source lines with their chains of inlined calls, and variable names."""

import os
import re
from dataclasses import dataclass

_VALUE = re.compile(
    r'#dbg_value\([^%,!]+ (%(?:"[^"]*"|[-\w$.]+)), !(\d+), !DIExpression\((?:DW_OP_LLVM_fragment, \d+, \d+)?\),'
)
_FIELD = r'\b{}: (?:!(\d+)|"((?:[^"\\]|\\.)*)"|(\d+))'
"""A field of a metadata node, by its name: a reference, a text or a number."""


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
    """Value of a field of a metadata node: number of another node, text or number; "" = there is none."""
    match = re.search(_FIELD.format(name), node)
    if match is None:
        return ""
    return next(part for part in match.groups() if part is not None)


class Locations:
    """Source lines of debug locations."""

    def __init__(self, metadata: dict[int, str]) -> None:
        self._metadata = metadata

    def chain(self, location: int) -> tuple[Frame, ...]:
        """Source lines, the innermost inlined call first."""
        frames = []
        number = str(location)
        while number:
            node = self._metadata.get(int(number), "")
            if not node.startswith("!DILocation("):
                break
            frames.append(self._frame(_field(node, "scope"), int(_field(node, "line") or 0)))
            number = _field(node, "inlinedAt")
        return tuple(frames)

    def function(self, subprogram: int) -> tuple[Frame, ...]:
        """The first line of a function."""
        node = self._metadata.get(subprogram, "")
        return (self._frame(str(subprogram), int(_field(node, "line") or 0)),)

    def _frame(self, scope: str, line: int) -> Frame:
        """The frame of a line in a scope, given by its number or ""."""
        node = ""
        if scope:
            node = self._metadata.get(int(scope), "")
        while node.startswith("!DILexicalBlock"):
            node = self._metadata.get(int(_field(node, "scope")), "")
        file = self._metadata.get(int(_field(node, "file") or -1), "")
        path = os.path.join(_field(file, "directory"), _field(file, "filename"))
        return Frame(path, line, _field(node, "name"))
