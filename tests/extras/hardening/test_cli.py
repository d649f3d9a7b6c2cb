"""`mavfi harden`: bad input, one line each; from a campaign to a certificate."""

import json
from pathlib import Path

import pytest

from mavfi.analysis.statistics import mcnemar
from mavfi.campaign.config import load_campaign
from mavfi.cli.commands import run
from mavfi.config import config_root
from mavfi.extras.hardening import certify
from mavfi.extras.hardening.advise import HardeningStudy
from mavfi.extras.hardening.certify import Certificate, Certification
from mavfi.extras.hardening.observed import GoldenCheck
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, ProtectionPlan, load_plan, save_plan


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--certify",), "--plan: not given"),
        (("--certify", "--plan", "p.yaml", "--budget", "0.1"), "--budget: 0.1: allowed: without --certify"),
        (("--certify", "--plan", "p.yaml", "--html", "h.txt"), "--html: h.txt: allowed ending: .html"),
        (("--certify", "--plan", "p.yaml", "--addresses"), "--addresses: True: allowed: without --certify"),
        (("--faults", "9"), "--faults: 9: allowed: with --certify"),
        (("--machine", "pid"), "--machine: dropped; use make bench NAME=machine_level"),
        (("--budget", "-1"), "--budget: -1.0: allowed: 0 to 10"),
        (("--plan", "plan.json"), "--plan: plan.json: allowed endings: .yaml, .yml"),
        ((), "holds no campaign"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["harden", str(tmp_path), *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


@pytest.fixture
def opened(monkeypatch):
    """A ledger with the digest of no plan, whose next missions are among those of the shipped one."""
    campaign = load_campaign("hardening").model_copy(update={"first_seed": 9_999})
    monkeypatch.setattr(
        HardeningStudy, "open", lambda directory, _: HardeningStudy(directory, campaign, "0" * 64, ("pid",))
    )


def test_a_shipped_plan_is_certified_by_name(opened, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["harden", "out", "--plan", "ten_percent", "--certify"]) == 2
    assert "mission dense 10007, the next after its own: the plan was made from it" in capsys.readouterr().err


@pytest.mark.parametrize(("silent", "code"), [(50, 3), (1, 0)])
def test_a_certificate_is_stated_in_the_plan_and_by_the_exit_code(opened, silent, code, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    planned = FunctionPlan(kernel="pid", function="m.track", signature="f8", ir_sha256="ab" * 32, sites=((0, 0, 1),))
    save_plan(ProtectionPlan(functions=(planned,)), Path("plan.yaml"))
    effects = {"masked": 50, "sdc": 50}, {"detected": 99, "sdc": silent}
    claim, paired = Coverage(estimate=0.95, low=0.9, high=0.98), mcnemar([True], [False])
    certificate = Certificate("pid", "m.track", "f8", 9, *effects, 1.0, claim, paired)
    found = Certification("ab" * 32, 100, ("sparse-9",), (certificate,), GoldenCheck(2, 2, 9, 0))
    monkeypatch.setattr(certify, "certify_plan", lambda *_: found)
    assert run(["harden", "out", "--plan", "plan.yaml", "--certify"]) == code
    output = capsys.readouterr().out
    assert "wrote plan.yaml" in output and ("The plan is refuted: " in output) == (code == 3)
    assert json.loads(Path("plan.certificate.json").read_text())["refuted"] == (code == 3)
    (function,) = load_plan(Path("plan.yaml")).functions
    assert function.certified.estimate == pytest.approx(certificate.coverage.rate)


CAMPAIGN = """
name: tiny
environments: [dense]
first_seed: 100
missions: 4
faults: 12
sampling: {level: instruction, kernels: [pid], which: all, model: one_bit, restart_s: 0.57}
mission: {autopilot: published, platform: i9-9940x, planner: rrt_connect}
"""


@pytest.mark.long  # flies a campaign, and builds each kernel several times
def test_from_a_campaign_to_a_certificate(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(CAMPAIGN)
    assert run(["campaign", "run", "tiny.yaml", "--out", "out"]) == 0
    capsys.readouterr()
    assert run(["harden", "out", "--budget", "0.01", "--plan", "plan.yaml", "--html", "harden.html"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("Protect pid: ") and "It does not buy missions" in output
    assert "track" in Path("harden.html").read_text()
    plan = load_plan(Path("plan.yaml"))
    (planned,) = plan.functions
    assert planned.kernel == "pid" and planned.sites and planned.time < 3.0 and planned.predicted is not None

    assert run(["harden", "out", "--plan", "plan.yaml", "--certify", "--faults", "40", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads(Path("plan.certificate.json").read_text())
    assert found["golden"]["same"] == found["golden"]["flights"] == 2 and found["golden"]["alarms"] == 0
    (function,) = found["functions"]
    assert function["coverage"]["rate"] > 0.6 and function["growth"] > 1.5
    (spent,) = found["spending"]
    assert spent["planner"] == "rrt_connect" and 0 < spent["measured"] < 0.03 and spent["budget"] == 0.01

    boast = {"estimate": 1.0, "low": 1.0, "high": 1.0}
    little = planned.model_copy(update={"sites": planned.sites[:3], "predicted": Coverage(**boast)})
    save_plan(plan.model_copy(update={"functions": (little,)}), Path("boast.yaml"))
    assert run(["harden", "out", "--plan", "boast.yaml", "--certify", "--faults", "40"]) == 3
    assert capsys.readouterr().out.startswith("The plan is refuted: ")

    save_plan(plan.model_copy(update={"ledger": "0" * 64, "studied": {}}), Path("other.yaml"))
    assert run(["harden", "out", "--plan", "other.yaml", "--certify"]) == 2
    assert "the plan was made from 000000000000" in capsys.readouterr().err


def test_the_shipped_certificate_is_that_of_the_shipped_plan():
    plan = load_plan("ten_percent")
    found = json.loads((config_root() / "protections" / "ten_percent.certificate.json").read_text())
    assert found["plan"] == plan.digest and not found["refuted"]
    certified = {one["function"]: one["coverage"]["rate"] for one in found["functions"]}
    stated = {one.function: one.certified and one.certified.estimate for one in plan.functions if one.sites}
    assert stated == certified  # None where the certificate found no silent corruption at all
    assert sum(rate is not None for rate in certified.values()) > len(certified) / 2
    assert {one.function for one in plan.functions if one.kind == "none"} == {
        one["function"] for one in found["unprotected"]
    }
