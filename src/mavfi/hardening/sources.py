"""IR of kernels as in a fresh process, cached on disk: what is analysed, protected and timed."""

import json
import os
import re
import zlib
from dataclasses import astuple
from pathlib import Path
from typing import Any

from mavfi.ir.build import Source, build_apart, source_of
from mavfi.ir.object_cache import ObjectCache

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


def make(kernel: Any, signature: tuple[Any, ...]) -> bytes:
    """The part of `cached_source` that runs in another process."""
    return zlib.compress(json.dumps(astuple(source_of(kernel, signature))).encode(), 1)


def _unpack(data: bytes) -> Source:
    return Source(*json.loads(zlib.decompress(data)))


def _files(source: Source) -> list[str]:
    return [os.path.join(folder, name) for name, folder in _FILE.findall(source.text)]
