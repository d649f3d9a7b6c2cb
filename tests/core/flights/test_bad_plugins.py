"""Users' own parts that fail during a flight: one line that names them, and exit code 2."""

import sys
from types import SimpleNamespace

import pytest

from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.flight.fly import fly
from tests.core.flights.missions import mission

_MODULE = """
from mavfi.detectors import Alarm, Detector
from mavfi.numerics.random import seed_generator


class Raises(Detector):
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


class Misspelt(Raises):
    states = {"planning.waypont", "control.command"}


class OneName(Raises):
    states = "control.command"


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


def _told(capsys):
    """Lines on stderr, without the one about an empty cache."""
    return [line for line in capsys.readouterr().err.splitlines() if not line.startswith("compiling kernels")]


FLY = ["fly", "--environment", "sparse", "--seed", "7"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--detector", "bad_parts:Raises"], ":Raises: ZeroDivisionError: division by zero (bad_parts.py:11, check)"),
        (["--planner", "bad_parts:Boom"], "bad_parts:Boom: ValueError: no way (bad_parts.py:45, search)"),
        (
            ["--detector", "bad_parts:Wrong"],
            "detector bad_parts:Wrong: check returned True; allowed: an Alarm, or None",
        ),
        (
            ["--detector", "bad_parts:Sensing"],
            "detector bad_parts:Sensing: alarm 'x': stage 'sensor': cannot be run again; allowed: perception, planning",
        ),
        (
            ["--detector", "bad_parts:Misspelt"],
            "detector bad_parts:Misspelt: states: 'planning.waypont': no such state (did you mean 'planning.waypoint'",
        ),
        (
            ["--detector", "bad_parts:OneName"],
            "detector bad_parts:OneName: states: 'control.command': allowed: a set of names of states, or None",
        ),
        (
            ["--planner", "bad_parts:Text"],
            "planner bad_parts:Text: search returned 'a path'; allowed: an array of shape (n, 3)",
        ),
    ],
)
def test_a_part_that_fails_in_flight_is_one_line(folder, capsys, arguments, message):
    assert run([*FLY, *arguments]) == 2
    (line,) = _told(capsys)
    assert message in line


def test_the_traceback_precedes_the_line_on_request(folder, capsys, monkeypatch):
    monkeypatch.setenv("MAVFI_TRACEBACK", "1")
    assert run([*FLY, "--detector", "bad_parts:Raises"]) == 2
    *lines, last = _told(capsys)
    assert any(line.startswith("Traceback") for line in lines)
    assert any('bad_parts.py", line 11, in check' in line for line in lines)
    assert "ZeroDivisionError: division by zero" in lines
    assert last.startswith("mavfi: bad_parts:Raises: ZeroDivisionError")


def test_an_object_that_lists_a_state_that_does_not_exist_is_refused_too():
    detector = SimpleNamespace(states={"x"}, start=print, check=print, accept=print)
    with pytest.raises(BadInputError, match=r"SimpleNamespace: states: 'x': no such state; `mavfi states` lists all$"):
        fly(mission(), detector=detector)
