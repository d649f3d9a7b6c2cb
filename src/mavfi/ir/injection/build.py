"""Builds the instrumented variant of a kernel, or loads it from the cache."""

import inspect
import json
import zlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mavfi.ir.build import KernelSource, Rewrite, run_in_fresh_process, translate
from mavfi.ir.injection.accesses import Constant
from mavfi.ir.injection.instrument import Instrumented, instrument, optimised
from mavfi.ir.injection.table import SiteTable
from mavfi.ir.sources import ObjectCache, cached_source, folder_text


@dataclass(frozen=True, slots=True)
class Built:
    """An instrumented kernel: object files, and the other attributes as in `Instrumented`.

    Python calls the function `wrapper`; the global `environment` points to Numba's environment of the kernel.
    """

    code: bytes
    tally: bytes
    table: SiteTable
    ir_sha256: str
    constants: tuple[Constant, ...]
    owned: bool
    wrapper: str
    environment: str

    def pack(self) -> bytes:
        """Serialize to bytes."""
        constants = [[constant.name, constant.address, constant.size] for constant in self.constants]
        facts = [self.table.to_json(), self.ir_sha256, constants, self.owned, self.wrapper, self.environment]
        head = zlib.compress(json.dumps(facts).encode(), 1)
        return b"".join(len(part).to_bytes(8, "little") + part for part in (head, self.tally, self.code))

    @staticmethod
    def unpack(data: bytes) -> "Built":
        """Inverse of `pack`."""
        parts = []
        while data:
            size = 8 + int.from_bytes(data[:8], "little")
            parts.append(data[8:size])
            data = data[size:]
        head, tally, code = parts
        rows, digest, constants, owned, wrapper, environment = json.loads(zlib.decompress(head))
        return Built(
            code,
            tally,
            SiteTable.from_json(rows),
            digest,
            tuple(Constant(*constant) for constant in constants),
            owned,
            wrapper,
            environment,
        )


def cached_build(kernel: Any, signature: tuple[Any, ...], rewrite: Rewrite | None = None) -> Built:
    """The instrumented variant from the cache, or from `build` (whose errors it raises) if missing or invalid."""
    cache = ObjectCache("instruction", Path(__file__).parent)
    inputs: list[bytes] = []
    if rewrite is not None:
        inputs = [rewrite.key, folder_text(Path(inspect.getfile(type(rewrite))).parent)]
    key = cache.key(kernel, signature, *inputs)
    data = cache.load(key)
    if data is not None:
        return Built.unpack(data)
    built = build(kernel, signature, rewrite)
    cache.store(key, built.pack(), built.table.files())
    return built


def build(kernel: Any, signature: tuple[Any, ...], rewrite: Rewrite | None = None) -> Built:
    """Instrument a Numba dispatcher for one signature (Numba types of the arguments), rewritten before.

    Raises:
        NotInstrumentableError: An unknown construct.
        BuildError: The compiler crashed.
        BadInputError: `rewrite` was made for another module.
    """
    source = cached_source(kernel, signature)
    return Built.unpack(run_in_fresh_process(kernel, signature, partial(make, source=source, rewrite=rewrite)))


def make(kernel: Any, signature: tuple[Any, ...], source: KernelSource, rewrite: Rewrite | None = None) -> bytes:
    """The part of `build` that runs in another process, since LLVM aborts on a malformed module."""
    return assemble(instrument(source.text, source.kernel, rewrite), source).pack()


def assemble(instrumented: Instrumented, source: KernelSource) -> Built:
    """Translate instrumented IR into machine code."""
    return Built(
        translate(instrumented.text),
        translate(instrumented.tally, optimised),
        instrumented.table,
        instrumented.ir_sha256,
        instrumented.constants,
        instrumented.owned,
        source.wrapper,
        source.environment,
    )
