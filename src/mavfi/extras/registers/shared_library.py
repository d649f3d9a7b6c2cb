"""Shared libraries that other programs load, compiled at first use with the machine's C compiler.

They are not shipped built: mavfi's wheel has no machine code, so that one wheel serves every machine.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError, writing

_COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-shared", "-fPIC", "-O2", "-Wall")


def shared_library(
    source: Path, user: str, *, headers: Sequence[Path] = (), flags: Sequence[str] = (), libraries: Sequence[str] = ()
) -> Path:
    """The library of a C file, in the user's cache; its name contains the digest of sources and flags.

    Args:
        source: The C file.
        user: Who needs it, for the message if there is no compiler.
        headers: Files that it includes.
        flags: Further flags of the compiler.
        libraries: Options of the linker, e.g. "-ldl".

    Raises:
        BadInputError: There is no C compiler.
        MavfiError: It fails; the message has its last line.
    """
    options = [*_FLAGS, *flags]
    content = b"".join(path.read_bytes() for path in (source, *headers)) + " ".join([*options, *libraries]).encode()
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mavfi" / "libraries"
    library = cache / f"libmavfi-{source.stem}-{hashlib.sha256(content).hexdigest()[:16]}.so"
    if library.exists():
        return library
    compiler = next((program for program in _COMPILERS if shutil.which(program)), None)
    if compiler is None:
        raise BadInputError(f"no C compiler (cc, gcc or clang), which {user} needs; e.g. apt install gcc")

    # compiled beside its final name, so that no other process loads a part of it
    with writing(cache):
        cache.mkdir(parents=True, exist_ok=True)
        descriptor, part = tempfile.mkstemp(dir=cache, suffix=".part")
        os.close(descriptor)
    command = [compiler, *options, "-o", part, str(source), *libraries]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    if compiled.returncode != 0:
        os.unlink(part)
        lines = compiled.stderr.strip().splitlines() or [f"exit code {compiled.returncode}"]
        raise MavfiError(f"{compiler}: cannot compile {source.name}: {lines[-1]}")
    os.chmod(part, 0o755)
    os.rename(part, library)
    return library
