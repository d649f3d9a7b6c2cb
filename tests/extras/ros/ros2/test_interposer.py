"""Faults inside real nodes, as a second reader sees them: C++ and Python, preloaded and loaded late, both sides."""

import dataclasses
import itertools
import json
import math
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.graph import AgentClient
from mavfi.extras.ros.ros2.interposer.attach import Attachments
from mavfi.extras.ros.ros2.interposer.page import ControlPage, InterposedFault
from mavfi.faults.changes import Change, MessageSchedule, When, parse_change
from mavfi.faults.operations import Operation, changed_number
from tests.extras.ros.ros2.conftest import NODES, until
from tests.extras.ros.ros2.messages import BASIC, Messages

pytestmark = pytest.mark.ros


def compiled_relay(installation, folder):
    """The relay in C++, on plain rcl."""
    if shutil.which("g++") is None:
        pytest.skip("no g++")
    packages = ("std", "sensor", "nav", "geometry", "trajectory", "test")
    libraries = [f"-l{name}_msgs__rosidl_typesupport_cpp" for name in packages]
    includes = [f"-I{path}" for path in sorted((installation.prefix / "include").iterdir())]
    command = [
        "g++",
        "-O1",
        "-std=c++17",
        "-rdynamic",
        *includes,
        str(NODES / "relay.cpp"),
        "-o",
        str(folder / "relay"),
    ]
    command += [f"-L{installation.prefix}/lib", "-lrcl", "-lrcutils", "-lrmw", *libraries, "-ltracetools"]
    subprocess.run([*command, "-lrosidl_typesupport_cpp", "-Wl,--allow-shlib-undefined"], check=True)
    return folder / "relay"


@pytest.fixture(scope="module")
def page():
    with ControlPage() as shared:
        yield shared


class Relay:
    """A relay of all messages in a domain of its own, as a killed node stays in its domain for a while."""

    def __init__(self, ros2, page, command, domain, *, is_late):
        variables = {"ROS_DOMAIN_ID": str(domain)}
        self.agent = AgentClient(ros2.installation, variables)
        if not is_late:
            variables |= page.environment()
        self.process = subprocess.Popen(command, env=ros2.installation.environment(**variables))

    def __enter__(self):
        self.agent.__enter__()
        self.messages = Messages(self.agent.definition("test_msgs/msg/BasicTypes"))
        for name, kind in self.messages.kinds.items():
            assert self.agent.advertise(f"/in/{name}", kind, subscribers=1)
            self.agent.subscribe(f"/out/{name}", kind)
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.agent.close()

    def relayed(self, name, data, count, wait_s=5.0):
        """What comes of messages that are sent one by one."""
        received = []
        for _ in range(count):
            self.agent.publish(f"/in/{name}", data)
            message = self.agent.receive(wait_s)
            while message is not None:
                received.append(message.data)
                message = self.agent.receive(0.002)
        return received


DOMAINS = itertools.count(50)


@pytest.fixture(scope="module")
def relay(request, ros2, page, tmp_path_factory):
    """A relay with the interposer: its language, how it was loaded, and more arguments."""
    language, how, *arguments = request.param.split()
    command = [ros2.installation.python, str(NODES / "relay.py")]
    if language == "c++":
        command = [str(compiled_relay(ros2.installation, tmp_path_factory.mktemp("relay")))]
    with Relay(ros2, page, [*command, *arguments], next(DOMAINS), is_late=how == "late") as started:
        with Attachments(page) as attachments:
            if how == "late":
                attachments.attach(started.process.pid)
            yield started
        assert page.redirected_calls() == 0 and started.process.poll() is None


of_each_kind = pytest.mark.parametrize(
    "relay", ["python preloaded", "python late", "c++ preloaded", "c++ late"], indirect=True, scope="module"
)
of_one_kind = pytest.mark.parametrize("relay", ["c++ late"], indirect=True, scope="module")


@of_each_kind
@pytest.mark.parametrize("side", ["publish", "take"])
def test_exactly_one_bit_of_one_message_differs(relay, page, side):
    prefix = {"publish": "/out/", "take": "/in/"}[side]
    page.arm(
        [
            InterposedFault(
                prefix + name,
                relay.messages.fields[name],
                Change(Operation("flip", bit=relay.messages.bits[name]), When(first=2)),
                side,
                type=kind,
            )
            for name, kind in relay.messages.kinds.items()
        ]
    )
    for name, data in relay.messages.data.items():
        received = relay.relayed(name, data, 3)
        assert [relay.messages.differing_bits(name, data) for data in received] == [0, 1, 0], name
    reports = page.reports()
    assert len(reports) == len(relay.messages.kinds) and {report.kind for report in reports} == {"changed"}
    assert [(report.bit, report.message) for report in reports] == [(bit, 2) for bit in relay.messages.bits.values()]


@of_one_kind
def test_messages_are_chosen_as_by_the_schedule(relay, page):
    """One number of a list for each of these triggers: those changed are those that the schedule names."""
    whens = [
        When(),
        When(first=5, times=3),
        When(times=0, every=3),
        When(first=4, times=0, every=2),
        When(times=0, share=0.4),
        When(times=4, share=0.5, every=2),
        When(start_s=1e6),
        parse_change(["set=0"], "ranges[0]>0").when,
        parse_change(["set=0", "times=2"], "ranges[1]>3").when,
    ]
    kind = relay.messages.kinds["LaserScan"]
    faults = [
        InterposedFault("/out/LaserScan", f"ranges[{10 + i}]", Change(Operation("set", -1.0), when), seed=i, type=kind)
        for i, when in enumerate(whens)
    ]
    page.arm(faults)
    received = relay.relayed("LaserScan", relay.messages.data["LaserScan"], 25)
    page.reports()
    ranges = np.arange(40.0)
    for i, when in enumerate(whens):
        schedule = MessageSchedule(when, seed=i)
        expected = [schedule.due(0.5, lambda path: ranges[int(path[7:-1])]) for _ in received]
        actual = [relay.messages.read("LaserScan", data).ranges[10 + i] == -1.0 for data in received]
        assert actual == expected, when
    assert sum(sum(relay.messages.read("LaserScan", data).ranges == -1.0) for data in received) > 20


DTYPES = {"float32": "f4", "float64": "f8", "bool": "?", "byte": "u1", "char": "u1"}
VALUES = [
    ("float32_value", Operation("set", math.nan)),
    ("float64_value", Operation("scale", -3.5)),
    ("int8_value", Operation("bias", 1000.0)),
    ("uint8_value", Operation("bias", -1000.0)),
    ("int16_value", Operation("scale", 2.5)),
    ("uint16_value", Operation("flip", bit=15)),
    ("int32_value", Operation("set", -(2.0**31))),
    ("uint32_value", Operation("scale", 1e30)),
    ("int64_value", Operation("scale", -1e30)),
    ("uint64_value", Operation("scale", 1e30)),
    ("bool_value", Operation("flip", bit=0)),
    ("byte_value", Operation("set", 100.0)),
    ("char_value", Operation("flip", bit=7)),
]


@of_one_kind
def test_numbers_change_as_in_flights(relay, page):
    kind = relay.messages.kinds["BasicTypes"]
    page.arm(
        [InterposedFault("/out/BasicTypes", field, Change(operation, When()), type=kind) for field, operation in VALUES]
    )
    (received,) = relay.relayed("BasicTypes", relay.messages.data["BasicTypes"], 1)
    page.reports()
    values = dataclasses.asdict(relay.messages.read("BasicTypes", received))
    for field, operation in VALUES:
        name = field.removesuffix("_value")
        dtype = DTYPES.get(name) or np.dtype(name).str[1:]
        expected = changed_number(operation, BASIC[field], dtype)
        np.testing.assert_equal(values[field], expected, err_msg=field)


@of_one_kind
@pytest.mark.parametrize(
    ("operation", "expected"),
    [
        ("drop", [1, 2, 4, 5]),
        ("duplicate=2", [1, 2, 3, 3, 3, 4, 5]),
        ("reorder=1", [1, 2, 4, 3, 5]),
        ("delay=0.25", [1, 2, 4, 3, 5]),
    ],
)
def test_whole_messages_are_lost_repeated_and_late(relay, page, operation, expected):
    kind = relay.messages.kinds["Twist"]
    change = parse_change([operation], "n=3")
    page.arm([InterposedFault("/out/Twist", "", change, type=kind)])
    vector = relay.messages.store.types["geometry_msgs/msg/Vector3"]
    received = []
    for number in range(1, 6):
        twist = relay.messages.packed(kind, linear=vector(float(number), 0.0, 0.0), angular=vector(0.0, 0.0, 0.0))
        relay.agent.publish("/in/Twist", twist)
        received += [message.data for message in relay.agent.messages(0.15)]
    assert [relay.messages.read("Twist", data).linear.x for data in received] == expected
    assert [report.kind for report in page.reports()] == ["changed"]


@of_one_kind
def test_what_cannot_be_changed_is_said(relay, page):
    kind = relay.messages.kinds["JointState"]
    faults = [("position[2]", "bit=1"), ("position[0]", "bit=64"), ("name[0]", "bit=1"), ("velocity.x", "bit=1")]
    planned = [(field, parse_change([change])) for field, change in faults]
    planned.append(("position[0]", parse_change(["bit=1"], "position[3]>0")))  # a condition that never holds
    page.arm([InterposedFault("/out/JointState", field, change, type=kind) for field, change in planned])
    assert relay.relayed("JointState", relay.messages.data["JointState"], 1) == [relay.messages.data["JointState"]]
    reasons = [report.text for report in until(lambda: page.reports())]
    assert reasons == [
        "position has 2 elements",
        "the number has no such bit",
        "name is a text: name a character, e.g. name[0]",
        "velocity is a list: name an element, e.g. velocity[0]",
        "position has 2 elements",
    ]


def test_a_cpp_node_that_has_loaded_tables_for_python_is_one_in_cpp(ros2, page, tmp_path):
    """As if linked with -lrclcpp and all libraries of its message package, none left out as unneeded."""
    rclcpp = tmp_path / "librclcpp.so"
    subprocess.run(
        ["gcc", "-shared", "-Wl,-soname,librclcpp.so", "-x", "c", "/dev/null", "-o", str(rclcpp)], check=True
    )
    command = [str(compiled_relay(ros2.installation, tmp_path)), "--open", str(rclcpp)]
    command.append("libtest_msgs__rosidl_generator_py.so")
    with Relay(ros2, page, command, next(DOMAINS), is_late=True) as relay, Attachments(page) as attachments:
        attachments.attach(relay.process.pid)
        kind = relay.messages.kinds["BasicTypes"]
        change = Change(Operation("set", 7.0), When(first=2))
        page.arm([InterposedFault("/out/BasicTypes", "int32_value", change, type=kind)])
        received = relay.relayed("BasicTypes", relay.messages.data["BasicTypes"], 2)
        assert [report.kind for report in page.reports()] == ["changed"]
        assert relay.messages.read("BasicTypes", received[1]).int32_value == 7


def test_processes_without_ros_are_refused(page):
    process = subprocess.Popen(["sleep", "60"])
    try:
        with Attachments(page) as attachments, pytest.raises(BadInputError, match=r"has not loaded librcl\.so"):
            attachments.attach(process.pid)
    finally:
        process.kill()
        process.wait()


def test_calls_actions_and_six_faults_on_four_threads_are_changed_exactly(ros2, page):
    """The graph is one process that publishes 200 numbers on each topic; flips change their sign."""
    count = 200
    flip = Operation("flip", bit=63)
    faults = [
        InterposedFault("/add", "int32_value", Change(Operation("bias", 100.0), When(first=2)), "take_request"),
        InterposedFault("/add", "int32_value", Change(Operation("set", -1.0), When(first=3)), "send_response"),
        InterposedFault("/add", "", Change(Operation("drop"), When(first=5)), "send_request"),
        InterposedFault(
            "/count/_action/send_goal", "goal.order", Change(Operation("set", 7.0), When(first=2)), "take_request"
        ),
        InterposedFault(
            "/count/_action/feedback", "feedback.sequence[0]", Change(Operation("set", 50.0), When(first=3))
        ),
        InterposedFault(
            "/count/_action/get_result", "result.sequence[0]", Change(Operation("set", 9.0), When()), "take_response"
        ),
        *(InterposedFault(f"/number{i}", "data", Change(flip, When(first=2, times=0, every=i + 2))) for i in range(6)),
    ]
    page.arm(faults)
    variables = {**page.environment(), "ROS_DOMAIN_ID": str(next(DOMAINS))}
    command = [ros2.installation.python, str(NODES / "calls.py"), str(count)]
    output = subprocess.run(
        command, env=ros2.installation.environment(**variables), stdout=subprocess.PIPE, check=True, timeout=60
    ).stdout
    got = json.loads(output)
    assert got["asked"] == [1, 102, 3, 4] and got["responses"] == [1, 102, -1, 4, None]
    assert got["orders"] == [1, 7, 3] and got["results"] == [1, 7, 3] and got["feedback"] == [1, 7, 50]
    expected = {index: 1 for index in range(6)}
    for topic, numbers in enumerate(got["received"]):
        assert sorted(map(abs, numbers)) == list(range(count))
        changed = [n for n in range(count) if math.copysign(1.0, numbers[n]) < 0]
        assert sorted(abs(numbers[n]) for n in changed) == list(range(1, count, topic + 2))
        expected[6 + topic] = len(changed)
    reports = page.reports()
    assert {index: sum(report.fault == index for report in reports) for index in expected} == expected
    assert page.lost_reports == 0


def test_a_process_with_faults_is_refused_to_another_mavfi_until_that_ends(ros2, page):
    command = [ros2.installation.python, str(NODES / "relay.py")]
    other = "from mavfi.extras.ros.ros2.interposer.attach import Attachments\n"
    other += "from mavfi.extras.ros.ros2.interposer.page import ControlPage\nimport sys\n"
    other += "with ControlPage() as page, Attachments(page) as attachments: attachments.attach(int(sys.argv[1]))"
    with Relay(ros2, page, command, next(DOMAINS), is_late=True) as relay:
        words = [sys.executable, "-c", other, str(relay.process.pid)]
        with Attachments(page) as attachments:
            attachments.attach(relay.process.pid)
            kind = relay.messages.kinds["Twist"]
            page.arm([InterposedFault("/out/Twist", "linear.x", parse_change(["set=7", "times=0"]), type=kind)])
            second = subprocess.run(words, capture_output=True, text=True, check=False)
            assert f"has faults of mavfi, process {os.getpid()}; allowed: after its end" in second.stderr
            (received,) = relay.relayed("Twist", relay.messages.data["Twist"], 1)
            assert relay.messages.read("Twist", received).linear.x == 7.0
        assert subprocess.run(words, check=False).returncode == 0
    page.reports()


@pytest.mark.parametrize("relay", ["c++ preloaded --announce"], indirect=True, scope="module")
def test_messages_handed_over_as_pointers_are_changed_once(relay, page):
    page.arm([InterposedFault("/out/Twist", "linear.x", Change(Operation("bias", 1.0), When(first=2, times=2)))])
    received = relay.relayed("Twist", relay.messages.data["Twist"], 4)
    assert [round(relay.messages.read("Twist", data).linear.x, 6) for data in received] == [0.1, 1.1, 1.1, 0.1]
    page.arm([InterposedFault("/out/Twist", "", Change(Operation("drop"), When()))])
    assert len(relay.relayed("Twist", relay.messages.data["Twist"], 1)) == 1
    assert "handed over as a pointer" in page.reports()[-1].text


@pytest.mark.parametrize("relay", ["c++ preloaded --adapt"], indirect=True, scope="module")
def test_an_object_that_may_be_no_message_is_left_alone(relay, page):
    data = relay.messages.data["Twist"]
    page.arm([InterposedFault("/out/Twist", "linear.x", Change(Operation("set", 5.0), When(times=0)))])
    assert relay.relayed("Twist", data, 3) == [data] * 3
    reports = until(lambda: page.reports())
    assert {report.kind for report in reports} == {"refused"}
    assert "a pointer to what may be no ROS message" in reports[0].text
    assert page.messages_changed(0) == 0
