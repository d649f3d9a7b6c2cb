"""The output of a kernel in one step, and the first number in which two outputs differ."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.memory import Remembers
from mavfi.states import State


@dataclass(frozen=True, slots=True)
class Output:
    """One step of a kernel: header and elements of what it publishes, by name, and a fingerprint of its memory."""

    states: dict[str, tuple[np.ndarray, np.ndarray]]
    memory: bytes

    @staticmethod
    def of(kernel: Kernel, states: Sequence[State]) -> "Output":
        """Output of a step that has just been made."""
        published = {state.spec.name: (state.header.copy(), state.elements.copy()) for state in states}
        return Output(published, cast(Remembers, kernel).fingerprint())

    def same(self, other: "Output") -> bool:
        """Whether both are the same, bit for bit, memory included."""
        return self.memory == other.memory and first_difference(self, other) is None


def first_difference(golden: Output, injected: Output) -> dict[str, Any] | None:
    """The first published field that differs, as plain data; None if nothing differs.

    Returns:
        `state`, `field`, `element` (None for a field of the header), `before` (golden), `after`, `elements` (in how
        many places the field differs) and `largest` (difference; infinite where one is not finite).  Where the lists
        differ in length: the field `elements`, with both lengths.
    """
    for state, (header, elements) in golden.states.items():
        if state not in injected.states:
            return _difference(state, "", None, len(elements), 0, 1, math.inf)
        other_header, other_elements = injected.states[state]
        found = _in_fields(state, header, other_header, in_list=False)
        if found is None and len(elements) != len(other_elements):
            lengths = len(elements), len(other_elements)
            found = _difference(state, "elements", None, *lengths, 1, float(abs(lengths[0] - lengths[1])))
        found = found or _in_fields(state, elements, other_elements, in_list=True)
        if found is not None:
            return found
    return None


def _in_fields(state: str, golden: np.ndarray, injected: np.ndarray, *, in_list: bool) -> dict[str, Any] | None:
    for field in golden.dtype.names or ():
        before, after = np.ascontiguousarray(golden[field]), np.ascontiguousarray(injected[field])
        width = before.dtype.itemsize
        bits = [values.view(np.uint8).reshape(-1, width) for values in (before, after)]
        places = np.flatnonzero((bits[0] != bits[1]).any(axis=1))
        if len(places):
            first = int(places[0])
            apart = np.abs(after[places].astype(np.float64) - before[places].astype(np.float64))
            largest = float(apart.max()) if np.isfinite(apart).all() else math.inf
            element = first if in_list else None
            return _difference(state, field, element, before[first].item(), after[first].item(), len(places), largest)
    return None


def _difference(
    state: str, field: str, element: int | None, before: Any, after: Any, elements: int, largest: float
) -> dict[str, Any]:  # fmt: skip
    return {
        "state": state, "field": field, "element": element, "before": before, "after": after, "elements": elements,
        "largest": largest,
    }  # fmt: skip
