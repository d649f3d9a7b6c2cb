"""`mavfi harden`: bad input, one line each; from a campaign over a plan to its proof."""

from pathlib import Path

import pytest
import yaml

from mavfi.cli.commands import run
from mavfi.extras.hardening.plan import FunctionPlan, ProtectionPlan, load_plan, save_plan


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--certify",), "--certify: dropped; fly the campaign that mavfi harden writes beside the plan"),
        (("--faults", "9"), "--faults: dropped; fly the campaign"),
        (("--html", "h.html"), "--html: dropped; use --json, or mavfi vulnerability DIR --html"),
        (("--budget", "-1"), "--budget: -1.0: allowed: 0 to 10"),
        (("--plan", "plan.json"), "--plan: plan.json: allowed endings: .yaml, .yml"),
        ((), "holds no campaign"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["harden", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


CAMPAIGN = """
name: tiny
environments: [dense]
first_seed: 100
missions: 4
faults: 12
sampling: {level: instruction, kernels: [pid], which: all, model: one_bit, restart_s: 0.57}
mission: {autopilot: published, platform: i9-9940x, planner: rrt_connect}
"""


@pytest.mark.long  # flies three small campaigns, and builds the kernels several times
def test_a_plan_is_proved_by_its_campaign_and_one_that_protects_nothing_is_refuted(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(CAMPAIGN)
    assert run(["campaign", "run", "tiny.yaml", "--out", "out"]) == 0
    capsys.readouterr()
    assert run(["harden", "out", "--budget", "0.0001", "--plan", "plan.yaml"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("Protect pid: ") and "Missions that it may save: " in output
    assert "campaign run plan.proof.yaml --out out_proof" in output
    (planned,) = load_plan(Path("plan.yaml")).functions
    assert planned.kernel == "pid" and 0 < len(planned.sites) < 708
    assert 0.2 < planned.predicted < 0.99 and 1.0 <= planned.time < 1.3

    # With everything that fits in a larger budget, the fresh faults are detected: none is silent.
    assert run(["harden", "out", "--budget", "0.01", "--plan", "plan.yaml"]) == 0
    (planned,) = load_plan(Path("plan.yaml")).functions
    proof = yaml.safe_load(Path("plan.proof.yaml").read_text())
    assert proof["first_seed"] == 104 and proof["require"][0].startswith("protected: sdc < ")
    assert run(["campaign", "run", "plan.proof.yaml", "--out", "proof"]) == 0

    # A plan that protects nothing leaves as many silent corruptions as the ledger has.
    little = FunctionPlan(**{**dict(planned), "sites": planned.sites[:1]})
    save_plan(ProtectionPlan(functions=(little,)), Path("plan.yaml"))
    assert run(["campaign", "run", "plan.proof.yaml", "--out", "refuted"]) == 3
    assert "protected: sdc < " in capsys.readouterr().out
