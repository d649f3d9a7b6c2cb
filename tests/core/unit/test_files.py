"""Names that no file can have are those of no file, whoever asks."""

import pytest

from mavfi.cli import run
from mavfi.files import exists, is_dir, is_file

LONG = "x" * 300  # Linux allows 255 bytes


@pytest.mark.parametrize("name", [LONG, "a\0b", "missing"])
def test_there_is_nothing_of_an_impossible_name(tmp_path, name):
    assert not any(there(tmp_path / name) for there in (is_file, is_dir, exists))


@pytest.mark.parametrize(
    "command",
    [
        "fly --environment {}",
        "fly --detector {}.npz",
        "campaign run {}",
        "campaign merge {} {} --out {}",
        "export {} 3 --to a.csv",
    ],
)
def test_a_name_that_is_too_long_is_one_line(command, tmp_path, monkeypatch, capsys):
    """Found by `make nightly ONLY=fuzz` as a traceback."""
    monkeypatch.chdir(tmp_path)
    assert run(command.replace("{}", LONG).split()) == 2
    *before, line = capsys.readouterr().err.splitlines()
    assert line.startswith("mavfi: ") and "xxx" in line
    assert all(text.startswith("compiling kernels") for text in before)  # the first command in a new cache
    assert not list(tmp_path.iterdir())
