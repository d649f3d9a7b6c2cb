"""Parts of campaigns on a ROS 2 stack that need no ROS: configuration, draws, comparison, verdicts, scripts."""

import json
import sys

import pytest

from mavfi.analysis.runs import drawn as describe_draws
from mavfi.campaign.config import Campaign
from mavfi.campaign.resolve import resolve
from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.stack import launcher
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.extras.ros.ros2.stack.outputs import compare, status_of
from mavfi.extras.ros.ros2.stack.sampling import MessageNumbers, TopicMessages
from mavfi.extras.ros.ros2.stack.watching import Publication, alarms_of, train
from mavfi.flight.host import RunResult
from mavfi.levels.level import Sampled
from mavfi.record import End, FlightRecord
from mavfi.testing import HostContract

STACK = {
    "nodes": [["python3", "node.py"]],
    "inputs": {"topic": "/in", "type": "std_msgs/msg/Float64", "messages": [{"data": 1.0}, {"data": 2.0}]},
    "outputs": [{"topic": "/out", "tolerance": 0.1}],
}


class TestHost(HostContract):
    """The host keeps the contract of hosts."""

    host = "ros2_stack"
    under_test = STACK


def campaign(**sampling):
    content = {"name": "c", "host": "ros2_stack", "stack": STACK, "faults": 200}
    return Campaign.model_validate({**content, "sampling": {"level": "message", **sampling}})


def drawn_text(**sampling):
    content = {"name": "c", "host": "ros2_stack", "stack": STACK, "sampling": sampling}
    return describe_draws(Campaign.model_validate(content))


def golden():
    numbers = (MessageNumbers("x", "f8", -1), MessageNumbers("ranges", "f4", 3), MessageNumbers("mode", "u1", -1))
    recorded = (TopicMessages("/in", ((),) * 5), TopicMessages("/out", ((), numbers, numbers)))
    return {"": Sampled(RunResult(FlightRecord(End.FLOWN, digest="g"), recorded))}


def drawn(**sampling):
    made = campaign(**sampling)
    sampler = resolve(made).sampler
    draws = [block.draw(index) for block in sampler.blocks("node") for index in range(block.count)]
    return made, sampler.draw(draws, "node", golden())


def test_an_operation_that_a_topic_can_never_have_is_not_drawn():
    """`/in` has no number to flip: each of its faults is a drop."""
    _, faults = drawn(topics=["/in", "/out"], operations=["flip", "drop"])
    assert None not in faults
    operations = [fault.planned.operation.name for fault in faults if fault.topic == "/in"]
    assert operations == ["drop"] * 200
    assert {fault.planned.operation.name for fault in faults if fault.topic == "/out"} == {"flip", "drop"}


def test_defaults_follow_from_the_stack_and_its_ledger_keeps_it():
    made = campaign()
    assert made.environments == ("node",) and made.missions == 2 and not made.flies
    assert Campaign.model_validate(json.loads(made.model_dump_json())) == made


def test_a_report_says_what_is_under_test():
    messages = drawn_text(level="message", operations=["drop"])
    assert messages["title"] == "campaign c · ROS 2 stack node" and messages["profile"] == ""
    assert messages["lines"] == ["python3 node.py", "one fault per run, drop; uniform over messages and numbers"]
    registers = drawn_text(level="register", symbol="f", walk=64)
    assert registers["lines"][1].startswith(
        "one bit per run, from the next call of 'f' on, after up to 64 instructions"
    )


def test_numbers_are_drawn_uniformly_and_only_where_the_operation_is_possible():
    _, faults = drawn(topics=["/out"], operations=["flip", "set=nan", "drop"])
    fields = [fault.field for fault in faults if fault.field]
    counts = {field: fields.count(field) for field in {*fields}}
    assert set(counts) == {"x", "ranges[0]", "ranges[1]", "ranges[2]", "mode"} and min(counts.values()) > 4
    names = [str(fault.change.operation) for fault in faults]
    assert 50 < names.count("drop") < 85 and 50 < names.count("set=nan") < 85
    assert all(fault.field != "mode" for fault in faults if str(fault.change.operation) == "set=nan")
    widths = {"x": 64, "mode": 8}
    flips = [fault for fault in faults if fault.change.operation.name == "flip"]
    assert all(fault.change.operation.bit < widths.get(fault.field, 32) for fault in flips)
    assert {fault.change.when.first for fault in faults if fault.field} == {2, 3}, "the first message has no number"
    assert {fault.change.when.first for fault in faults if not fault.field} == {1, 2, 3}


def test_faults_that_no_message_can_have_are_not_planned():
    _, faults = drawn(topics=["/in"], operations=["flip"])
    assert faults == [None] * 200


@pytest.mark.parametrize(
    ("sampling", "message"),
    [
        ({"topics": ["/speed"]}, "sampling.topics: '/speed': not known; allowed: /in, /out"),
        ({"operations": ["flop"]}, "sampling.operations: 'flop': "),
        ({"operations": ["drop@10"]}, "the instant is drawn"),
        ({"operations": ["delay=0.1"], "topics": ["/in"]}, "not possible in the input /in; allowed: drop, freeze"),
    ],
)
def test_a_sampling_that_is_not_possible_is_refused(sampling, message):
    with pytest.raises(ValueError, match=message):
        campaign(**sampling)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"launch": ["ros2"]}, "either nodes, or launch"),
        ({"watch": ["plan"]}, "topic 'plan': allowed: full names, e.g. /plan"),
        ({"inputs": {"messages": [{}]}}, "messages: allowed: with topic and type"),
        ({"inputs": {"bag": "in.bag"}}, "allowed endings: .mcap, .db3"),
        ({"inputs": {"script": ["a"]}}, "allowed: with topics"),
        ({"outputs": [{"topic": "/a"}, {"topic": "/a"}]}, "each topic once"),
    ],
)
def test_a_stack_that_makes_no_sense_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        StackConfig.model_validate({**STACK, **changes})


def test_outputs_differ_beyond_the_tolerance_or_if_one_is_missing():
    stack = StackConfig.model_validate(STACK)
    error_free = {"/out": [{"x": 1.0, "names": ["a"]}, {"x": float("nan"), "names": []}]}
    equal = {"/out": [{"x": 1.05, "names": ["a"]}, {"x": float("nan"), "names": []}]}
    assert compare(error_free, equal, stack).differing == 0
    other = compare(error_free, {"/out": [{"x": 1.2, "names": ["b"]}]}, stack)
    assert other.differing == 2 and [entry.field for entry in other.differences] == ["x", "names[0]", ""]


def test_a_verdict_is_a_function_or_a_command(tmp_path):
    (tmp_path / "v.py").write_text("def moved(outputs):\n    return outputs['/out'][-1]['x'] > 1 or 'stuck'\n")
    function = StackConfig.model_validate({**STACK, "verdict": f"{tmp_path}/v.py:moved"})
    assert status_of(function, {"/out": [{"x": 2.0}]}) == "success"
    assert status_of(function, {"/out": [{"x": 0.0}]}) == "stuck"
    with pytest.raises(BadInputError, match="IndexError"):
        status_of(function, {"/out": []})
    code = "import json, sys; sys.exit(len(json.load(sys.stdin)['/out']))"
    command = StackConfig.model_validate({**STACK, "verdict": [sys.executable, "-c", code]})
    assert status_of(command, {"/out": []}) == "success" and status_of(command, {"/out": [{}]}) == "lost"


@pytest.mark.parametrize(
    ("text", "forkable"),
    [
        ("import a\nLIMIT = 2\ndef main(x=1): pass\nif __name__ == '__main__':\n    main()\n", True),
        ('"""Doc."""\nimport sys\ndef main(): pass\nif __name__ == "__main__":\n    sys.exit(main())\n', True),
        ("def main(x): pass\nif __name__ == '__main__':\n    main(1)\n", False),  # needs an argument
        ("import a\na.init()\ndef main(): pass\nif __name__ == '__main__':\n    main()\n", False),  # runs at import
        ("def main(): pass\n", False),
    ],
)
def test_scripts_are_forked_only_if_their_import_does_nothing(text, forkable, tmp_path):
    (tmp_path / "node.py").write_text(text)
    assert launcher.is_forkable(str(tmp_path / "node.py")) == forkable


def test_detectors_learn_error_free_runs_and_notice_values_that_are_far_away():
    def publications(**changed):
        runs = [{"x": 0.1 * number, "names": ["a"]} for number in range(1, 31)]
        for number, value in changed.items():
            runs[int(number.removeprefix("n")) - 1]["x"] = value
        return [Publication("/out", data, float(number)) for number, data in enumerate(runs, start=1)]

    monitor = train("gaussian", "tuned", [publications()] * 2)
    assert alarms_of(monitor, publications()) == ()
    for value in (1e200, float("nan")):
        (alarm, *_) = alarms_of(monitor, publications(n12=value))
        assert (alarm.state, alarm.time_s) == ("/out", 12.0)
    with pytest.raises(BadInputError, match="no number to monitor"):
        train("gaussian", "tuned", [[Publication("/out", {"names": ["a"]}, 1.0)]])
    with pytest.raises(BadInputError, match="detector 'checksum': is not fitted to messages; allowed: "):
        train("checksum", "tuned", [publications()])
