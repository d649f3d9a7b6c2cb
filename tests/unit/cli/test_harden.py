"""`mavfi harden`: bad input, one line each."""

import pytest

from mavfi.cli.commands import run


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--certify",), "--plan: not given"),
        (("--certify", "--plan", "p.yaml", "--budget", "0.1"), "--budget: 0.1: allowed: without --certify"),
        (("--certify", "--plan", "p.yaml", "--html", "h.html"), "--html: h.html: allowed: without --certify"),
        (("--faults", "9"), "--faults: 9: allowed: with --certify"),
        (("--budget", "-1"), "--budget: -1.0: allowed: 0 to 10"),
        (("--plan", "plan.json"), "--plan: plan.json: allowed endings: .yaml, .yml"),
        ((), "holds no campaign"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(words, told, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["harden", str(tmp_path), *words]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
