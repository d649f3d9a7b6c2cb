"""Campaigns on ROS nodes, with trials that are made up."""

import pytest
import yaml

from mavfi.campaign import config as configs
from mavfi.campaign.nodes import run as nodes
from mavfi.campaign.nodes.config import NodeCampaign
from mavfi.campaign.run import status
from mavfi.campaign.store import Store
from mavfi.cli import run as cli
from mavfi.errors import BadInputError, MavfiError
from mavfi.hosts.node import private, trial
from mavfi.hosts.node.trial import Result
from mavfi.reports.node_report import write_node_report

PLAIN = {
    "kind": "ros_node", "name": "made_up", "node": "/n", "command": ["/n"], "trials": 4, "golden_runs": 2,
    "null_runs": 2, "inputs": {"topic": "/in", "type": "std_msgs/Float64", "messages": [{"data": 1.0}]},
    "outputs": {"topic": "/out"},
}  # fmt: skip
INJECTION = {"symbol": "f+0x3", "library": "/l.so", "register": "rax", "bit": 3, "instruction": "add", "stopped_us": 9}
DIFFERENCE = {"field": "data", "before": "1.0", "after": "2.0"}


def made_up(order):
    """Outcomes by the seed of the strike."""
    if order.strike is None:
        return Result(outputs=["a"])
    if order.strike["null"]:
        return Result(outputs=["a"], injection=INJECTION)
    number = order.strike["seed"] - 10_000
    if number == 3:
        raise MavfiError("the machine is on fire")
    outcome = ("masked", "sdc", "crash")[number]
    reason = {"crash": "SIGSEGV"}.get(outcome, "")
    found = [DIFFERENCE] if outcome == "sdc" else []
    return Result(outcome, reason, ["a"], 10, len(found), found, INJECTION)


@pytest.fixture
def campaign(monkeypatch):
    monkeypatch.setattr(trial, "run_trial", made_up)
    monkeypatch.setattr(private, "private_network", list)
    monkeypatch.setattr("mavfi.hosts.ros1.finder.require", lambda: None)
    return NodeCampaign.model_validate(PLAIN)


@pytest.mark.slow
def test_a_campaign_stops_and_goes_on_and_its_ledger_does_not_tell(campaign, tmp_path):
    def stop(progress):
        if progress.done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nodes.run_node_campaign(campaign, tmp_path / "a", progress=stop)
    assert 5 <= status(tmp_path / "a").done < campaign.count and status(tmp_path / "a").total == campaign.count
    assert nodes.run_node_campaign(campaign, tmp_path / "a").complete
    assert nodes.run_node_campaign(campaign, tmp_path / "b", workers=2).complete
    with Store.open(tmp_path / "a") as one, Store.open(tmp_path / "b") as other:
        assert one.digest() == other.digest() and one.complete
        assert len(list(one.runs())) == campaign.count == 2 + 2 * 4 + 2


def test_the_report_counts_what_was_judged(campaign, tmp_path, capsys):
    nodes.run_node_campaign(campaign, tmp_path)
    analysis, files = write_node_report(tmp_path)
    whole = analysis["outcomes"][-1]
    assert (whole["registers"], whole["n"], whole["unknown"]) == ("in all", 6, 2)
    assert [whole[name]["successes"] for name in ("masked", "sdc", "crash", "hang")] == [2, 2, 2, 0]
    assert whole["masked"]["low"] == pytest.approx(0.0968, abs=1e-3)  # Wilson, 2 of 6
    assert analysis["endings"] == {"SIGSEGV": 2} and analysis["null_check"]["passed"]
    assert analysis["by_place"] == [{"place": "f", "n": 6, "masked": 2, "sdc": 2, "crash": 2}]
    assert cli(["report", str(tmp_path)]) == 0
    assert "33.3 [9.7, 70.0] 2/6" in capsys.readouterr().out
    text = files[0].read_text()
    assert "Silent corruptions" in text and "| rax bit 3 | add | data | 1.0 | 2.0 | 1 of 10 |" in text


def test_a_trial_cannot_be_flown_again(campaign, tmp_path, capsys):
    nodes.run_node_campaign(campaign, tmp_path)
    with Store.open(tmp_path) as store:
        run_id = next(store.runs()).spec.run_id
    for command in (["replay", str(tmp_path), run_id], ["explain", str(tmp_path), run_id]):
        assert cli(command) == 2
        assert "holds trials on a ROS node, which cannot be flown again" in capsys.readouterr().err
    assert cli(["campaign", "status", str(tmp_path)]) == 0
    assert cli(["campaign", "digest", str(tmp_path)]) == 0


def test_golden_trials_that_differ_or_fail_end_the_campaign(campaign, tmp_path):
    specs = nodes.plan_golden(campaign)
    with Store.create(tmp_path, {"campaign": PLAIN}) as store:
        store.plan(1, specs)
        for spec, output in zip(specs, "ab", strict=True):
            store.write(spec, {"end": "flown", "outputs": [output]}, None, "", 0.0)
        with pytest.raises(BadInputError, match=r"golden trials differ.*outputs\.ignore"):
            nodes._golden(store, campaign)
        store.write(specs[0], {"end": "unknown", "reason": "no node"}, None, "", 0.0)
        with pytest.raises(MavfiError, match="no node; remove"):
            nodes._golden(store, campaign)


def test_the_shipped_campaign_is_read_by_its_kind(tmp_path):
    shipped = configs.load_any("ros_robot_state_publisher")
    assert isinstance(shipped, NodeCampaign) and shipped.at_scale("paper").trials == 400
    assert isinstance(configs.load_any("smoke"), configs.Campaign)
    assert len(nodes.plan_golden(shipped) + nodes.plan_strikes(shipped)) == shipped.count
    path = tmp_path / "x.yaml"
    for change, told in (
        ({"kind": "ros_topic"}, "key 'kind': 'ros_topic': not known; allowed: ros_node"),
        ({"registers": ["general", "general"]}, "allowed: each kind once"),
        ({"access": "both"}, "access: 'both': not known"),
        ({"walk": 0}, "walk"),
    ):
        path.write_text(yaml.safe_dump({**PLAIN, **change}))
        with pytest.raises(BadInputError) as error:
            configs.load_any(path)
        assert told in str(error.value)
    with pytest.raises(BadInputError, match="scale 'huge'"):
        shipped.at_scale("huge")
