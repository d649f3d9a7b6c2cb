import os
import shutil
import subprocess
import sys

import pytest

from mavfi.cli import run
from mavfi.cli.completion import SCRIPTS


@pytest.fixture
def complete(capsys, monkeypatch):
    """Words that a line may continue with, as a shell asks for them."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("_MAVFI_COMPLETE", "complete_fish")
    monkeypatch.setenv("_TYPER_COMPLETE_FISH_ACTION", "get-args")

    def replies(line):
        monkeypatch.setenv("_TYPER_COMPLETE_ARGS", line)
        with pytest.raises(SystemExit):
            run([])
        return [reply.partition("\t")[0] for reply in capsys.readouterr().out.splitlines()]

    return replies


@pytest.mark.parametrize(
    ("line", "completions"),
    [
        ("mavfi cam", ["campaign"]),
        ("mavfi fly --arr", ["--arrival-radius"]),
        ("mavfi fly --environment de", ["dense", "dense30", "density05", "density15", "density25", "density35"]),
        ("mavfi fly --grain ", ["stage", "kernel", "message"]),
        ("mavfi fly --trained-for hardened/c", ["hardened/cortex-a57"]),
        ("mavfi campaign run smo", ["smoke"]),
        ("mavfi fly --fault state:planning.way", ["state:planning.waypoint."]),
        ("mavfi fly --fault state:planning.waypoint.ya", ["state:planning.waypoint.yaw"]),
        ("mavfi fly --fault message:control.command:dr", ["message:control.command:drop"]),
        ("mavfi fly --fault instruction:octo", ["instruction:octomap"]),
    ],
)
def test_names_are_completed(complete, line, completions):
    assert complete(line) == completions


def test_ids_of_the_ledger_that_was_named_before(complete, tmp_path, monkeypatch):
    import sqlite3

    from mavfi.campaign.store import FILE, TABLES

    with sqlite3.connect(tmp_path / FILE) as connection:
        connection.executescript(TABLES)
        for position, run_id in enumerate(["dense-1-golden-1a", "dense-1-fi-pid-0-2b", "sparse-1-golden-3c"]):
            row = (run_id, position, "golden", "golden", "dense", 1, "{}", None, "", None, "")
            connection.execute("INSERT INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", row)
    for command in ("explain", "replay", "shrink", "export"):
        assert complete(f"mavfi {command} {tmp_path} dense-") == ["dense-1-golden-1a", "dense-1-fi-pid-0-2b"]


@pytest.mark.skipif(not shutil.which("bash"), reason="needs bash")
def test_bash_replaces_what_follows_a_colon(tmp_path):
    program = tmp_path / "mavfi"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m mavfi "$@"\n')
    program.chmod(0o755)
    lines = [
        f"source {SCRIPTS / 'mavfi.bash'}",
        "complete -p mavfi",
        'COMP_LINE="mavfi fly --fault state:planning.waypoint.ya"; COMP_POINT=${#COMP_LINE}',
        f"_mavfi_completion {program}",
        'echo "${COMPREPLY[@]}"',
    ]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(["bash", "-c", "\n".join(lines)], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines() == ["complete -o default -F _mavfi_completion mavfi", "planning.waypoint.yaw"]


def test_the_script_of_each_shell_is_printed(capsys):
    for shell in ("bash", "zsh", "fish"):
        assert run(["completion", shell]) == 0
        assert "_MAVFI_COMPLETE=complete_fish" in capsys.readouterr().out
    assert run(["completion", "tcsh"]) == 2
