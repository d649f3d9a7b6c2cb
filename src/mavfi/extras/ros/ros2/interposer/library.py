"""The interposer as a shared library, compiled at first use with the machine's C compiler.

It is not shipped built: mavfi's wheel has no machine code, so that one wheel serves every machine; compiling takes half
a second, and a machine on which ROS nodes are developed has a compiler.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError

_SOURCES = ("interposer.c", "control.h", "introspection.h")
_FLAGS = ("-std=gnu11", "-O2", "-shared", "-fPIC", "-s", "-Wl,-Bsymbolic")
_LIBRARIES = ("-lpthread", "-ldl")
_COMPILERS = ("cc", "gcc", "clang")


@cache
def library() -> Path:
    """The compiled interposer, in the user's cache; its name contains the digest of its sources.

    Raises:
        BadInputError: There is no C compiler.
        MavfiError: It fails; the message has its last line.
    """
    folder = Path(__file__).parent
    content = b"".join((folder / name).read_bytes() for name in _SOURCES)
    digest = hashlib.sha256(content + " ".join(_FLAGS).encode()).hexdigest()[:16]
    cache_folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mavfi" / "ros2-interposer"
    path = cache_folder / f"libmavfi_ros2-{digest}.so"
    if path.exists():
        return path
    compiler = next((program for program in _COMPILERS if shutil.which(program)), None)
    if compiler is None:
        raise BadInputError(
            "no C compiler (cc, gcc or clang), which faults in ROS 2 messages need; e.g. apt install gcc"
        )

    # compiled beside its final name, so that nobody loads half of it
    cache_folder.mkdir(parents=True, exist_ok=True)
    descriptor, part = tempfile.mkstemp(dir=cache_folder, suffix=".part")
    os.close(descriptor)
    command = [compiler, *_FLAGS, "-o", part, str(folder / _SOURCES[0]), *_LIBRARIES]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    if compiled.returncode != 0:
        os.unlink(part)
        lines = compiled.stderr.strip().splitlines() or [f"exit code {compiled.returncode}"]
        raise MavfiError(f"{compiler}: cannot compile the ROS 2 interposer: {lines[-1]}")
    os.chmod(part, 0o755)
    os.rename(part, path)
    return path
