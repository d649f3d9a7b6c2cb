"""`mavfi doctor` and `mavfi cache`: the answer first, the way out, and nothing deleted that mavfi did not write."""

import errno
import sys
from pathlib import Path

import pytest

from mavfi.cli import doctor
from mavfi.cli.commands import run
from mavfi.cli.doctor import Check


@pytest.fixture(autouse=True)
def narrow(monkeypatch, tmp_path):
    """A terminal of 80 columns, an empty cache, and no checks of extras."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(doctor, "extensions", lambda group: {})


def report(capsys):
    """Exit code of `mavfi doctor`, and its lines."""
    code = run(["doctor"])
    return code, capsys.readouterr().out.splitlines()


def test_the_first_line_says_whether_flights_work(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "_extras", lambda: Check("extras", True, "all installed"))
    code, lines = report(capsys)
    assert (code, lines[0]) == (0, "Everything is here.")
    assert all(name in " ".join(lines) for name in ("compiler", "cache", "bytecode", "disk", "extras"))


def test_what_is_missing_comes_with_its_cure(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "packages_by_extra", lambda: {"bench": ["numpy", "none-such"], "logs": ["numpy"]})
    elsewhere = Check("ROS 2", False, "mavfi ros setup")
    monkeypatch.setattr(doctor, "extensions", lambda group: {"ros": lambda: [elsewhere]})
    code, lines = report(capsys)
    assert (code, lines[0]) == (0, "Everything that flights need is here; 2 optional things are missing.")
    assert [line.split() for line in lines if "–" in line] == [
        ["–", "extras", "pip", "install", "'mavfi[bench]'"],
        ["–", "ROS", "2", "mavfi", "ros", "setup"],
    ]
    assert max(map(len, lines)) <= 80


def test_without_a_compiler_nothing_flies(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    code, lines = report(capsys)
    assert (code, lines[0]) == (1, "Flights cannot work: compiler.")


def test_a_cache_that_cannot_be_written_is_no_obstacle(monkeypatch, capsys):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(doctor.tempfile, "TemporaryFile", refuse)
    code, lines = report(capsys)
    assert code == 0
    assert any(line.strip().endswith("set XDG_CACHE_HOME") for line in lines)


def test_clearing_the_cache_deletes_what_mavfi_wrote(tmp_path, capsys):
    folder = tmp_path / "mavfi" / "code"
    folder.mkdir(parents=True)
    ours = [folder / name for name in ("f-0123.nbc", "g-0123.bin", "flight.warm", "f-0123.nbc.99")]
    for path in [*ours, folder / "notes.txt"]:
        path.write_bytes(bytes(500_000))
    assert run(["cache"]) == 0
    assert capsys.readouterr().out == f"{folder}: 4 files, 2.0 MB\n"
    assert run(["cache", "--clear"]) == 0
    assert capsys.readouterr().out == f"{folder}: deleted 4 files, 2.0 MB\n"
    assert [path.name for path in Path(folder).iterdir()] == ["notes.txt"]
