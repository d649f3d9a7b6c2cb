"""IR of kernels as in a fresh process, cached on disk: what is analysed, protected and timed."""

import json
import os
import re
import zlib
from dataclasses import astuple
from pathlib import Path
from typing import Any

from mavfi.ir.build import Source, build_apart, source_of
from mavfi.ir.digest import digest_of
from mavfi.ir.module import Module
from mavfi.ir.object_cache import ObjectCache
from mavfi.ir.parser import parse_module

Shape = tuple[str, list[list[int]]]
"""What a plan must fit: see `shape_of`."""
_FILE = re.compile(r'!DIFile\(filename: "([^"]*)", directory: "([^"]*)"')


def cached_source(kernel: Any, signature: tuple[Any, ...]) -> Source:
    """IR of a kernel for a signature.

    Raises:
        RefusedError: It is not compiled, or with flags that prevent exact replay.
        BuildError: The compiler crashed.
    """
    cache = ObjectCache("source", Path(__file__).parent)
    key = cache.key(kernel, signature)
    data = cache.load(key)
    if data is None:
        data = build_apart(kernel, signature, make)
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


def _unpack(data: bytes) -> Source:
    return Source(*json.loads(zlib.decompress(data)))


def _files(source: Source) -> list[str]:
    return [os.path.join(folder, name) for name, folder in _FILE.findall(source.text)]
