"""The lock file pins what pyproject.toml asks for, and says nothing about the machine on which it was made."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import mavfi
from mavfi.errors import missing_package
from tests.core.architecture.source import PACKAGE, ROOT, imports, modules

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LOCK = [
    line
    for line in (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
]


@pytest.mark.parametrize("line", LOCK)
def test_every_line_of_the_lock_is_a_name_and_one_version(line):
    assert re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.!+-]+", line)


EXTRAS = PROJECT["optional-dependencies"]
LOCKED = [
    wanted
    for wanted in [*PROJECT["dependencies"], *(wanted for extra in EXTRAS.values() for wanted in extra)]
    if not wanted.startswith("mavfi[")
]
"""What is asked for, all extras included."""


@pytest.mark.parametrize("wanted", LOCKED)
def test_the_lock_satisfies_every_requirement(wanted):
    requirement = Requirement(wanted)
    pinned = {canonicalize_name(name): version for name, version in (line.split("==") for line in LOCK)}
    assert requirement.specifier.contains(pinned[canonicalize_name(requirement.name)])


def test_the_version_is_in_the_changelog_and_the_citation():
    assert f"## [{mavfi.__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"version: {mavfi.__version__}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_wheel_has_what_html_pages_inline():
    folder = PACKAGE / "report" / "html"
    wanted = {path for path in folder.rglob("*") if path.suffix in (".j2", ".js", ".css", ".LICENSE")}
    builder = WheelBuilder(str(ROOT))
    packed = {Path(included.path) for included in builder.recurse_included_files()}
    assert len(wanted) > 10 and wanted <= packed


ELSEWHERE = ("extras/airsim/runner.py", "extras/ros/ros2/stack/driver.py", "extras/ros/ros2/stack/launcher.py")
"""Modules that run in the Python of a client program, or of ROS."""


def test_whatever_is_imported_is_asked_for():
    locked_names = {canonicalize_name(Requirement(wanted).name) for wanted in LOCKED}
    imported = {
        name.split(".")[0] for path, tree in modules().items() if path not in ELSEWHERE for name in imports(tree)
    }
    homes = {"foxglove": ["foxglove-sdk"], **packages_distributions()}  # of extras that may not be installed here
    of_ros = {name for name in imported if name == "rclpy" or name.endswith("_msgs")}  # see test_code.py
    foreign = imported - set(sys.stdlib_module_names) - {"mavfi"} - of_ros
    distributions = {name: {canonicalize_name(home) for home in homes.get(name, [name])} for name in foreign}
    assert {name for name, names in distributions.items() if not names & locked_names} == set()


@pytest.mark.parametrize(("module", "extra"), [("polars", "report"), ("sklearn", "train"), ("foxglove", "live")])
def test_a_missing_package_is_named_with_the_extra_that_brings_it(module, extra):
    missing = missing_package(ModuleNotFoundError(name=f"{module}.part"), "mavfi runs")
    assert re.fullmatch(rf"mavfi runs: needs [\w-]+; install it with: pip install 'mavfi\[{extra}\]'", str(missing))
    assert missing_package(ModuleNotFoundError(name="a_plug_in"), "mavfi runs") is None


def test_only_the_dask_executor_needs_the_extra_and_only_when_it_is_used():
    needing = {name for name, tree in modules().items() if any("distributed" in imported for imported in imports(tree))}
    assert needing == {"extras/dask/executor.py"}
    code = "import sys, mavfi.cli, mavfi.extras.dask.executor; print('distributed' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
