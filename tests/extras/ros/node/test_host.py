"""Campaigns on foreign nodes, with trials that are made up."""

import pytest
import yaml

from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.ledger import status
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.node import host
from mavfi.extras.ros.node.bench import Trial
from mavfi.outcomes import effect_of

PLAIN = {
    "host": "node",
    "name": "made_up",
    "faults": 4,
    "null_runs": 2,
    "sampling": {"level": "register"},
    "node": {
        "name": "/n",
        "command": ["/n"],
        "golden_runs": 2,
        "outputs": {"topic": "/out"},
        "inputs": {"topic": "/in", "type": "std_msgs/Float64", "messages": [{"data": 1.0}]},
    },
}
INJECTION = {
    "level": "register",
    "site": "rax",
    "time_s": 0.1,
    "bit": 3,
    "before": "0x0",
    "after": "0x8",
    "activated": True,
    "file": "",
    "line": 0,
    "details": {"symbol": "f+0x3", "library": "/l.so", "register": "rax", "stopped_us": 9},
}
DIFFERENCE = {"field": "data", "before": "1.0", "after": "2.0"}


def made_up(node, golden=(), fault=None):
    """Effects by the seed of the fault."""
    if fault is None:
        return Trial(outputs=["a"])
    assert golden == ("a",)
    if fault.null:
        return Trial(outputs=["a"], injection=INJECTION)
    number = fault.seed - 10_000
    if number == 3:
        raise MavfiError("the machine is on fire")
    effect = ("masked", "sdc", "crash")[number]
    differing = ["b"] if effect == "sdc" else []
    return Trial(
        effect, {"crash": "SIGSEGV"}.get(effect, ""), ["a"], 10, differing, [DIFFERENCE] * len(differing), INJECTION
    )


def read(path, **changes):
    path.write_text(yaml.safe_dump({**PLAIN, **changes}))
    return load_campaign(path)


@pytest.fixture
def campaign(monkeypatch, tmp_path):
    monkeypatch.setattr(host, "run_trial", made_up)
    monkeypatch.setattr(host, "private_network", list)
    monkeypatch.setattr("mavfi.extras.ros.ros1.finder.require", lambda: None)
    return read(tmp_path / "made_up.yaml")


def run(campaign, directory, **options):
    return run_campaign(campaign, directory, executor=LocalExecutor(1), **options)


def test_a_campaign_stops_and_resumes_and_its_ledger_does_not_show_it(campaign, tmp_path):
    def stop(progress):
        if progress.done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(campaign, tmp_path / "a", progress=stop)
    # the worker may have ended the mission before the command stops
    assert 5 <= status(tmp_path / "a").done <= status(tmp_path / "a").total == 1 + 2 * 4 + 2
    assert run(campaign, tmp_path / "a").complete
    assert run(campaign, tmp_path / "b").complete
    with Store.open(tmp_path / "a") as one, Store.open(tmp_path / "b") as other:
        assert one.digest() == other.digest() and one.complete


def test_each_trial_has_the_effect_that_its_node_showed(campaign, tmp_path):
    run(campaign, tmp_path)
    with Store.open(tmp_path) as store:
        runs = list(store.runs())
    golden = runs[0].record
    found = {
        kind: [
            (run.spec.index, run.spec.target, effect_of(golden, run.record).label)
            for run in runs
            if run.spec.kind == kind
        ]
        for kind in ("injected", "null")
    }
    effects = ("masked", "sdc", "crash", "unknown")
    assert found["injected"] == [(i, kind, effects[i]) for i in range(4) for kind in ("general", "fp")]
    assert [effect for _, _, effect in found["null"]] == ["masked", "masked"]
    assert [run.spec.fault.seed for run in runs[1:]] == [10_000 + i for i in (0, 0, 1, 1, 2, 2, 3, 3, 0, 1)]
    corrupted = runs[3].record
    assert corrupted.extra["differences"] == [DIFFERENCE] and corrupted.extra["differing"] == 1
    assert corrupted.injections[0].details["symbol"] == "f+0x3"
    assert runs[5].record.error == "SIGSEGV"


def test_golden_trials_that_differ_or_fail_end_the_campaign(campaign, tmp_path, monkeypatch):
    outputs = iter("ab")
    monkeypatch.setattr(host, "run_trial", lambda node: Trial(outputs=[next(outputs)]))
    with pytest.raises(BadInputError, match=r"golden trials differ.*outputs\.ignore"):
        run(campaign, tmp_path / "a")

    def fails(node):
        raise MavfiError("no node")

    monkeypatch.setattr(host, "run_trial", fails)
    with pytest.raises(MavfiError, match="no node"):
        run(campaign, tmp_path / "b")


def test_faults_in_states_need_another_host(campaign, tmp_path):
    wrong = campaign.model_copy(update={"sampling": load_campaign("smoke").sampling})
    with pytest.raises(BadInputError, match="host node: faults of level 'state': allowed: register"):
        run(wrong, tmp_path)
