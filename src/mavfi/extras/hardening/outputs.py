"""What counts as output of a kernel's function: its result and arguments, but not work arrays and unused rows."""

import inspect
from typing import Any

import numpy as np

_WORK = {
    "plan_rrt": ("tree",), "plan_rrt_connect": ("trees",), "plan_rrt_star": ("tree",), "shortcut_random": ("buffer",),
}  # fmt: skip
"""Arguments that are written before they are read, by function."""
_COUNTED = {
    "insert_scan": ("touched", "before"), "collect": ("touched",),
    "apply_updates": ("journal_voxels", "journal_cells"),
    **dict.fromkeys(("plan_rrt", "plan_rrt_connect", "plan_rrt_star", "shortcut_greedy", "shortcut_random"), ("path",)),
}  # fmt: skip
"""Arguments whose rows beyond the resulting number are undefined."""


def outputs_of(entry: str, function: Any, result: Any, args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Result and changed arguments of a call; all of them for a function that is not the pipeline's."""
    names = tuple(inspect.signature(function.py_func).parameters)
    work, counted = _WORK.get(entry, ()), _COUNTED.get(entry, ())
    rows = _rows(result)
    own = []
    for name, value in zip(names, args, strict=True):
        if name not in work:
            own.append(value[:rows] if name in counted else value)
    return result, *own


def _rows(result: Any) -> int:
    """The resulting number of rows: the last one of several numbers; a corrupted one must not be an error."""
    last = result[-1] if isinstance(result, tuple) else result
    return max(int(last), 0) if isinstance(last, (int, np.integer)) else 0
