"""Whoever runs the tests with make sees which were skipped, and why."""

import os
import subprocess
import sys

import pytest

from tests.core.architecture.source import ROOT

TARGETS = ("test", "check")
TESTS = """
import pytest
@pytest.mark.skipif(True, reason="no such program here")
def test_of_a_program(): pass
def test_that_fails(): assert False
def test_that_passes(): pass
"""


@pytest.fixture(scope="module")
def commands():
    """The options of each call of pytest by these targets."""
    outside = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    done = subprocess.run(
        ["make", "--dry-run", *TARGETS], cwd=ROOT, env=outside, capture_output=True, text=True, check=True
    )
    pytest_options = [
        line.partition(" -m pytest ")[2].split() for line in done.stdout.splitlines() if " -m pytest " in line
    ]
    assert len(pytest_options) == len(TARGETS)
    return pytest_options


def test_skipped_tests_are_named_with_their_reasons_and_failed_ones_too(commands, tmp_path):
    (tmp_path / "test_some.py").write_text(TESTS, encoding="utf-8")
    options = {option for command in commands for option in command if option.startswith("-r")}
    assert len(options) == 1 and all(options <= set(command) for command in commands), "in every target alike"
    pytest_arguments = [
        "-c",
        os.devnull,
        "--rootdir",
        str(tmp_path),
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        *options,
    ]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *pytest_arguments, "test_some.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    summary = run.stdout.partition("short test summary info")[2]
    assert "SKIPPED [1] test_some.py:" in summary and "no such program here" in summary
    assert "FAILED test_some.py::test_that_fails" in summary and "test_that_passes" not in summary
