"""Stores machine code of rewritten kernels on disk, next to Numba's own cache.

The key covers the kernel's bytecode with its constants and globals, and the versions; an entry is valid while
every source file in its line tables is unchanged.
"""

import contextlib
import hashlib
import json
import os
import types
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np

from mavfi.ir.build import name_of
from mavfi.ir.fresh import surroundings
from mavfi.numerics.jit import code_folder


@dataclass(frozen=True, slots=True)
class ObjectCache:
    """A folder of entries.

    Attributes:
        folder: Name of the folder.
        package: Folder of the modules that make the code; a change of their text invalidates all entries.
    """

    folder: str
    package: Path

    def key(self, kernel: Any, signature: tuple[Any, ...], *more: bytes) -> str:
        """Digest of all inputs of the machine code, except the text of callees; `more` are further inputs."""
        digest = hashlib.sha256(repr((numba.__version__, llvmlite.__version__, np.__version__)).encode())
        digest.update(repr([str(kind) for kind in signature]).encode())
        for part in (folder_text(Path(__file__).parent), folder_text(self.package), *_parts(kernel, set()), *more):
            digest.update(hashlib.sha256(part).digest())
        return digest.hexdigest()[:40]

    def load(self, key: str) -> bytes | None:
        """The data of an entry; None if it is missing, damaged, or made from source files that have changed."""
        try:
            data = self._path(key).read_bytes()
            size = 40 + int.from_bytes(data[32:40], "little")
            if hashlib.sha256(data[32:]).digest() != data[:32]:
                return None
            sources = json.loads(data[40:size])
        except (OSError, ValueError):
            return None
        if any(_digest_of(source) != digest for source, digest in sources.items()):
            return None
        return data[size:]

    def store(self, key: str, data: bytes, files: Iterable[str]) -> None:
        """Write an entry made from source `files`, atomically: no other process reads a part; no space, no entry."""
        numbas = Path(numba.__file__).parent  # covered by Numba's version
        own = [file for file in sorted(files) if os.path.isfile(file) and numbas not in Path(file).parents]
        sources = json.dumps({file: _digest_of(file) for file in own}).encode()
        body = len(sources).to_bytes(8, "little") + sources + data
        path = self._path(key)
        part = path.with_suffix(f".{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(hashlib.sha256(body).digest() + body)
            part.replace(path)
        except OSError:
            with contextlib.suppress(OSError):
                part.unlink()

    def _path(self, key: str) -> Path:
        return code_folder() / self.folder / f"{key}.bin"


@cache
def folder_text(package: Path) -> bytes:
    """Text of all modules of a package's folder."""
    return b"".join(path.read_bytes() for path in sorted(package.glob("*.py")))


def _parts(kernel: Any, seen: set[int]) -> Iterator[bytes]:
    """The function's code, and the values that it takes from its surroundings."""
    function = kernel.py_func
    seen.add(id(function))
    flags = sorted((name, repr(value)) for name, value in kernel.targetoptions.items())
    yield repr((name_of(kernel), function.__code__.co_filename, flags)).encode()
    yield from _code(function.__code__)
    for name, value in sorted(surroundings(function).items()):
        yield name.encode()
        yield from _value(value, seen)


def _code(code: types.CodeType) -> Iterator[bytes]:
    yield code.co_code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _code(constant)
        else:
            yield repr(constant).encode()


def _value(value: Any, seen: set[int]) -> Iterator[bytes]:
    if hasattr(value, "py_func"):
        if id(value.py_func) not in seen:
            yield from _parts(value, seen)
    elif isinstance(value, np.ndarray):
        yield repr((value.dtype, value.shape)).encode() + value.tobytes()
    elif isinstance(value, int | float | complex | str | bytes | tuple | frozenset | None):
        yield repr(value).encode()
    else:
        yield getattr(value, "__name__", type(value).__name__).encode()


def _digest_of(path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return ""
