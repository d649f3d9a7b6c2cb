import os
import subprocess
from pathlib import Path

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.paper import steps
from mavfi.extras.paper.report import step_table
from mavfi.extras.paper.steps import FILE, SET_UP, SET_UP_FILE, StepTimes, machine, program, set_up_seconds

MAKEFILE = Path(__file__).parents[3] / "Makefile"


@pytest.fixture(autouse=True)
def set_up_file(monkeypatch, tmp_path_factory):
    """Where `make setup` writes how long it took; absent at first."""
    path = tmp_path_factory.mktemp("environment") / SET_UP_FILE.name
    monkeypatch.setattr(steps, "SET_UP_FILE", path)
    return path


def test_times_of_a_resumed_study_add_up(tmp_path, monkeypatch):
    clock = iter([0.0, 2.0, 10.0, 15.0, 20.0, 21.0])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    first = StepTimes.begin(tmp_path, 2)
    with first.timed("compilation"):
        pass
    with pytest.raises(KeyboardInterrupt), first.timed("campaign table1"):
        raise KeyboardInterrupt
    second = StepTimes.begin(tmp_path, 1)
    assert second.seconds == {"compilation": 2.0, "campaign table1": 5.0}, "what was interrupted counts, too"
    with second.timed("compilation"):
        pass
    held = StepTimes.load(tmp_path)
    assert held.seconds == {"compilation": 3.0, "campaign table1": 5.0}
    assert [run["machine"] for run in held.runs] == [f"{machine()}, 2 workers", f"{machine()}, 1 worker"]
    assert {run["program"] for run in held.runs} == {program()} and program().startswith("mavfi ")


def test_without_a_file_there_are_none_and_a_damaged_one_is_named(tmp_path):
    assert StepTimes.load(tmp_path) == StepTimes(tmp_path)
    for text in ("{", "[]", '{"seconds": {"a": "x"}, "runs": []}', '{"seconds": {}, "runs": [{}]}'):
        (tmp_path / FILE).write_text(text, encoding="utf-8")
        with pytest.raises(BadInputError, match="steps.json: is not a file of wall times"):
            StepTimes.load(tmp_path)


def test_set_up_is_the_first_step_and_counts_once(tmp_path, set_up_file):
    clock = StepTimes.begin(tmp_path, 2)
    with clock.timed("compilation"):
        pass
    assert list(clock.seconds) == ["compilation"]
    set_up_file.write_text("63\n", encoding="utf-8")
    for _ in range(2):
        resumed = StepTimes.begin(tmp_path, 2)
        with resumed.timed("compilation"):
            pass
        held = StepTimes.load(tmp_path).seconds
        assert list(held) == [SET_UP, "compilation"] and held[SET_UP] == 63.0
    set_up_file.write_text("20\n", encoding="utf-8")
    assert StepTimes.begin(tmp_path, 2).seconds[SET_UP] == 63.0, "another environment has its own time"
    table = step_table(held, {})
    assert table.entries()[0]["step"] == SET_UP and any(note.startswith(SET_UP) for note in table.notes)
    assert not any(note.startswith(SET_UP) for note in step_table({"compilation": 1.0}, {}).notes)


@pytest.mark.parametrize("text", ["", "soon", "-3", "nan", "inf"])
def test_a_time_of_set_up_that_cannot_be_read_is_unknown(tmp_path, set_up_file, text):
    set_up_file.write_text(text, encoding="utf-8")
    assert set_up_seconds() is None and StepTimes.begin(tmp_path, 2).seconds == {}


PYTHON = """#!/bin/sh
case "$*" in
"-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
*"pip install"*) test ! -e stop ;;
esac
"""
DATE = """#!/bin/sh
echo $(( $(cat seconds) + 60 )) > seconds
cat seconds
"""
"""Programs in the place of the real ones: a minute has passed at each question for the time."""


@pytest.fixture
def make_setup(tmp_path):
    """`make setup` in a folder of its own, without packages; returns the exit code."""
    for name, content in (("python3", PYTHON), ("date", DATE)):
        (tmp_path / name).write_text(content, encoding="utf-8")
        (tmp_path / name).chmod(0o755)
    for name in ("requirements.lock", "pyproject.toml"):
        (tmp_path / name).touch()
    (tmp_path / "seconds").write_text("0", encoding="utf-8")
    outside = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    outside["PATH"] = f"{tmp_path}:{outside['PATH']}"

    def call():
        command = ["make", "-f", str(MAKEFILE), "setup", f"PYTHON={tmp_path / 'python3'}"]
        return subprocess.run(command, cwd=tmp_path, env=outside, check=False, capture_output=True).returncode

    return call


def test_make_setup_writes_how_long_it_took_if_it_made_the_environment(tmp_path, make_setup, monkeypatch):
    assert make_setup() == 0
    monkeypatch.setattr(steps, "SET_UP_FILE", tmp_path / ".venv" / SET_UP_FILE.name)
    assert set_up_seconds() == 60.0
    for changed in (False, True):  # nothing to do; packages to renew
        if changed:
            os.utime(tmp_path / "requirements.lock", (2e9, 2e9))
        assert make_setup() == 0 and set_up_seconds() == 60.0
