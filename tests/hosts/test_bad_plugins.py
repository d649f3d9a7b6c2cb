"""Users' own parts that fail during a flight: one line that names them, and exit code 2."""

import sys

import pytest

from mavfi.cli import run

_MODULE = """
from mavfi.detectors import Alarm
from mavfi.numerics.random import seed_generator


class Raises:
    def start(self):
        pass

    def check(self, state, time_us):
        return 1 / 0

    def accept(self, state, time_us):
        pass


class Wrong(Raises):
    def check(self, state, time_us):
        return True


class Sensing(Raises):
    def check(self, state, time_us):
        return Alarm("x", stage="sensor")


class Text:
    def __init__(self, config, seed):
        self.random = seed_generator(seed, 1)

    def search(self, counter, grid, start, goal, lower, upper):
        return "a path"


class Boom(Text):
    def search(self, counter, grid, start, goal, lower, upper):
        raise ValueError("no\\nway")
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with the module `bad_parts`."""
    (tmp_path / "bad_parts.py").write_text(_MODULE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    sys.modules.pop("bad_parts", None)


FLY = ["fly", "--environment", "sparse", "--seed", "7"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--detector", "bad_parts:Raises"], ":Raises: ZeroDivisionError: division by zero (bad_parts.py:11, check)"),
        (["--planner", "bad_parts:Boom"], "bad_parts:Boom: ValueError: no way (bad_parts.py:37, search)"),
        (
            ["--detector", "bad_parts:Wrong"],
            "detector bad_parts:Wrong: check returned True; allowed: an Alarm, or None",
        ),
        (
            ["--detector", "bad_parts:Sensing"],
            "detector bad_parts:Sensing: alarm 'x': stage 'sensor': cannot be run again; allowed: perception, planning",
        ),
        (
            ["--planner", "bad_parts:Text"],
            "planner bad_parts:Text: search returned 'a path'; allowed: an array of shape (n, 3)",
        ),
    ],
)
def test_a_part_that_fails_in_flight_is_one_line(folder, capsys, arguments, message):
    assert run([*FLY, *arguments]) == 2
    stderr = capsys.readouterr().err
    assert message in stderr and stderr.count("\n") == 1


def test_the_traceback_precedes_the_line_on_request(folder, capsys, monkeypatch):
    monkeypatch.setenv("MAVFI_TRACEBACK", "1")
    assert run([*FLY, "--detector", "bad_parts:Raises"]) == 2
    first, *_, before, last = capsys.readouterr().err.splitlines()
    assert first.startswith("Traceback") and before == "ZeroDivisionError: division by zero"
    assert last.startswith("mavfi: bad_parts:Raises: ZeroDivisionError")
