"""`mavfi airsim` and `mavfi fly --world` on the command line."""

import importlib.util
import json
from pathlib import Path

import pytest

from mavfi.cli import run

BOX = str(Path(__file__).parents[3] / "examples" / "airsim" / "box.py")
HAS_CLIENT = importlib.util.find_spec("cosysairsim") is not None


@pytest.mark.skipif(not HAS_CLIENT, reason="needs the package cosysairsim (extra dev)")
def test_the_effect_of_a_fault_comes_first(capsys):
    assert run(["airsim", "run", "--seed", "7", "--fault", "moveToPosition.x:bit=51", BOX]) == 0
    first, second, *rest = capsys.readouterr().out.splitlines()
    assert first == "effect: deviates" and "fault in moveToPosition.x bit 51: 8.0 → 12.0" in second
    assert rest[0].startswith("golden: ended") and rest[1].startswith("injected: ended")


TOO_FAR = """
import airsim
client = airsim.MultirotorClient()
client.enableApiControl(True)
client.moveToPositionAsync(0, 0, 9, 1).join()
"""


@pytest.mark.skipif(not HAS_CLIENT, reason="needs the package cosysairsim (extra dev)")
@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("for k in range(40): print('measured', k)", 0, ""),
        (TOO_FAR, 0, ""),
        (
            "import airsim\nairsim.MultirotorClient().ping()\nraise ValueError('own')",
            1,
            "crash without a fault: ValueError",
        ),
        (
            "import airsim\nairsim.MultirotorClient().armDisarm(True, 'B')",
            2,
            "1 call refused: armDisarm: vehicle 'B': not",
        ),
    ],
)
def test_all_output_is_there_and_what_fails_without_a_fault_exits_with_an_error(tmp_path, capsys, text, code, line):
    script = tmp_path / "own.py"
    script.write_text(text, encoding="utf-8")
    assert run(["airsim", "run", "--seconds", "20", "--json", str(script)]) == code
    printed = capsys.readouterr()
    golden = json.loads(printed.out)["golden"]
    assert line in printed.err and printed.err.count("\n") == (code != 0)
    if "measured" in text:
        assert golden["output"].splitlines() == [f"measured {k}" for k in range(40)]
        run(["airsim", "run", str(script)])
        assert [f"  | measured {k}" for k in range(40)] == capsys.readouterr().out.splitlines()[1:]
    if text == TOO_FAR:
        assert golden["reason"] == "it waited for moveToPosition; more time: --seconds above 20"


def test_options_after_the_script_are_the_programs_own_and_a_line_says_so(tmp_path, capsys):
    script = tmp_path / "own.py"
    script.write_text("import sys\nprint(sys.argv[1:])\n", encoding="utf-8")
    assert run(["airsim", "run", str(script), "--seed", "8", "--fault=x", "--own"]) == 0
    printed = capsys.readouterr()
    assert "| ['--seed', '8', '--fault=x', '--own']" in printed.out
    told = "mavfi: --seed, --fault=x: passed to the program; options of mavfi come before the script"
    assert printed.err.splitlines() == [told]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["airsim", "run", "none.py"], "none.py: there is no such file"),
        (["airsim", "run", "--fault", "fly.x", BOX], "--fault: 'fly.x': call 'fly': not known"),
        (["airsim", "run", "--detector", "limits", BOX], "--detector: limits"),
        (["airsim", "serve", "--clock", "steps", "--speed", "2"], "--speed: 2: allowed: with --clock real"),
        (["fly", "--world", "airsim://127.0.0.1:1"], "no server there"),
        (
            ["fly", "--world", "airsim://127.0.0.1:1", "--fault", "instruction:pid"],
            "allowed with --world: state:, memory:",
        ),
    ],
)
def test_bad_input_is_one_line(arguments, text, capsys):
    assert run(arguments) == 2
    out = capsys.readouterr()
    assert text in out.err.replace("'slow'", "slow").replace("'limits'", "limits") and out.err.count("\n") == 1
