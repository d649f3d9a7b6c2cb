"""Stores machine code of rewritten kernels on disk, next to Numba's own cache.

The key covers what the kernel's machine code depends on, and the versions; an entry with line tables is valid while
every source file in them is unchanged.
"""

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np

from mavfi.ir.build import name_of
from mavfi.numerics.dependencies import UnknownDependencyError, content_digest, signature_digest
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
        """Digest of all inputs of the machine code, except line tables; `more` are further inputs.

        A kernel that uses values of an unknown kind has a key of its own in each process.
        """
        versions = numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:2]
        digest = hashlib.sha256(repr((versions, name_of(kernel), kernel.py_func.__code__.co_filename)).encode())
        try:
            digest.update(signature_digest(signature) + content_digest(kernel))
        except UnknownDependencyError:
            digest.update(os.urandom(32))
        for part in (folder_text(Path(__file__).parent), folder_text(self.package), *more):
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


def _digest_of(path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return ""
