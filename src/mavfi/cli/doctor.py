"""`mavfi doctor`: what is here, what is missing, and the way out; `mavfi cache`: what mavfi has compiled."""

import importlib.util
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from mavfi.cli.commands import EXIT_DONE, EXIT_FAILURE
from mavfi.cli.console import console, counted
from mavfi.errors import packages_by_extra
from mavfi.plugins import extensions

HELP_PANEL = "Tools"
CHECKS = "mavfi.checks"
"""Group of entry points: functions without arguments that return the `Check`s of an extra."""
_LEAST_FREE = 1 << 30
"""Free disk space (bytes) below which a campaign may not find room for its ledger."""
_MARKS = {True: Text("✓", "green"), False: Text("–", "yellow")}
_NOT_AN_EXTRA = "dev"
"""Packages for work on mavfi itself."""


@dataclass(frozen=True, slots=True)
class Check:
    """What was found out about one thing.

    Attributes:
        name: The thing.
        is_here: Whether it is there and can be used.
        state: What there is, or the way out if it is missing, in at most 60 characters.
        is_needed: Whether nothing flies without it.
    """

    name: str
    is_here: bool
    state: str
    is_needed: bool = False


def doctor() -> int:
    """Say what flights need, what is missing, and how to get it.

    Exit code 1 if flights cannot work.

    Example: [bold]mavfi doctor[/bold]
    """
    checks = [_compiler(), _cache(), _bytecode(), _disk(), _extras()]
    for of_extra in extensions(CHECKS).values():
        checks += of_extra()

    # the answer first
    out = console()
    broken = [check for check in checks if check.is_needed and not check.is_here]
    missing = [check for check in checks if not check.is_needed and not check.is_here]
    if broken:
        out.print(f"Flights cannot work: {', '.join(check.name for check in broken)}.")
    elif missing:
        verb = "are"
        if len(missing) == 1:
            verb = "is"
        things = counted(len(missing), "optional thing")
        out.print(f"Everything that flights need is here; {things} {verb} missing.")
    else:
        out.print("Everything is here.")
    table = Table(box=None, show_header=False, padding=(0, 1, 0, 1))
    for check in checks:
        mark = _MARKS[check.is_here]
        if check in broken:
            mark = Text("✗", "red")
        table.add_row(mark, check.name, Text(check.state))
    out.print(table)
    if broken:
        return EXIT_FAILURE
    return EXIT_DONE


def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Delete it; the next flight compiles again.")] = False,
) -> None:
    """Say where mavfi's compiled code is, and how large it is.

    Example: [bold]mavfi cache --clear[/bold]
    """
    from mavfi.numerics.jit import code_folder

    folder = code_folder()
    files = list(_files_of_ours(folder))
    if not clear:
        typer.echo(f"{folder}: {_size(files)}")
        return
    size = _size(files)
    for file in files:
        file.unlink(missing_ok=True)
    typer.echo(f"{folder}: deleted {size}")


_OURS = ("*.nbc", "*.bin", "*.warm", "*.lock", "*.nbc.*", "*.bin.*")
"""Names of the files that mavfi writes into the folder of compiled code; the last ones are left of a killed process."""


def _files_of_ours(folder: Path) -> Iterator[Path]:
    """The files that mavfi has written into its folder of compiled code."""
    unique = {path for pattern in _OURS for path in folder.rglob(pattern) if path.is_file()}
    yield from sorted(unique)


def _size(files: Iterable[Path]) -> str:
    """Number and size of files, as text."""
    sizes = [file.stat().st_size for file in files]
    return f"{counted(len(sizes), 'file')}, {sum(sizes) / 1e6:.1f} MB"


# ---- what the core needs --------------------------------------------------------------------------------------------
def _compiler() -> Check:
    """Numba and LLVM, which compile the kernels."""
    try:
        import llvmlite.binding
        import numba
    except (ImportError, OSError) as error:
        return Check("compiler", False, f"cannot be loaded: {error}; reinstall numba", is_needed=True)
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return Check("compiler", False, "switched off, flights take hours: unset NUMBA_DISABLE_JIT")
    llvm = ".".join(map(str, llvmlite.binding.llvm_version_info))
    return Check("compiler", True, f"numba {numba.__version__}, LLVM {llvm}", is_needed=True)


def _cache() -> Check:
    """The folder of compiled code."""
    from mavfi.numerics.jit import code_folder

    folder = code_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return Check("cache", False, "cannot be written, compiles each time: set XDG_CACHE_HOME")
    return Check("cache", True, _size(_files_of_ours(folder)))


def _bytecode() -> Check:
    """Modules of mavfi that are compiled once, not at each start."""
    from mavfi.numerics import jit

    compiled = Path(importlib.util.cache_from_source(jit.__file__))
    if compiled.is_file() or not sys.dont_write_bytecode:
        return Check("bytecode", True, "kept")
    package = Path(jit.__file__).parents[1]
    return Check("bytecode", False, f"starts take longer: python -m compileall -q {package}")


def _disk() -> Check:
    """Free space in the working directory, where ledgers are written."""
    free = shutil.disk_usage(Path.cwd()).free
    state = f"{free / 1e9:.1f} GB free in this folder"
    if free < _LEAST_FREE:
        return Check("disk", False, f"{state}: campaigns may not find room")
    return Check("disk", True, state)


def _extras() -> Check:
    """Optional packages, by extra."""
    missing = set()
    for extra, packages in packages_by_extra().items():
        for package in packages:
            try:
                distribution(package)
            except PackageNotFoundError:
                missing.add(extra)
    missing.discard(_NOT_AN_EXTRA)
    if missing:
        return Check("extras", False, f"pip install 'mavfi[{','.join(sorted(missing))}]'")
    return Check("extras", True, "all installed")
