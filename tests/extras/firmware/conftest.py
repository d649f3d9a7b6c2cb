"""A miniature firmware, compiled once: the lock-step is tested without Betaflight."""

import shutil
import subprocess
from contextlib import closing
from pathlib import Path

import pytest

from mavfi.extras.firmware import build
from mavfi.extras.firmware.process import Firmware

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def programs(tmp_path_factory):
    """The miniature firmware and the shim."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    binary = tmp_path_factory.mktemp("mini") / "betaflight_0.0.0_SITL"
    subprocess.run(["gcc", "-O1", "-pthread", "-o", binary, HERE / "mini.c"], check=True)
    return binary, build.shim()


@pytest.fixture
def firmware(programs):
    """A miniature firmware at its first instant."""
    with closing(Firmware(*programs, {})) as running:
        running.wait()
        yield running
