"""Digest of a module's fault space: the same in every process and folder."""

import hashlib
import re

from mavfi.ir.module import Module

_PER_PROCESS = re.compile(
    r"B\d+v\d+(?!\d)|(?<=RecordILi)\d+|0x[0-9a-f]{6,}|(?<=picklebuf\.)[0-9a-f]+|(?<=pickledata\.)[0-9a-f]+|-?\d{9,}"
)
"""Process- or folder-dependent parts of Numba's global names: function counters, numbers of record types (each
further compiled function shifts both), addresses, digests of exceptions with the path of their source, hashes of
strings, which may be negative."""
_PICKLED_SIZE = re.compile(r"(store ptr @\.const\.pickledata\.\S+ ,?[^\n]*\n[^\n]*\n\s*store i32 )\d+")
"""Stored length of such an exception: it grows with the path."""


def bodies_of(module: Module) -> str:
    """Text of the functions in the fault space."""
    return "\n".join(function.text() for function in module.functions)


def digest_of(module: Module) -> str:
    """SHA-256 of the functions in the fault space."""
    return digest_of_text(bodies_of(module))


def digest_of_text(bodies: str) -> str:
    """SHA-256 of IR, without what differs between processes."""
    bodies = _PICKLED_SIZE.sub(r"\1*", bodies)
    neutral = re.sub(r'@(?:"[^"]*"|[-\w$.]+)', lambda name: _PER_PROCESS.sub("*", name[0]), bodies)
    return hashlib.sha256(neutral.encode()).hexdigest()
