"""Imports what mavfi's commands import, so that Python keeps the bytecode (`make setup`).

The packages are installed without bytecode: most of their modules are never imported.  Where `PYTHONDONTWRITEBYTECODE`
is set, as in many containers, those that are would then be compiled at each start.
"""

import ast
import warnings
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "src" / "mavfi"
_PROGRAM = "__main__"


def imported_names(path: Path) -> Iterator[str]:
    """Modules that a file imports, at its beginning or in a function."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module


def main() -> None:
    """Import all of them; what is not installed is left out."""
    names: set[str] = set()
    for path in PACKAGE.rglob("*.py"):
        names.update(imported_names(path))
    for name in sorted(names):
        if not name.endswith(_PROGRAM):
            with warnings.catch_warnings(), suppress(Exception):
                warnings.simplefilter("ignore")
                import_module(name)

    # what Numba imports when it compiles for the first time
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


if __name__ == "__main__":
    main()
