"""The only place where Numba flags are set, and where compiled code is kept.

`fastmath` would remove NaN guards and break replay, the default error model would raise where C++ yields an
infinity, and `parallel` would reorder sums: none of them is available here (see docs/fault-model.md).

Numba's cache looks at the file of a function, not at those of the functions that it calls: after a change in one
module, callers in others would keep the old code.  So the cache lies in a folder that is named after the text of
all compiled modules.  Nor has it an index of the signatures of a function: of two processes that compile at the same
time, one would overwrite the other's entry.
"""

import contextlib
import functools
import hashlib
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import types
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler import Compiler
from numba.core.errors import NumbaDebugInfoWarning
from numba.core.registry import CPUDispatcher

F = TypeVar("F", bound=Callable[..., object])

_COMPILED = ("numerics", "kernels", "sim", "detectors")
"""Packages of mavfi that hold compiled functions."""
_KEPT = 4
_FLAGS = {"nopython": True, "error_model": "numpy", "fastmath": False, "nogil": True, "boundscheck": None}


@functools.cache
def code_folder() -> Path:
    """Where code compiled from the present text of the package is kept."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for name in _COMPILED:
        for path in sorted((package / name).rglob("*.py")):
            digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return _cache_root() / digest.hexdigest()[:16]


def _cache_root() -> Path:
    """`$XDG_CACHE_HOME/mavfi` or `~/.cache/mavfi`; without a home directory, a private folder in the temporary one.

    Cached code is executed, so a folder that other users can write is not used.
    """
    given = os.environ.get("XDG_CACHE_HOME")
    with contextlib.suppress(RuntimeError):  # neither HOME nor an entry in the list of users
        return (Path(given) if given else Path.home() / ".cache") / "mavfi"
    own = Path(tempfile.gettempdir()) / f"mavfi-{os.getuid()}"
    with contextlib.suppress(OSError):
        own.mkdir(mode=0o700, exist_ok=True)
        held = own.lstat()
        if stat.S_ISDIR(held.st_mode) and held.st_uid == os.getuid() and not held.st_mode & 0o022:
            return own
    return Path(os.devnull) / "mavfi"  # cannot be created: no cache


def _use_cache(folder: Path) -> None:
    """Keep compiled code in a folder, and forget all but the last few other ones."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        others = sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
    except OSError:
        return  # Numba then keeps it next to the source, or nowhere
    for stale in others[_KEPT:]:
        shutil.rmtree(stale, ignore_errors=True)
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]


if not numba.config.CACHE_DIR:  # type: ignore[attr-defined]
    _use_cache(code_folder())


class LineTables(Compiler):
    """Numba's own pipeline, with line tables: IR and debuggers know source lines, the machine code stays as it was.

    `debug=True` would switch optimisations off.  It is what `lineinfo=True` uses on GPUs.
    """

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[no-untyped-call]
        self.state.targetctx = self.state.targetctx.subtarget(enable_debuginfo=True)
        self.state.flags.dbg_directives_only = True

    def compile_extra(self, func: Callable[..., object]) -> object:
        """Compile; functions that Numba makes up (array expressions) have no source, which is as it should be."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NumbaDebugInfoWarning)
            return super().compile_extra(func)  # type: ignore[no-untyped-call]


class SignatureFiles(IndexDataCacheFile):
    """Code on disk, one file for each signature: loaded code does not depend on other compilations."""

    @staticmethod
    def in_place_of(files: Any) -> "SignatureFiles":
        """The same place and source, without the index."""
        base = files._index_name.removesuffix(".nbi")
        return SignatureFiles(files._cache_path, base, files._source_stamp)  # type: ignore[no-untyped-call]

    def save(self, key: Any, data: Any) -> None:
        """Keep the code of a signature; a file of another source or version of Numba is replaced."""
        self._save_data(self._name(key), (self._version, self._source_stamp, key, data))  # type: ignore[no-untyped-call]

    def load(self, key: Any) -> Any:
        """The code of a signature; None = there is none of this source and version of Numba."""
        try:
            version, stamp, kept, data = self._load_data(self._name(key))  # type: ignore[no-untyped-call]
        except FileNotFoundError:
            return None
        return data if (version, stamp, kept) == (self._version, self._source_stamp, key) else None

    def _name(self, key: Any) -> str:
        return f"{self._index_name.removesuffix('.nbi')}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"


class Kernel(CPUDispatcher):
    """A function that is compiled once for all kinds of integers.

    For `f(x, 0)` in compiled code Numba compiles `f` for the literal 0, beside its versions for int32 and int64.
    """

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Template of a call: literals are numbers, integers that fit into 64 bits with a sign have those."""
        named = {name: _wide(type_) for name, type_ in kws.items()}
        return super().get_call_template(tuple(map(_wide, args)), named)


def _wide(type_: Any) -> Any:
    plain: Any = types.unliteral(type_)  # type: ignore[no-untyped-call]
    return types.int64 if plain in types.integer_domain - {types.uint64} else plain


def kernel_jit(function: F) -> F:
    """Compile a numeric function: cached on disk, IEEE division, no fast math, GIL released, with line tables.

    Args:
        function: A function of arrays, scalars and named tuples.

    Returns:
        The compiled dispatcher; the pure Python function is `function.py_func`.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    compiled: Any = Kernel(py_func=function, targetoptions=dict(_FLAGS), pipeline_class=LineTables)
    with contextlib.suppress(RuntimeError):  # no writable cache folder
        compiled.enable_caching()
        compiled._cache._cache_file = SignatureFiles.in_place_of(compiled._cache._cache_file)
    return cast(F, compiled)


def entry(function: F, *arguments: Any) -> F:  # noqa: ANN401 - examples, of which the types count
    """Machine code of a function for arguments of the types of these, to be called with such alone.

    A dispatcher looks up the types of its arguments at each call, which takes longer than short functions do.  What is
    no dispatcher (plain Python, an instrumented function) is given back as it is.
    """
    if not isinstance(function, Kernel):
        return function
    return cast(F, function.compile(tuple(map(numba.typeof, arguments))))


def uncached_copy(dispatcher: Any) -> Any:
    """A dispatcher of the same function with the same flags that has its IR, which code loaded from a cache lacks."""
    flags, locals_ = dict(dispatcher.targetoptions), dict(dispatcher.locals)
    return Kernel(dispatcher.py_func, locals_, flags, pipeline_class=LineTables)
