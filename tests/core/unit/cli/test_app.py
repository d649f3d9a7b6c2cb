import os
import re
import subprocess
import sys
from itertools import pairwise

import pytest
import typer

from mavfi.cli import run
from mavfi.cli.commands import app
from mavfi.cli.stopping import stoppable
from mavfi.states import STATES, states_with
from mavfi.version import __version__


def commands_of(group, *path):
    """The words of every command."""
    for name, command in getattr(group, "commands", {}).items():
        yield [*path, name]
        yield from commands_of(command, *path, name)


VERBS = [*commands_of(typer.main.get_command(app))]


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_help_of_every_verb_has_an_example_and_fills_the_width_of_a_terminal(capsys, monkeypatch, verb):
    monkeypatch.setenv("COLUMNS", "80")
    assert run([*verb, "--help"]) == 0
    text = capsys.readouterr().out
    assert "Example:" in text and f"mavfi {verb[0]}" in text and "…" not in text
    for line, after in pairwise(text.partition("╭")[0].splitlines()):
        if line.strip() and after.strip() and "Usage:" not in line:
            (word, *_) = after.split()
            assert len(line.rstrip()) + 1 + len(word) > 80 - 2, f"{word!r} fits into {line!r}"


def test_help_without_arguments_names_every_verb(capsys):
    assert run([]) == 0
    text = capsys.readouterr().out
    for name, command in typer.main.get_command(app).commands.items():
        assert re.search(rf"^│ {name} +{re.escape(command.help[:30])}", text, re.MULTILINE), name


def test_it_is_run_as_a_module_too():
    done = subprocess.run([sys.executable, "-m", "mavfi", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == __version__


@pytest.mark.parametrize("arguments", [["states"], ["--help"]], ids=" ".join)
def test_a_reader_that_has_ended_is_no_failure(arguments):
    """`mavfi ... | head` ends with the code of the command."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as nobody:
        done = subprocess.run(
            [sys.executable, "-m", "mavfi", *arguments], stdout=nobody, stderr=subprocess.PIPE, text=True
        )
    assert (done.returncode, done.stderr) == (0, "")


STRUCK = """
import os, signal, sys

class Strike:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Strike())
sys.argv = ["mavfi", *{arguments!r}]
from mavfi.cli import main
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("typer", ["fly"]),
        ("mavfi.cli.commands", ["reproduce"]),
        ("numba", ["campaign", "run", "smoke", "--out", "out"]),
    ],
)
def test_ctrl_c_during_imports_ends_without_a_word(tmp_path, module, arguments):
    code = STRUCK.format(module=module, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_work_that_is_stopped_says_what_is_kept(capsys):
    with pytest.raises(typer.Exit) as stopped, stoppable("Stopped."):
        raise KeyboardInterrupt
    assert stopped.value.exit_code == 130
    assert capsys.readouterr().err == "Stopped.\n"


def test_help_loads_nothing_heavy():
    heavy = "('numba', 'mujoco', 'sklearn', 'scipy', 'matplotlib')"
    code = f"import sys; from mavfi.cli import run; run(['--help']); print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_states_print_the_registry(capsys):
    assert run(["states", "--autopilot", "hardened"]) == 0
    text = capsys.readouterr().out
    blocks = {block.split(maxsplit=1)[0]: block for block in text.split("\n\n")[1:-1]}
    assert list(blocks) == list(states_with("truth"))
    assert run(["states", "--localization", "estimator"]) == 0
    estimated = capsys.readouterr().out
    assert all((name in estimated) == STATES[name].exists_with("estimator") for name in STATES)
    assert sum("●" in line for block in blocks.values() for line in block.splitlines()) == 13
    dead = {
        (state, line.split()[0])
        for state, block in blocks.items()
        for line in block.splitlines()
        if line.rstrip().endswith(" dead")
    }
    assert {("sensor.odometry", "wx"), ("control.tracking", "remaining")} <= dead
    assert ("planning.waypoint", "ax") not in dead
    assert re.search(r"read by octomap *$", blocks["perception.point_cloud"], re.MULTILINE)


@pytest.mark.parametrize("line", ["fly --seed 1 --seed 2", "campaign run a.yaml --out b --out c"])
def test_an_option_of_one_value_is_not_given_twice(line, capsys):
    assert run(line.split()) == 2
    option = line.split()[-2]
    assert capsys.readouterr().err == f"mavfi: {option}: given 2 times; allowed: once\n"
