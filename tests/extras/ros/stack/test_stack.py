"""Campaigns on a ROS 2 stack: trials of the limiter, forked and cold, on each distribution, and a campaign of them."""

import json
import shutil

import pytest
import yaml

from mavfi.errors import BadInputError
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.ros.processes import private_network
from mavfi.extras.ros.ros2.environment import find_installation
from mavfi.extras.ros.ros2.stack.bench_process import BenchClient
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.faults.changes import parse_text
from mavfi.levels.message.fault import MessageFault
from tests.core.architecture.source import ROOT
from tests.extras.ros.distributions import BY_DAY, EACH

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
    return {**content, "golden_runs": 2, "patience_s": 1.0, **changes}


@pytest.fixture(params=EACH)
def distribution(request):
    """Each distribution that is installed, where there can be private networks."""
    try:
        find_installation(request.param)
        private_network()
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
def test_forked_and_cold_trials_have_equal_outputs_and_effects(bench, distribution):
    trials = {}
    modes = (True, False)
    if distribution != BY_DAY:
        modes = (True,)
    for fork in modes:
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
        cold = trials[modes[-1]][effect]
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
    if distribution != BY_DAY:
        pytest.skip("the other distribution is enough")
    shutil.copytree(EXAMPLE, tmp_path / "examples" / "ros2")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    content = {**SHIPPED, "stack": {**SHIPPED["stack"], "golden_runs": 1, "patience_s": 1.0}, "faults": 2}
    (tmp_path / "limiter.yaml").write_text(yaml.safe_dump(content))
    return tmp_path


DOUBLE = """
import rclpy
from sensor_msgs.msg import JointState


def main():
    rclpy.init()
    node = rclpy.create_node("double")
    publisher = node.create_publisher(JointState, "/final", 10)

    def double(message):
        publisher.publish(JointState(position=[2 * x for x in message.position]))

    node.create_subscription(JointState, "/out", double, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
"""
PUBLISH = """
import time
import rclpy
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node("script")
publisher = node.create_publisher(JointState, "/in", 10)
while publisher.get_subscription_count() < 2:  # the limiter, and the one who records
    rclpy.spin_once(node, timeout_sec=0.02)
time.sleep(0.2)
for number in range(8):
    publisher.publish(JointState(position=[0.25 * number, -0.5 * number]))
    time.sleep(0.02)
time.sleep(0.2)
"""


@pytest.mark.slow
@pytest.mark.long
def test_a_stack_of_several_nodes_gets_its_inputs_from_a_script(bench, jazzy):
    (jazzy / "double.py").write_text(DOUBLE)
    (jazzy / "publish.py").write_text(PUBLISH)
    limiter = str(EXAMPLE / "limiter.py")
    client = bench(
        nodes=[["python3", limiter], ["python3", "double.py"]],
        inputs={"script": ["python3", "publish.py"], "topics": ["/in"]},
        outputs=[{"topic": "/final", "fields": ["position"]}],
        watch=["/out"],
        verdict="",
        golden_runs=1,
    )
    golden = client.golden()
    assert client.forks == [True, True] and {topic: len(found) for topic, found in golden["numbers"].items()} == {
        "/in": 8,
        "/out": 8,
        "/final": 8,
    }
    between = client.trial(MessageFault("/out", "position[1]", seed=1, change=parse_text("set=0.25@n=3")))
    assert (between.effect, between.differing) == ("sdc", 1)
    assert between.differences[0] | {"golden": "-2.0", "value": "0.5"} == between.differences[0]
    crash = client.trial(MessageFault("/in", "position[0]", seed=1, change=parse_text("set=nan@n=3")))
    assert crash.effect == "crash" and crash.differing == 6 and "a position is NaN" in crash.reason


AGE = """
import time
import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

rclpy.init()
node = rclpy.create_node("age")
ages = node.create_publisher(Float64, "/age", 10)

def receive(state):
    age = time.time() - state.header.stamp.sec - 1e-9 * state.header.stamp.nanosec
    ages.publish(Float64(data=float(0.0 <= age < 0.2)))

node.create_subscription(JointState, "/in", receive, 10)
rclpy.spin(node)
"""


def test_inputs_may_have_the_time_at_which_each_is_published(bench, jazzy):
    (jazzy / "age.py").write_text(AGE)
    (jazzy / "verdict.py").write_text(
        "def fresh(outputs):\n    return all(age['data'] == 1.0 for age in outputs['/age'])\n"
    )
    messages = [{"header": {"stamp": "now"}, "position": [0.5]}] * 4
    client = bench(
        nodes=[["python3", "age.py"]],
        inputs={"topic": "/in", "type": "sensor_msgs/msg/JointState", "messages": messages, "period_s": 0.25},
        outputs=[{"topic": "/age"}],
        watch=[],
        verdict="verdict.py:fresh",
        golden_runs=1,
    )
    golden = client.golden()
    assert (golden["status"], golden["outputs"]) == ("success", 4)


@pytest.mark.slow
@pytest.mark.long
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
