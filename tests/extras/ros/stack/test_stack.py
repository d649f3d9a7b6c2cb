"""Campaigns on a ROS 2 stack: trials of the limiter, forked and cold, on each distribution, and a campaign of them."""

import json
import shutil

import pytest
import yaml

from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS, find_installation
from mavfi.extras.ros.ros2.stack.bench import BenchClient, private_namespaces
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.faults.fault import MessageFault, RegisterFault
from mavfi.faults.operations import parse_text
from tests.core.architecture.source import ROOT

EXAMPLE = ROOT / "examples" / "ros2"
SHIPPED = yaml.safe_load((EXAMPLE / "limiter.yaml").read_text())
FAULTS = {
    "masked": ("/in", "position[1]", "bias=-0.5@n=8"),  # beyond the limit anyway
    "sdc": ("/out", "position[0]", "bit=62@n=3"),
    "crash": ("/in", "position[0]", "set=nan@n=3"),
    "hang": ("/in", "position[0]", "set=1e-40@n=3"),
}


def stack(**changes):
    """The limiter of the example, at its place in the repository."""
    content = json.loads(json.dumps(SHIPPED["stack"]).replace("examples/ros2", str(EXAMPLE)))
    return {**content, "golden_runs": 2, "patience_s": 0.5, **changes}


@pytest.fixture(params=DISTRIBUTIONS)
def distribution(request):
    """Each distribution that is installed, where there can be private networks."""
    try:
        find_installation(request.param)
        private_namespaces()
    except BadInputError as error:
        pytest.skip(str(error))
    return request.param


@pytest.fixture
def bench(distribution):
    """Makes benches, and ends them."""
    made = []

    def make(**changes):
        config = stack(distribution=distribution, **changes)
        made.append(BenchClient(StackConfig.model_validate(config)))
        return made[-1]

    yield make
    for client in made:
        client.close()


@pytest.mark.slow
def test_forked_and_cold_trials_have_equal_outputs_and_effects(bench):
    trials = {}
    for fork in (True, False):
        client = bench(fork=fork, golden_runs=3 if fork else 1)
        assert client.forks == [fork]
        golden = client.golden()
        assert golden["status"] == "success" and golden["outputs"] == 8
        trials[fork] = {
            effect: client.trial(MessageFault(topic, field, seed=1, change=parse_text(text)))
            for effect, (topic, field, text) in FAULTS.items()
        }
        assert [trial.effect for trial in trials[fork].values()] == list(FAULTS)
        assert trials[fork]["masked"].digest == golden["digest"]
    for effect, forked in trials[True].items():
        cold = trials[False][effect]
        assert (forked.digest, forked.differences, forked.injections) == (
            cold.digest,
            cold.differences,
            cold.injections,
        )
    sdc, crash = trials[True]["sdc"], trials[True]["crash"]
    (injection,) = sdc.injections
    assert (injection.before, injection.bit, injection.details["message"]) == (0.5, 62, 3)
    assert sdc.differing == 1 and sdc.differences[0]["field"] == "position[0]" and sdc.status == "success"
    assert crash.reason == "exit code 1 (ValueError: a position is NaN)" and crash.status == "lost"


@pytest.fixture
def jazzy(distribution, tmp_path, monkeypatch):
    """A folder with the example, on one of the distributions."""
    if distribution != "jazzy":
        pytest.skip("the other distribution is enough")
    shutil.copytree(EXAMPLE, tmp_path / "examples" / "ros2")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    content = {**SHIPPED, "stack": {**SHIPPED["stack"], "golden_runs": 1, "patience_s": 0.5}, "faults": 2}
    (tmp_path / "limiter.yaml").write_text(yaml.safe_dump(content))
    return tmp_path


@pytest.mark.slow
def test_a_campaign_stops_and_resumes_and_its_ledger_does_not_show_it(jazzy, capsys):
    campaign = load_campaign("limiter.yaml")

    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(campaign, jazzy / "a", executor=LocalExecutor(1), progress=stop)
    assert run(["campaign", "run", "limiter.yaml", "--out", "a", "--workers", "1", "--require", "due < 90 %"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("holds      due < 90 %: ") and "mission lost" in printed and "succe" not in printed
    assert run_campaign(campaign, jazzy / "b", executor=LocalExecutor(2)).complete
    with Store.open(jazzy / "a") as one, Store.open(jazzy / "b") as other:
        assert one.digest() == other.digest()
        runs = list(one.runs())
    assert [run.spec.setting for run in runs] == ["golden"] * 2 + ["fi"] * 4 + ["null"]
    assert all(run.record.injections[0].activated for run in runs[2:])
    assert runs[-1].record.digest == runs[0].record.digest, "the null run"
    assert run(["report", "a", "--view", "message_effects"]) == 0
    table = capsys.readouterr().out
    assert "/in" in table and "/out" in table and "mission lost" in table
    (jazzy / "examples" / "ros2" / "limiter.py").write_text("print('another program')\n")
    with pytest.raises(BadInputError, match="holds another campaign"):
        run_campaign(campaign, jazzy / "a", executor=LocalExecutor(1))


@pytest.mark.slow
def test_registers_are_injected_while_the_stack_computes(bench, jazzy):
    trial = bench(golden_runs=1).trial(RegisterFault("general", symbol="rcl_publish", timeout=10.0, seed=3))
    assert trial.injections, trial.reason
    assert trial.injections[0].activated and trial.effect in ("masked", "sdc", "crash", "hang")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nodes": [["python3", "-c", "raise SystemExit(3)"]]}, r"nobody reads /in, .* \(exit code 3\)"),
        ({"outputs": [{"topic": "/out", "fields": ["speed"]}]}, r"field 'speed': the message has none"),
        ({"nodes": [["no_such_program"]]}, r"nobody reads /in, .*no_such_program"),
    ],
)
def test_a_stack_that_cannot_be_tried_is_one_line(bench, jazzy, changes, message):
    with pytest.raises(BadInputError, match=message) as refusal:
        bench(**changes).golden()
    assert "\n" not in str(refusal.value)
