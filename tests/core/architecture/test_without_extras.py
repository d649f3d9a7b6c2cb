"""The core without its extras: their folder and entry points deleted from a copy, it passes its tests there."""

import os
import re
import shutil
import subprocess
import sys
import tomllib

import pytest

from mavfi.version import __version__
from tests.core.architecture.source import ROOT

CHOSEN = (
    "tests/core/unit/analysis", "tests/core/unit/campaign", "tests/core/unit/cli", "tests/core/unit/faults",
    "tests/core/unit/levels", "tests/core/unit/report", "tests/core/unit/test_*.py",
    "tests/core/architecture/test_code.py",
)  # fmt: skip
"""Tests of what extras plug into, as far as they are fast."""
OF_EXTRAS = re.compile(r"\b(mavfi|tests)[./]extras\b")


ELSEWHERE = re.compile(rf"{OF_EXTRAS.pattern}|^from (benchmarks|tools)\b", re.MULTILINE)


def without_extras(target):
    """Copy package, configurations and tests without extras; the metadata of the copy has the core's entry points."""
    ignored = shutil.ignore_patterns("extras", "__pycache__", "nightly")
    shutil.copytree(ROOT / "src", target / "src", ignore=ignored)
    shutil.copytree(ROOT / "tests" / "core", target / "tests" / "core", ignore=ignored)
    for path in (ROOT / "tests").glob("*.py"):
        shutil.copy(path, target / "tests")
    (target / "configs").symlink_to(ROOT / "configs")
    shutil.copy(ROOT / "pyproject.toml", target)
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{name} = {at}" for name, at in points.items() if not OF_EXTRAS.search(at))]
    information = target / "src" / f"mavfi-{__version__}.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: mavfi\nVersion: {__version__}\n", "utf-8")
    (information / "entry_points.txt").write_text("\n".join(lines) + "\n", "utf-8")


def chosen(target):
    """Files of the chosen tests that do not use an extra."""
    for pattern in CHOSEN:
        for path in sorted(target.glob(pattern)):
            for file in sorted(path.rglob("test_*.py")) if path.is_dir() else [path]:
                if not ELSEWHERE.search(file.read_text(encoding="utf-8")):
                    yield str(file.relative_to(target))


@pytest.mark.slow
def test_the_core_passes_its_tests_without_extras(tmp_path):
    without_extras(tmp_path)
    environment = os.environ | {"PYTHONPATH": f"{tmp_path / 'src'}{os.pathsep}{tmp_path}"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow and not long"]
    done = subprocess.run(
        [*command, *chosen(tmp_path)], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
