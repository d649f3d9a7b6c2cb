"""A campaign on Debian's robot_state_publisher, and flights as bags that Debian's rosbag reads."""

import json
import subprocess

import pytest
import yaml

from mavfi import cli
from mavfi.campaign.config import load_any
from mavfi.campaign.nodes.run import run_node_campaign
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.hosts.node.trial import Order, run_trial
from tests.hosts.node.conftest import until

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def campaign():
    shipped = load_any("ros_robot_state_publisher")
    return shipped.model_copy(update={"trials": 2, "golden_runs": 1, "null_runs": 1, "walk": 500})


@pytest.mark.slow
def test_a_campaign_is_resumable_and_its_report_has_every_outcome(ros, campaign, tmp_path, capsys):
    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_node_campaign(campaign, tmp_path, progress=stop)
    assert run_node_campaign(campaign, tmp_path).complete
    with Store.open(tmp_path) as store:
        runs = list(store.runs())
    assert [run.spec.setting for run in runs] == ["golden"] + ["fi"] * 4 + ["null"]
    assert {run.record["outcome"] for run in runs} <= {"masked", "sdc", "crash", "hang", "unknown"}
    assert runs[0].record["outcome"] == runs[-1].record["outcome"] == "masked"
    assert runs[-1].record["injection"]["hit"]
    assert sum(run.record["outcome"] != "unknown" for run in runs) >= 5
    assert cli.run(["report", str(tmp_path)]) == 0
    assert "What one bit in a register does" in capsys.readouterr().out
    assert cli.run(["report", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["null_check"] == {"n": 1, "differing": [], "passed": True}


def order(campaign, **changes):
    plain = {
        "node": campaign.node, "command": campaign.command, "parameters": campaign.parameters,
        "input_topic": campaign.inputs.topic, "input_type": campaign.inputs.type,
        "messages": campaign.inputs.messages, "output": campaign.outputs.topic, "ignored": campaign.outputs.ignore,
        "patience_s": 1.0, "cycles": 1,
    }  # fmt: skip
    return Order(**{**plain, **changes})


def strike(**changes):
    return {"seed": 0, "registers": "general", "access": "read", "symbol": "4TimeERSB_", "walk": 1, "timeout": 10.0,
            "null": False, **changes}  # fmt: skip


@pytest.mark.slow
def test_golden_outputs_repeat_and_another_golden_output_is_no_effect_of_a_strike(ros, campaign):
    first, second = run_trial(order(campaign)), run_trial(order(campaign))
    assert first.outputs == second.outputs and len(set(first.outputs)) == len(campaign.inputs.messages)
    other = run_trial(order(campaign, golden=("0" * 64,) * 4, strike=strike()))
    assert other.outcome == "unknown" and "golden" in other.reason and other.injection is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("request_", "outcome", "reason"),
    [
        ({"seed": 0}, "masked", ""),  # rbp, which the function does not use before it loads it
        ({"seed": 3}, "crash", "SIGSEGV"),  # rsp, before a push
        ({"seed": 0, "registers": "fp", "access": "write", "walk": 900}, "sdc", ""),  # a product in KDL::Rotation::Rot2
        ({"symbol": "KDL4Tree10addSegment", "timeout": 1.0}, "unknown", "did not call"),
    ],
)
def test_what_is_masked_corrupts_crashes_or_never_came_is_told_apart(ros, campaign, request_, outcome, reason):
    found = run_trial(order(campaign, strike=strike(**request_)))
    assert found.outcome == outcome and reason in found.reason
    assert (found.injection is None) == (outcome == "unknown")
    assert (found.differing > 0) == bool(found.differences) == (outcome == "sdc")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"command": ("/nothing/there",)}, "cannot be started"),
        ({"input_type": "sensor_msgs/Nothing"}, "type sensor_msgs/Nothing: not known"),
        ({"messages": ({"positions": [1.0]},)}, "no member 'positions'; allowed: position"),
        ({"messages": ({"position": ["far"]},)}, "'far': allowed: float64"),
        ({"strike": strike(symbol="no_such_symbol")}, "no_such_symbol"),
    ],
)
def test_what_cannot_be_tried_is_refused(ros, campaign, changes, told):
    with pytest.raises(BadInputError, match=None) as error:
        run_trial(order(campaign, **changes))
    assert told in str(error.value)


@pytest.mark.slow
def test_debians_rosbag_reads_and_plays_an_exported_flight(bench, tmp_path):
    flight, bag = tmp_path / "flight.npz", tmp_path / "flight.bag"
    assert cli.run(["fly", "--environment", "sparse", "--seed", "10000", "--save", str(flight)]) == 0
    assert cli.run(["export", str(flight), "--to", str(bag)]) == 0
    told = subprocess.run(["/usr/bin/rosbag", "info", "--yaml", str(bag)], check=True, capture_output=True, text=True)
    info = yaml.safe_load(told.stdout)
    assert info["messages"] > 100 and info["duration"] > 1.0
    topics = {topic["topic"]: topic["type"] for topic in info["topics"]}
    assert "tf2_msgs/TFMessage" in topics.values()
    nowhere = {name: subprocess.DEVNULL for name in ("stdin", "stdout", "stderr")}
    player = subprocess.Popen(["/usr/bin/rosbag", "play", "--quiet", "--rate", "0.5", str(bag)], **nowhere)
    try:
        until(lambda: set(topics) <= set(bench.master.graph().publishers), 20)
    finally:
        player.terminate()
        player.wait()
