"""Small C programs to inject; compiled once."""

import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAMS = Path(__file__).parent / "programs"
COMPILER = shutil.which("cc") or shutil.which("gcc")


class Targets:
    """Compiles programs, starts them, and ends those that are left."""

    def __init__(self, folder):
        self._folder = folder
        self.running = []

    def start(self, name, *flags):
        binary = self._folder / f"{name}{''.join(flags)}"
        if not binary.exists():
            source = PROGRAMS / f"{name}.c"
            subprocess.run([COMPILER, "-O1", "-pthread", *flags, "-o", binary, source], check=True, timeout=60)
        target = subprocess.Popen([binary], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.running.append(target)
        return target, target.stdout.readline().strip()


@pytest.fixture(scope="session")
def _folder(tmp_path_factory):
    return tmp_path_factory.mktemp("programs")


@pytest.fixture
def targets(_folder):
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        pytest.skip("registers are injected on x86-64 Linux")
    if COMPILER is None:
        pytest.skip("no C compiler to make targets with")
    started = Targets(_folder)
    yield started
    for target in started.running:
        target.kill()
        target.communicate()


@pytest.fixture
def spin(targets):
    target, _ = targets.start("spin")
    return target
