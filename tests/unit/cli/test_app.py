import json
import subprocess
import sys

import pytest

from mavfi import __version__
from mavfi.cli import app, run
from mavfi.states import STATES

VERBS = (
    ["fly"], ["states"], ["train"], ["campaign", "run"], ["campaign", "status"], ["campaign", "digest"], ["report"],
    ["replay"], ["explain"], ["reproduce"],
)  # fmt: skip


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_every_verb_has_help_with_an_example(capsys, verb):
    assert run([*verb, "--help"]) == 0
    text = capsys.readouterr().out
    assert "Example:" in text and f"mavfi {verb[0]}" in text


def test_help_without_arguments_names_every_verb(capsys):
    assert run([]) == 0
    text = capsys.readouterr().out
    for command in app.registered_commands:
        assert command.name in text


def test_version(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == __version__


def test_help_loads_nothing_heavy():
    heavy = "('numba', 'mujoco', 'sklearn', 'scipy', 'matplotlib')"
    code = f"import sys; from mavfi.cli import run; run(['--help']); print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_states_print_the_registry(capsys):
    assert run(["states", "--json", "--stack", "hardened"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert [row["state"] for row in data["states"]] == list(STATES)
    assert sum(field["monitored"] for row in data["states"] for field in row["fields"]) == 13
    dead = {(r["state"], f["field"]) for r in data["states"] for f in r["fields"] if f["dead"]}
    assert ("sensor.odometry", "wx") in dead
    assert ("control.tracking", "remaining") in dead
    assert ("planning.waypoint", "ax") not in dead


def test_states_as_a_table(capsys):
    assert run(["states"]) == 0
    text = capsys.readouterr().out
    for name in STATES:
        assert name in text
    assert "dead" in text and "rad/s" in text and "range[pixel]" in text
