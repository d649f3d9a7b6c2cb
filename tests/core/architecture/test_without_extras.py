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
    "analysis/test_runs.py",
    "campaign/test_config.py",
    "cli/test_app.py",
    "cli/test_options.py",
    "levels/test_contracts.py",
    "levels/test_text.py",
    "test_files.py",
    "test_plugins.py",
)
"""Fast tests of what extras plug into, in tests/core/unit."""
WITH_EXTRAS = {
    "campaign/test_config.py": (
        "test_shipped_campaigns_are_valid_and_survive_the_ledger",
        "test_mistakes_are_named_when_the_file_is_read",
    ),
    "levels/test_text.py": ("test_errors_are_one_line_that_says_what_is_allowed",),
    "test_files.py": ("test_a_name_that_is_too_long_is_one_line",),
    "test_plugins.py": ("test_a_level_of_an_extra_that_is_not_installed_is_refused_with_the_command",),
}
"""Tests among them that use levels, hosts, views or commands of extras by their names."""
OF_EXTRAS = re.compile(r"\b(mavfi|tests)[./]extras\b")


def without_extras(target):
    """Copy package, configurations and tests without extras; the metadata of the copy has the core's entry points."""
    ignored = shutil.ignore_patterns("extras", "__pycache__", "nightly")
    shutil.copytree(ROOT / "src", target / "src", ignore=ignored)
    shutil.copytree(ROOT / "tests" / "core", target / "tests" / "core", ignore=ignored)
    for path in (ROOT / "tests").glob("*.*"):
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


@pytest.mark.slow
def test_the_core_passes_its_tests_without_extras(tmp_path):
    without_extras(tmp_path)
    environment = os.environ | {"PYTHONPATH": f"{tmp_path / 'src'}{os.pathsep}{tmp_path}"}
    unit = tmp_path / "tests" / "core" / "unit"
    files = [str(file.relative_to(tmp_path)) for pattern in CHOSEN for file in sorted(unit.glob(pattern))]
    left_out = [f"--deselect=tests/core/unit/{file}::{name}" for file, names in WITH_EXTRAS.items() for name in names]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not long"]
    done = subprocess.run(
        [*command, *left_out, *files], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
