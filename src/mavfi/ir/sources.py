"""IR of kernels as in a fresh process, and machine code of rewritten ones, cached on disk next to Numba's own cache.

The key of an entry covers what the kernel's machine code depends on, and the versions; an entry with line tables is
valid while every source file in them is unchanged.
"""

import contextlib
import hashlib
import json
import os
import re
import sys
import zlib
from collections.abc import Iterable
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np

from mavfi.ir.build import KernelSource, name_of, run_in_fresh_process, source_of
from mavfi.ir.module import Module, digest_of
from mavfi.ir.parser import parse_module
from mavfi.numerics.dependencies import UnknownDependencyError, content_digest, signature_digest
from mavfi.numerics.jit import code_folder

Shape = tuple[str, list[list[int]]]
"""What a plan must fit: see `shape_of`."""
_FILE = re.compile(r'!DIFile\(filename: "([^"]*)", directory: "([^"]*)"')
"""A source file in the metadata of a module."""


def cached_source(kernel: Any, signature: tuple[Any, ...]) -> KernelSource:
    """IR of a kernel for a signature.

    Raises:
        NotInstrumentableError: It is not compiled, or with flags that prevent exact replay.
        BuildError: The compiler crashed.
    """
    cache = ObjectCache("source", Path(__file__).parent)
    key = cache.key(kernel, signature)
    data = cache.load(key)
    if data is None:
        data = run_in_fresh_process(kernel, signature, make)
        cache.store(key, data, _files(_unpack(data)))
    return _unpack(data)


def shape_of(module: Module) -> Shape:
    """Digest of a module, and the number of sites by function and block."""
    return digest_of(module), [[len(block.sites) for block in function.blocks] for function in module.functions]


def cached_shape(kernel: Any, signature: tuple[Any, ...]) -> Shape:
    """`shape_of` a kernel's IR, without parsing it again; raises the errors of `cached_source`."""
    cache = ObjectCache("shape", Path(__file__).parent)
    key = cache.key(kernel, signature)
    data = cache.load(key)
    if data is None:
        source = cached_source(kernel, signature)
        data = json.dumps(shape_of(parse_module(source.text, source.kernel))).encode()
        cache.store(key, data, ())  # source lines are not part of it
    digest, sizes = json.loads(data)
    return digest, sizes


def make(kernel: Any, signature: tuple[Any, ...]) -> bytes:
    """The part of `cached_source` that runs in another process."""
    return zlib.compress(json.dumps(astuple(source_of(kernel, signature))).encode(), 1)


def _unpack(data: bytes) -> KernelSource:
    """Inverse of `make`."""
    return KernelSource(*json.loads(zlib.decompress(data)))


def _files(source: KernelSource) -> list[str]:
    """Paths of the source files in its line tables."""
    return [os.path.join(folder, name) for name, folder in _FILE.findall(source.text)]


# ---- entries on disk ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ObjectCache:
    """A folder of entries.

    Attributes:
        folder: Name of the folder.
        package: Folder of the modules that make the code; a change of their text invalidates all entries.
    """

    folder: str
    package: Path

    def key(self, kernel: Any, signature: tuple[Any, ...], *inputs: bytes) -> str:
        """Digest of all inputs of the machine code, except line tables; `more` are further inputs.

        A kernel that uses values of an unknown kind has a key of its own in each process.
        """
        versions = numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:2]
        digest = hashlib.sha256(repr((versions, name_of(kernel), kernel.py_func.__code__.co_filename)).encode())
        try:
            digest.update(signature_digest(signature) + content_digest(kernel))
        except UnknownDependencyError:
            digest.update(os.urandom(32))
        for part in (folder_text(Path(__file__).parent), folder_text(self.package), *inputs):
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
        numba_folder = Path(numba.__file__).parent  # its files are covered by Numba's version
        digests = {
            file: _digest_of(file)
            for file in sorted(files)
            if os.path.isfile(file) and numba_folder not in Path(file).parents
        }
        sources = json.dumps(digests).encode()
        body = len(sources).to_bytes(8, "little") + sources + data
        path = self._path(key)
        unfinished = path.with_suffix(f".{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished.write_bytes(hashlib.sha256(body).digest() + body)
            unfinished.replace(path)
        except OSError:
            with contextlib.suppress(OSError):
                unfinished.unlink()

    def _path(self, key: str) -> Path:
        return code_folder() / self.folder / f"{key}.bin"


@cache
def folder_text(package: Path) -> bytes:
    """Text of all modules of a package's folder."""
    return b"".join(path.read_bytes() for path in sorted(package.glob("*.py")))


def _digest_of(path: str) -> str:
    """SHA-256 of a file; "" if it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return ""
