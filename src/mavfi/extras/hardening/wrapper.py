"""Numba's wrapper of a kernel, changed to raise a SystemError for the status of a detected difference.

LLVM has removed the wrapper's handling of statuses that the plain kernel never returns.
"""

import re

MESSAGE = "a value and its shadow differ"
"""Text of the error."""
GLOBALS = [
    "@PyExc_SystemError = external global ptr",
    f'@mavfi_detected = private constant [{len(MESSAGE) + 1} x i8] c"{MESSAGE}\\00"',
]
_AFTER = re.compile(r"\s*(?:%\S+ = load |call void @(?:PyEval_RestoreThread|NRT_decref) )")
"""What follows the call: results are read, the interpreter's lock is taken, arguments are released."""


def raising(text: str, kernels: set[str], status: int) -> str:
    """A function outside the fault space; if it is the wrapper that calls one of the kernels, it raises."""
    lines = text.split("\n")
    if "@_ZN7cpython" not in lines[0] and '@"_ZN7cpython' not in lines[0]:
        return text
    calls = [number for number, line in enumerate(lines) if _called(line) in kernels]
    if len(calls) != 1:
        return text
    end = calls[0] + 1
    while _AFTER.match(lines[end]):
        end += 1
    label = next(line[:-1] for line in lines[calls[0] :: -1] if re.fullmatch(r'(?:"[^"]*"|[-\w$.]+):', line))
    result = lines[calls[0]].split()[0]
    check = [
        f"  %mavfi.found = icmp eq i32 {result}, {status}",
        "  br i1 %mavfi.found, label %mavfi.raise, label %mavfi.fine",
        "mavfi.raise:",
        "  call void @PyErr_SetString(ptr @PyExc_SystemError, ptr @mavfi_detected)",
        "  ret ptr null",
        "mavfi.fine:",
    ]
    after = [line.replace(f"%{label} ]", "%mavfi.fine ]") if " = phi " in line else line for line in lines]
    return "\n".join([*after[:end], *check, *after[end:]])


def _called(line: str) -> str:
    """Name of the function that a line calls for a status; "" = none."""
    found = re.match(r'\s*%\S+ = call i32 (@(?:"[^"]*"|[-\w$.]+)) \(', line)
    return "" if found is None else found[1]
