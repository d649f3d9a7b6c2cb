import re
import signal
import subprocess
import sys
from itertools import pairwise

import pytest
import typer

from mavfi.cli import run
from mavfi.cli.commands import app
from mavfi.cli.progress import Bar
from mavfi.cli.stopping import leave_on_ctrl_c, stoppable
from mavfi.states import STATES, states_with
from mavfi.version import __version__


def commands_of(group, *words):
    """The words of every command."""
    for name, command in getattr(group, "commands", {}).items():
        yield [*words, name]
        yield from commands_of(command, *words, name)


VERBS = [*commands_of(typer.main.get_command(app))]


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_every_verb_has_help_with_an_example(capsys, verb):
    assert run([*verb, "--help"]) == 0
    text = capsys.readouterr().out
    assert "Example:" in text and f"mavfi {verb[0]}" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--seed", "1.5"], "--seed: '1.5': allowed: a whole number; see `mavfi fly --help`"),
        (["--start", "a", "b", "c"], "--start: 'a': allowed: a number; see `mavfi fly --help`"),
        (["--wind", "strong"], "--wind: 'strong': allowed: a number; see `mavfi fly --help`"),
    ],
)
def test_a_value_of_the_wrong_kind_is_shown(capsys, words, message):
    assert run(["fly", *words]) == 2
    assert capsys.readouterr().err == f"mavfi: {message}\n"


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
@pytest.mark.parametrize("width", [80, 100])
def test_paragraphs_of_help_fill_the_width(capsys, monkeypatch, verb, width):
    monkeypatch.setenv("COLUMNS", str(width))
    assert run([*verb, "--help"]) == 0
    text = capsys.readouterr().out.partition("╭")[0]
    for line, after in pairwise(text.splitlines()):
        if line.strip() and after.strip() and "Usage:" not in line:
            (word, *_) = after.split()
            assert len(line.rstrip()) + 1 + len(word) > width - 2, f"{word!r} fits into {line!r}"


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_help_is_not_cut_in_a_terminal_of_80_columns(capsys, monkeypatch, verb):
    monkeypatch.setenv("COLUMNS", "80")
    assert run([*verb, "--help"]) == 0
    assert "…" not in capsys.readouterr().out


@pytest.mark.parametrize("word", ["--stack=hardened", "--stack"])
def test_an_older_name_of_an_option_is_refused_with_the_new_one(capsys, word):
    assert run(["states", word]) == 2
    assert capsys.readouterr().err == "mavfi: --stack: dropped; use --autopilot\n"


def test_an_older_name_in_a_file_is_refused_in_one_line(capsys, tmp_path):
    (path := tmp_path / "own.yaml").write_text(
        "{name: own, environments: [sparse], missions: 1, faults: 1, mission: {stack: hardened}}", encoding="utf-8"
    )
    assert run(["campaign", "run", str(path), "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "key 'stack': dropped; use autopilot" in error and error.count("\n") == 1


def test_help_without_arguments_names_every_verb(capsys):
    assert run([]) == 0
    text = capsys.readouterr().out
    for name, command in typer.main.get_command(app).commands.items():
        assert re.search(rf"^│ {name} +{re.escape(command.help[:30])}", text, re.MULTILINE), name


@pytest.mark.parametrize("verb", ["airsim", "mavlink"])
def test_help_names_the_extra_in_brackets(capsys, verb):
    assert run([verb, "--help"]) == 0
    assert f"mavfi[{verb}]" in " ".join(capsys.readouterr().out.split())


def test_version(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == __version__


def test_it_is_run_as_a_module_too():
    done = subprocess.run([sys.executable, "-m", "mavfi", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == __version__


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
@pytest.mark.parametrize("module", ["typer", "mavfi.cli.commands", "numba"])
@pytest.mark.parametrize("arguments", [["fly"], ["campaign", "run", "smoke", "--out", "out"], ["reproduce"]])
def test_ctrl_c_during_imports_ends_without_a_word(tmp_path, module, arguments):
    code = STRUCK.format(module=module, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_work_that_is_stopped_says_what_is_kept(capsys):
    with pytest.raises(typer.Exit) as stopped, stoppable("Stopped."):
        raise KeyboardInterrupt
    assert stopped.value.exit_code == 130
    assert capsys.readouterr().err == "Stopped.\n"


def test_ctrl_c_stops_work_and_leaves_everything_else():
    before = signal.getsignal(signal.SIGINT)
    try:
        leave_on_ctrl_c()
        leaving = signal.getsignal(signal.SIGINT)
        with stoppable("Stopped."):
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert signal.getsignal(signal.SIGINT) is leaving is not before
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_rate_of_a_bar_counts_from_the_first_unit_that_is_done_now(monkeypatch, capsys):
    """59 were done before; the first one compiled for 100 s, which says nothing about the others."""
    clock = [0.0]
    monkeypatch.setattr("mavfi.cli.progress.time.perf_counter", lambda: clock[0])
    bar = Bar("training flights")
    bar.show(59, 100)
    clock[0] = 100.0
    bar.show(60, 100)
    assert capsys.readouterr().err == "training flights 60/100 flights\n"
    clock[0] = 120.0
    bar.show(99, 100)
    assert "99/100 flights  1.9 flights/s · 1 s left" in capsys.readouterr().err


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
    assert re.search(r"read by flight controller *$", blocks["control.command"], re.MULTILINE)
    assert "pid" in blocks["planning.waypoint"]


def test_states_as_a_table(capsys):
    assert run(["states"]) == 0
    text = capsys.readouterr().out
    for name in STATES:
        assert (name in text) == STATES[name].exists_with("truth")
    assert "dead" in text and "rad/s" in text and "range[pixel]" in text
    assert "written by planner, read by trajectory" in text
    assert run(["states", "--localization", "estimator"]) == 0
    text = capsys.readouterr().out
    for name in STATES:
        assert (name in text) == STATES[name].exists_with("estimator")


def test_a_localization_that_is_not_known_is_refused(capsys):
    assert run(["states", "--localization", "gps"]) == 2
    assert "--localization: 'gps': allowed: truth, estimator" in capsys.readouterr().err
