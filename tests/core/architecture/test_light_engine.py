"""What a base installation can do: the engine needs none of the packages of the extra `report`, which say so."""

import subprocess
import sys

from tests.core.architecture.source import PACKAGE

ENGINE = ("campaign", "detectors", "faults", "flight", "ir", "kernels", "levels", "numerics", "pipeline", "sim")
PACKAGES = ("jinja2", "markupsafe", "matplotlib", "PIL", "polars", "scipy")
ABSENT = f"import sys; sys.modules.update(dict.fromkeys({PACKAGES}))"
"""As in an installation without the extra: importing any of these raises a ModuleNotFoundError."""


def run(code):
    return subprocess.run([sys.executable, "-c", f"{ABSENT}\n{code}"], capture_output=True, text=True, check=False)


def test_the_engine_imports_only_base_dependencies():
    paths = [path for folder in ENGINE for path in sorted((PACKAGE / folder).rglob("*.py"))]
    paths += sorted(PACKAGE.glob("*.py"))
    names = [".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts) for path in paths]
    imported = run(f"import importlib\nfor name in {names}: importlib.import_module(name.removesuffix('.__init__'))")
    assert imported.returncode == 0, imported.stderr


def test_reports_name_the_extra_that_they_need():
    done = run("from mavfi.cli import run\nsys.exit(run(['report', 'out']))")
    assert done.returncode == 2
    assert done.stderr.endswith(": needs polars; install it with: pip install 'mavfi[report]'\n")
    assert done.stderr.count("\n") == 1
