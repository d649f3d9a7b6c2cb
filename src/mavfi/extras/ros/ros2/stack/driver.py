"""A hidden node that plays inputs to a stack and records its outputs; runs under the Python of a ROS 2 installation.

It is the agent (`../agent.py`) with the requests that a trial needs, forked by `launcher.py`.  Messages become plain
data here: a message is a dictionary, an array a list, or a digest if it is longer than `LONGEST_LIST`.
"""

import contextlib
import functools
import hashlib
import os
import socket
import sys
import threading
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), os.pardir))
import agent  # noqa: E402
from launcher import has_exited  # noqa: E402

LONGEST_LIST = 4096
"""Longest array that is recorded number by number."""
SLOW_S = 0.5
"""Wait for an output, before the next input is published without it (s)."""
MISSED_S = 0.1
"""The same, once one has been missed and until one comes again (s)."""
LATE_S = 0.3
"""Time in which a reader finds a publisher, after the publisher has found the reader (s)."""
LAST_S = 0.02
"""Wait for outputs that nobody expects, after the last one (s)."""
WIDTHS = {
    "boolean": "?",
    "octet": "u1",
    "byte": "u1",
    "char": "u1",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
}
"""NumPy's names of the numbers in ROS messages."""
NOW = "now"
"""Value of a time in an input that is that of its publication."""
NOT_COMPARED = ("stamp",)
"""Members that are times of now, wherever they stand."""


def import_ros():
    """Import what drivers need, before they are forked."""
    import rclpy
    import rclpy.executors
    import rclpy.serialization  # noqa: F401

    with contextlib.suppress(ImportError):  # before Iron
        import rclpy.event_handler  # noqa: F401


# ---- messages as plain data ------------------------------------------------------------------------------------------
def element_of(kind):
    """Type of the elements of an array type such as "sequence<double, 8>" or "double[9]"; None = it is no array."""
    if kind.startswith("sequence<"):
        return kind[len("sequence<") : -1].partition(",")[0].strip()
    if kind.endswith("]"):
        return kind[: kind.rindex("[")]
    return None


def plain(value):
    """A value of a message as plain data."""
    if hasattr(value, "get_fields_and_field_types"):
        names = value.get_fields_and_field_types()
        return {name: plain(getattr(value, name)) for name in names if name not in NOT_COMPARED}
    if isinstance(value, (bool, int, float, str)):
        return value
    if hasattr(value, "tolist"):
        if len(value) > LONGEST_LIST:
            return {"length": len(value), "sha256": hashlib.sha256(value.tobytes()).hexdigest()}
        return value.tolist()
    if isinstance(value, bytes):
        return list(value)
    return [plain(element) for element in value]


def numbers(message, prefix=""):
    """Numbers of a message: path, NumPy's name of the type, and length of an array, -1 for a single number."""
    for name, kind in message.get_fields_and_field_types().items():
        path = prefix + name
        value = getattr(message, name)
        if name in NOT_COMPARED:
            continue
        element = element_of(kind)
        if element is None and kind in WIDTHS:
            yield path, WIDTHS[kind], -1
        elif element is None and hasattr(value, "get_fields_and_field_types"):
            yield from numbers(value, path + ".")
        elif element in WIDTHS:
            if len(value):
                yield path, WIDTHS[element], len(value)
        elif element is not None:
            for index, part in enumerate(value):
                if hasattr(part, "get_fields_and_field_types"):
                    yield from numbers(part, f"{path}[{index}].")


def has_now(data):
    """Whether plain data of a message has the time of its publication, `stamp: now`, somewhere."""
    if isinstance(data, dict):
        return any(map(has_now, data.values()))
    if isinstance(data, list):
        return any(map(has_now, data))
    return data == NOW


def fill(message, data):
    """Set the members of a message from plain data."""
    kinds = message.get_fields_and_field_types()
    for name, value in data.items():
        if name not in kinds:
            raise agent.RequestError(f"{type(message).__name__}: no field {name!r}; allowed: {', '.join(kinds)}")
        current = getattr(message, name)
        element = element_of(kinds[name])
        if value == NOW and kinds[name] == "builtin_interfaces/Time":
            now_ns = time.time_ns()
            value = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
        if element is not None and "/" in element:
            package, kind = element.split("/")
            made = agent.message_class(f"{package}/msg/{kind}")
            value = [fill(made(), part) for part in value]
        elif hasattr(current, "get_fields_and_field_types"):
            value = fill(current, value)
        elif isinstance(current, float):
            value = float(value)
        elif element in ("float", "double"):
            value = [float(part) for part in value]
        try:
            setattr(message, name, value)
        except (AssertionError, TypeError, ValueError, OverflowError) as error:
            raise agent.RequestError(f"{type(message).__name__}.{name}: {' '.join(str(error).split())}") from None
    return message


def selected(data, fields):
    """The parts of plain data that are compared: all without fields, else those at these paths."""
    if not fields:
        return data
    parts = {}
    for field in fields:
        value = data
        for name in field.split("."):
            if not isinstance(value, dict) or name not in value:
                raise agent.RequestError(f"field {field!r}: the message has none of this name")
            value = value[name]
        parts[field] = value
    return parts


# ---- the node --------------------------------------------------------------------------------------------------------
class Driver(agent.Agent):
    """Publishes the inputs of a trial, and records outputs."""

    def __init__(self, frames):
        super().__init__(frames)
        self._inputs = []
        self._records = []
        self._counts = {}
        self._numbers = {}

    def do_outputs(self, outputs, with_numbers):
        """Record topics from now on: each has `topic` and `fields`, type (`kind`) and quality of service.

        The latter are `reliable` and `latched`; if not known ("", None), they are those of the publishers.

        With `with_numbers`, the numbers of each message are recorded, too.
        """
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        matched = []
        for output in outputs:
            kind, qos = self._matching(output["topic"], output["kind"], output["reliable"], 0.0)
            if output["latched"]:
                qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
            self._record(output["topic"], kind, qos, output["fields"], with_numbers)
            is_reliable = qos.reliability == ReliabilityPolicy.RELIABLE
            is_latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
            matched.append({"kind": kind, "reliable": is_reliable, "latched": is_latched})
        return {"outputs": matched}

    def _record(self, topic, kind, qos, fields, with_numbers):
        from rclpy.serialization import deserialize_message

        message_class = agent.message_class(kind)
        self._counts[topic] = 0
        self._numbers[topic] = []

        def arrived(content):
            try:
                message = deserialize_message(bytes(content), message_class)
                data = selected(plain(message), fields)
                if with_numbers:
                    self._numbers[topic].append(list(numbers(message)))
            except agent.RequestError as error:
                data = {"error": str(error)}
            except Exception as error:  # noqa: BLE001 - a fault may have made it so
                data = {"undecodable": f"{type(error).__name__}: {error}"}
            self._counts[topic] += 1
            self._records.append([topic, data, time.time()])

        self._subscriptions[topic] = self._subscribe(topic, kind, qos, arrived)

    def do_inputs(self, inputs, content=b""):
        """Prepare the inputs: each has `topic`, `kind`, `offset_s`, and `data`, or as many bytes as `size` says."""
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rclpy.serialization import deserialize_message

        of_messages = []
        for entry in inputs:
            topic = entry["topic"]
            message_class = agent.message_class(entry["kind"])
            if topic not in self._publishers:
                # Readers of latched topics match only publishers that keep messages; the others match them, too.
                qos = QoSProfile(depth=agent.DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
                self._publishers[topic] = self.node.create_publisher(message_class, topic, qos)
            if entry.get("size"):
                message = content[: entry["size"]]
                content = content[entry["size"] :]
                decoded = deserialize_message(message, message_class)
            else:
                message = decoded = fill(message_class(), entry["data"])
                if has_now(entry["data"]):
                    message = functools.partial(fill, decoded, entry["data"])
            self._inputs.append((topic, message, entry["offset_s"]))
            of_messages.append(list(numbers(decoded)))
        return {"numbers": of_messages}

    def do_await(self, topics, pids, limit_s):
        """Wait until all inputs are read and all topics published, or a process has ended; says what is missing."""

        def missing():
            unread = [topic for topic, publisher in self._publishers.items() if not publisher.get_subscription_count()]
            unpublished = [topic for topic in topics if not self.node.count_publishers(topic)]
            return [f"nobody reads {topic}" for topic in unread] + [
                f"nobody publishes {topic}" for topic in unpublished
            ]

        self._spin_until(lambda: not missing() or any(map(has_exited, pids)), limit_s)
        if self._has_careless_reader():
            self._spin_until(lambda: False, LATE_S)
        return {"missing": missing()}

    def _has_careless_reader(self):
        """Whether a reader of an input may lose messages that come before it has found their publisher."""
        return any(
            reader["reliability"] != "reliable" or reader["durability"] == "transient_local"
            for topic in self._publishers
            for reader in self._endpoints(topic)[1]
        )

    def do_play(self, answers, pids, watched, patience_s, expected, settle):
        """Publish inputs and wait for outputs; returns what was recorded since the last call.

        Inputs without an offset wait for an output on some topics; the others are published at their offset (s) from
        the first one.  With a script (`watched`: its process) the inputs are those of the script.

        Args:
            answers: These topics.
            pids: Processes of the stack; it is over when one has ended.
            watched: Process whose end is the end of the inputs; 0 = none.
            patience_s: Time limit of an output.
            expected: Number of outputs by topic, since the start; None = unknown.
            settle: Whether to wait for outputs that nobody expects.
        """
        missed = False
        is_silent = False
        begin = time.monotonic()

        def is_gone():
            return any(has_exited(pid) for pid in pids)

        for topic, message, offset_s in self._inputs:
            if offset_s is not None:
                self._spin_until(is_gone, max(0.0, begin + offset_s - time.monotonic()))
            if is_gone():
                break
            before = {answer: self._counts[answer] for answer in answers}
            self._publish(topic, message)
            if offset_s is None:
                limit_s = min(patience_s, SLOW_S)
                if is_silent:
                    limit_s = MISSED_S
                is_silent = not self._wait_for_all(before, limit_s, is_gone)
                missed = missed or is_silent
        while watched and not is_gone() and not has_exited(watched):
            self._executor.spin_once(timeout_sec=0.01)

        # Late outputs; with some lost on their way, there is nothing to wait for.
        if expected is not None and (is_silent or not missed):

            def is_complete():
                return is_gone() or all(self._counts[topic] >= count for topic, count in expected.items())

            is_silent = not self._spin_until(is_complete, patience_s) and is_silent
        if settle:
            self._spin_until(lambda: False, LAST_S)
        played = {
            "outputs": self._records,
            "numbers": self._numbers,
        }
        self._records = []

        # What was missed last may have been lost, too: the stack is alive if it answers the same input once more.
        if is_silent and not is_gone():
            topic, message, _ = self._inputs[-1]
            before = {answer: self._counts[answer] for answer in answers}
            self._publish(topic, message)
            is_silent = not self._wait_for_all(before, patience_s, is_gone)
        return {"is_silent": is_silent, "is_gone": is_gone(), **played}

    def _publish(self, topic, message):
        """Publish an input; one with the time of now is filled first."""
        if callable(message):
            message = message()
        self._publishers[topic].publish(message)

    def _wait_for_all(self, before, limit_s, is_gone):
        """Wait until there is an output on each topic; returns whether there is."""
        end = time.monotonic() + limit_s
        next_look = 0.0
        while True:
            if all(self._counts[topic] > before[topic] for topic in before):
                return True
            now = time.monotonic()
            if now > next_look:
                if is_gone():
                    end = min(end, now + LAST_S)  # what it has sent before may still arrive
                next_look = now + 0.01
            if now > end:
                return False
            self._executor.spin_once(timeout_sec=0.005)


def main(descriptor):
    """Serve one trial over a socket."""
    frames = agent.Frames(socket.socket(fileno=descriptor))
    try:
        driver = Driver(frames)
    except Exception as error:  # noqa: BLE001 - whatever the reason, it is for people
        frames.send({"event": "failed", "text": " ".join(f"{type(error).__name__}: {error}".split())})
        os._exit(1)

    def listen():
        while True:
            request = frames.receive()
            if request is None:
                os._exit(0)
            driver.ask(request)

    threading.Thread(target=listen, daemon=True).start()
    frames.send({"event": "ready", "pid": os.getpid()})
    driver.run()
    os._exit(0)
