"""A hidden node of mavfi in a ROS 2 graph; runs under the Python of a ROS 2 installation, without mavfi.

    python agent.py FD

FD is a connected socket that the process inherits; `mavfi.extras.ros.ros2.graph.AgentClient` holds its other end.
Both directions carry frames: a line of JSON, and as many raw bytes as its key "bytes" says (0 if it is missing).

    request      {"id": 3, "do": "publish", "topic": "/odom", ..., "bytes": 52} and a serialized message
    reply        {"id": 3, ...results...} or {"id": 3, "error": "one line"}
    event        {"event": "ready" | "message" | "notice", ...}, at any time

The process ends when the socket is closed, or when its parent is gone. It needs Python 3.10, rclpy and the standard
library; rclpy is imported after the check of arguments, so that its absence is said in one line.
"""

import sys

if __name__ == "__main__":
    sys.path.pop(0)  # this file's folder: its other modules must not stand in for modules of this Python

import importlib
import json
import os
import queue
import re
import signal
import socket
import threading
import time

NODE_PREFIX = "_mavfi_agent_"
"""Begin of the node's name; ROS hides names that begin with an underscore."""
POLL_S = 0.25
"""How often a gone parent is noticed, if another process still holds the socket (s)."""
END_S = 10.0
"""Time to leave the graph before the process ends anyway (s)."""
MATCH_S = 0.2
"""Time for a publisher to find a subscription that has found it (s)."""
MATCH_LIMIT_S = 2.0
"""Time limit for subscriptions to find publishers before messages are counted (s)."""
QUIET_S = 0.5
"""A graph that has not changed for this time is quiet (s)."""
BATCH = 100
"""Most messages of a topic that are taken before another topic has its turn."""
DEPTH = 1000
"""Messages that are kept for this node, or for a late reader of its topics."""
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""Name of an endpoint's node until ROS has discovered the node."""


class RequestError(Exception):
    """A request that cannot be met; its text is one line for people."""


# ---- frames ----------------------------------------------------------------------------------------------------------
class Frames:
    """Frames over a socket."""

    def __init__(self, connection):
        self._connection = connection
        self._stream = connection.makefile("rb")

    def send(self, header, content=b""):
        """Send a frame; raises `OSError` if the other side is gone."""
        if content:
            header = dict(header, bytes=len(content))
        self._connection.sendall(json.dumps(header).encode() + b"\n" + content)

    def receive(self):
        """The next frame: its header and its bytes; None at the end."""
        try:
            line = self._stream.readline()
            if not line.endswith(b"\n"):
                return None
            header = json.loads(line)
            size = header.pop("bytes", 0)
            content = self._stream.read(size)
        except OSError:
            return None
        if len(content) < size:
            return None
        return header, content


# ---- message types ---------------------------------------------------------------------------------------------------
def full_name(kind):
    """Name of a message type with its folder: "std_msgs/msg/String", also of "std_msgs/String"."""
    parts = kind.split("/")
    if len(parts) == 2:
        parts.insert(1, "msg")
    if len(parts) != 3 or not all(part.isidentifier() for part in parts):
        raise RequestError(f"type {kind!r}: allowed: names such as std_msgs/msg/String")
    return "/".join(parts)


FEEDBACK = "_FeedbackMessage"
"""How the type of an action's feedback topic ends."""


def message_class(kind):
    """The Python class of a message type."""
    package, folder, name = full_name(kind).split("/")
    action = name.removesuffix(FEEDBACK)
    try:
        module = importlib.import_module(f"{package}.{folder}")
        if folder == "action" and action != name:
            return getattr(module, action).Impl.FeedbackMessage
        return getattr(module, name)
    except (ImportError, AttributeError) as error:
        raise RequestError(f"type {kind}: this ROS installation has no Python class of it ({error})") from None


def definition_text(kind):
    """Text of the file that defines a message type, from the prefixes of this installation."""
    package, folder, name = full_name(kind).split("/")
    ending = "msg"
    if folder == "action":
        # The parts of an action have no files of their own: its file holds goal, result and feedback.
        ending = "action"
        if name.endswith(FEEDBACK):
            part = kind.removesuffix(FEEDBACK) + "_Feedback"
            return f"unique_identifier_msgs/UUID goal_id\n{part} feedback\n"
        name = name.removesuffix("_Feedback")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = os.path.join(prefix, "share", package, folder, f"{name}.{ending}")
        if prefix and os.path.isfile(path):
            with open(path, encoding="utf-8") as file:
                text = file.read()
            if folder == "action":
                return re.split(r"^---.*$", text, flags=re.MULTILINE)[2]
            return text
    raise RequestError(f"type {kind}: no file {package}/{folder}/{name}.{ending} in this ROS installation")


# ---- the node --------------------------------------------------------------------------------------------------------
def endpoint_data(info):
    """Plain data of a publisher or subscription of the graph."""
    qos = info.qos_profile
    namespace = info.node_namespace.rstrip("/")
    return {
        "node": f"{namespace}/{info.node_name}",
        "kind": info.topic_type,
        "gid": bytes(info.endpoint_gid).hex(),
        "reliability": qos.reliability.name.lower(),
        "durability": qos.durability.name.lower(),
    }


class Agent:
    """The node, and what it does on request.

    Each method whose name begins with `do_` meets the request of that name: it takes the request's keys, and returns
    those of the reply.
    """

    def __init__(self, frames):
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.parameter import Parameter
        from rclpy.signals import SignalHandlerOptions

        # no log file, no messages on /rosout
        self._frames = frames
        self._context = Context()
        rclpy.init(
            args=["--ros-args", "--disable-external-lib-logs", "--disable-rosout-logs"],
            context=self._context,
            signal_handler_options=SignalHandlerOptions.NO,
        )

        # a node without services and topics: those that every node of rclpy has are removed
        self.node = rclpy.create_node(
            f"{NODE_PREFIX}{os.getpid()}",
            context=self._context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        for publisher in list(self.node.publishers):
            self.node.destroy_publisher(publisher)

        # requests wake the executor: all of ROS is done in one thread
        self._requests = queue.Queue()
        self._wake = self.node.create_guard_condition(lambda: None)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

        self._began = time.monotonic()
        self._subscriptions = {}
        self._publishers = {}
        self._sim_time = None  # ns of the last message on /clock
        self._clock = None
        self._is_over = False

    def ask(self, request):
        """Let the thread of `run` meet a request: header and content."""
        self._requests.put(request)
        self._wake.trigger()

    def stop(self):
        """Let `run` return, also out of a request."""
        self._is_over = True
        self._wake.trigger()

    def run(self):
        """Meet requests and pass messages on until the client is gone."""
        parent = os.getppid()
        while not self._is_over and os.getppid() == parent:
            self._executor.spin_once(timeout_sec=POLL_S)
            self._meet_requests()

    def close(self):
        """Leave the graph."""
        self.node.destroy_node()
        self._context.shutdown()

    def _meet_requests(self):
        while not self._is_over:
            try:
                header, content = self._requests.get_nowait()
            except queue.Empty:
                return
            number = header.pop("id")
            action = getattr(self, "do_" + header.pop("do"))
            try:
                if content:
                    header["content"] = content
                reply = action(**header) or {}
            except RequestError as error:
                reply = {"error": str(error)}
            except Exception as error:  # noqa: BLE001 - whatever ROS raises is an answer, not the end
                reply = {"error": " ".join(f"{type(error).__name__}: {error}".split())}
            self._send(dict(reply, id=number))

    def _send(self, header, content=b""):
        try:
            self._frames.send(header, content)
        except OSError:
            self._is_over = True

    def _spin_until(self, condition, seconds):
        """Go on with ROS until a condition holds, or for a duration (s); returns whether it holds."""
        end = time.monotonic() + seconds
        while not condition():
            left = end - time.monotonic()
            if left <= 0 or self._is_over:
                return False
            # Other requests wait meanwhile: the client sends one at a time.
            self._executor.spin_once(timeout_sec=min(left, 0.02))
        return True

    # ---- the graph ---------------------------------------------------------------------------------------------------
    def do_snapshot(self, least_s, limit_s):
        """Nodes, topics, services and actions, once the graph is quiet.

        Not before `least_s` from the start of this node, as discovery takes time, and at the latest after `limit_s`.
        """
        last_fingerprint = self._fingerprint()
        last_change = time.monotonic()

        def is_quiet():
            nonlocal last_fingerprint, last_change
            fingerprint = self._fingerprint()
            if fingerprint != last_fingerprint:
                last_fingerprint = fingerprint
                last_change = time.monotonic()
            now = time.monotonic()
            return now >= self._began + least_s and now >= last_change + QUIET_S

        self._spin_until(is_quiet, limit_s)
        return self._snapshot()

    def _fingerprint(self):
        """Something that differs when the graph has changed."""
        topics = self.node.get_topic_names_and_types()
        counts = [(name, self.node.count_publishers(name), self.node.count_subscribers(name)) for name, _ in topics]
        services = self.node.get_service_names_and_types()
        return sorted(self.node.get_node_names_and_namespaces()), sorted(counts), sorted(services)

    def _snapshot(self):
        from rclpy.action import get_action_names_and_types
        from rclpy.utilities import get_rmw_implementation_identifier

        topics = []
        for name, kinds in sorted(self.node.get_topic_names_and_types()):
            publishers, subscribers = self._endpoints(name)
            topics.append({"name": name, "kinds": kinds, "publishers": publishers, "subscribers": subscribers})

        # A service is a topic of requests, which its server reads, and one of replies.
        services = []
        for name, kinds in sorted(self.node.get_service_names_and_types()):
            clients, servers = self._endpoints(f"rq{name}Request", no_mangle=True)
            services.append({"name": name, "kinds": kinds, "servers": servers, "clients": clients})
        actions = [{"name": name, "kinds": kinds} for name, kinds in sorted(get_action_names_and_types(self.node))]
        nodes = [f"{namespace.rstrip('/')}/{name}" for name, namespace in self.node.get_node_names_and_namespaces()]
        return {
            "nodes": sorted(name for name in nodes if f"/{NODE_PREFIX}" not in name),
            "topics": [topic for topic in topics if topic["publishers"] or topic["subscribers"]],
            "services": [service for service in services if service["servers"] or service["clients"]],
            "actions": actions,
            "rmw": get_rmw_implementation_identifier(),
            "domain": self._context.get_domain_id(),
        }

    def _endpoints(self, topic, no_mangle=False):
        """Publishers and subscriptions of a topic, without those of agents."""
        pair = []
        for infos in (
            self.node.get_publishers_info_by_topic(topic, no_mangle),
            self.node.get_subscriptions_info_by_topic(topic, no_mangle),
        ):
            endpoints = [endpoint_data(info) for info in infos]
            pair.append([endpoint for endpoint in endpoints if f"/{NODE_PREFIX}" not in endpoint["node"]])
        return pair

    def _writers(self, topic):
        """Publishers of a topic, also those of other agents."""
        return [endpoint_data(info) for info in self.node.get_publishers_info_by_topic(topic)]

    def do_wait(self, topic, publishers, subscribers, limit_s):
        """Wait until a topic has enough publishers and subscriptions of others, by name known to ROS."""

        def known(endpoints):
            return sum(UNKNOWN_NODE not in endpoint["node"] for endpoint in endpoints)

        def is_there():
            writers, readers = self._endpoints(topic)
            return known(writers) >= publishers and known(readers) >= subscribers

        return {"holds": self._spin_until(is_there, limit_s)}

    # ---- messages ----------------------------------------------------------------------------------------------------
    def do_subscribe(self, topic, kind, reliable, limit_s):
        """Pass serialized messages of a topic on.

        Without a type or reliability, those of the topic's publishers are taken: then one must be there within the
        limit (s).
        """
        if topic in self._subscriptions:
            raise RequestError(f"topic {topic}: is subscribed to already")
        self._follow_clock()
        kind, qos = self._matching(topic, kind, reliable, limit_s)

        def arrived(message):
            header = {"event": "message", "topic": topic, "wall_ns": time.time_ns(), "sim_ns": self._sim_time}
            self._send(header, bytes(message))

        self._subscriptions[topic] = self._subscribe(topic, kind, qos, arrived)
        return {"kind": kind, "reliability": qos.reliability.name.lower(), "durability": qos.durability.name.lower()}

    def _matching(self, topic, kind, reliable, limit_s):
        """Type and quality of service with which a subscription gets messages of all publishers of a topic."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        writers = []
        if not kind or reliable is None:
            is_there = self._spin_until(lambda: self._writers(topic), limit_s)
            if not is_there:
                raise RequestError(f"topic {topic}: nobody publishes it")
            writers = self._writers(topic)
        kinds = sorted({writer["kind"] for writer in writers})
        if not kind and len(kinds) > 1:
            raise RequestError(f"topic {topic}: published with types {', '.join(kinds)}; allowed: one")
        if reliable is None:
            reliable = all(writer["reliability"] == "reliable" for writer in writers)
        qos = QoSProfile(depth=DEPTH)
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
        if reliable:
            qos.reliability = ReliabilityPolicy.RELIABLE
        # Only of publishers that keep messages can earlier ones be had.
        if writers and all(writer["durability"] == "transient_local" for writer in writers):
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        return full_name(kind or kinds[0]), qos

    def _subscribe(self, topic, kind, qos, arrived):
        """Subscribe to serialized messages; the client is notified of publishers that do not match."""

        def mismatch(event):
            name = getattr(event.last_policy_kind, "name", "quality of service")
            policy = name.removeprefix("RMW_QOS_POLICY_").lower()
            text = f"topic {topic}: the {policy} of a publisher does not match: it is not read"
            self._send({"event": "notice", "text": text})

        try:
            from rclpy.event_handler import SubscriptionEventCallbacks
        except ImportError:  # before Iron
            from rclpy.qos_event import SubscriptionEventCallbacks
        callbacks = SubscriptionEventCallbacks(incompatible_qos=mismatch)
        message_type = message_class(kind)

        # The executor takes one message per turn, which costs 0.2 ms: take those that wait behind it as well.
        def arrived_first(message):
            arrived(message)
            with subscription.handle:
                for _ in range(BATCH):
                    message_and_info = subscription.handle.take_message(message_type, True)
                    if message_and_info is None:
                        return
                    arrived(message_and_info[0])

        subscription = self.node.create_subscription(
            message_type, topic, arrived_first, qos, raw=True, event_callbacks=callbacks
        )
        return subscription

    def do_unsubscribe(self, topic):
        """Stop passing messages on."""
        subscription = self._subscriptions.pop(topic, None)
        if subscription is not None:
            self.node.destroy_subscription(subscription)

    def do_rates(self, topics, seconds):
        """Messages per second of each topic; a topic that cannot be read has a reason instead."""
        import rclpy.subscription
        from rclpy.qos import DurabilityPolicy

        counts = {}
        reasons = {}
        subscriptions = []
        for topic in topics:
            counts[topic] = 0

            def arrived(_, topic=topic):
                counts[topic] += 1

            try:
                kind, qos = self._matching(topic, "", None, 0.0)
                qos.durability = DurabilityPolicy.VOLATILE  # what was sent before does not count
                subscriptions.append(self._subscribe(topic, kind, qos, arrived))
            except RequestError as error:
                reasons[topic] = str(error)
                del counts[topic]

        # Count only when the publishers have found the subscriptions: soon after the subscriptions have found them.
        def are_matched():
            return all(len(self._writers(each.topic_name)) <= each.get_publisher_count() for each in subscriptions)

        if hasattr(rclpy.subscription.Subscription, "get_publisher_count"):  # since Jazzy
            self._spin_until(are_matched, MATCH_LIMIT_S)
        self._spin_until(lambda: False, MATCH_S)
        for topic in counts:
            counts[topic] = 0
        began = time.monotonic()
        self._spin_until(lambda: False, seconds)
        spent = time.monotonic() - began
        for subscription in subscriptions:
            self.node.destroy_subscription(subscription)
        return {"rates": {topic: count / spent for topic, count in counts.items()}, "reasons": reasons}

    def do_advertise(self, topic, kind, reliable, latched, subscribers, limit_s):
        """Publish a topic from now on; waits until it has enough subscriptions, and says whether it has.

        Without their number: as many as the graph has now.
        """
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        if topic not in self._publishers:
            qos = QoSProfile(depth=DEPTH)
            if not reliable:
                qos.reliability = ReliabilityPolicy.BEST_EFFORT
            if latched:
                qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
            self._publishers[topic] = self.node.create_publisher(message_class(kind), topic, qos)
        publisher = self._publishers[topic]
        if subscribers is None:
            subscribers = self.node.count_subscribers(topic)
        return {"holds": self._spin_until(lambda: publisher.get_subscription_count() >= subscribers, limit_s)}

    def do_publish(self, topic, count, period_s, content=b""):
        """Publish a serialized message, or several copies of it with a pause between them (s)."""
        publisher = self._publisher(topic)
        due = time.monotonic()
        for _ in range(count):
            if period_s:
                self._spin_until(lambda due=due: time.monotonic() >= due, max(0.0, due - time.monotonic()))
                due += period_s
            publisher.publish(content)
        return {"wall_ns": time.time_ns()}

    def do_say(self, topic, text):
        """Publish a text on a topic of type std_msgs/msg/String."""
        self._publisher(topic).publish(message_class("std_msgs/msg/String")(data=text))

    def _publisher(self, topic):
        if topic not in self._publishers:
            raise RequestError(f"topic {topic}: is not advertised here")
        return self._publishers[topic]

    # ---- time and types ----------------------------------------------------------------------------------------------
    def do_time(self, limit_s):
        """Instants by the wall and by /clock (ns); the latter is None if nobody publishes it."""
        self._follow_clock()
        if self._clock is not None:
            self._spin_until(lambda: self._sim_time is not None, limit_s)
        return {"wall_ns": time.time_ns(), "sim_ns": self._sim_time}

    def _follow_clock(self):
        """Read /clock from now on, if somebody publishes it."""
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rosgraph_msgs.msg import Clock

        def ticked(message):
            self._sim_time = message.clock.sec * 10**9 + message.clock.nanosec

        if self._clock is None and self._writers("/clock"):
            qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._clock = self.node.create_subscription(Clock, "/clock", ticked, qos)

    def do_definition(self, kind):
        """Text of a message type's definition."""
        return {"text": definition_text(kind)}


def main():
    """Serve one client over an inherited socket."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is for the client, which closes the socket
    frames = Frames(socket.socket(fileno=int(sys.argv[1])))
    try:
        agent = Agent(frames)
    except Exception as error:  # noqa: BLE001 - no rclpy, or no ROS: whatever the reason, it is for people
        frames.send({"event": "failed", "text": " ".join(f"{type(error).__name__}: {error}".split())})
        return 1

    def listen():
        while True:
            request = frames.receive()
            if request is None:
                agent.stop()
                time.sleep(END_S)  # should ROS never come back, the process still ends
                os._exit(1)
            agent.ask(request)

    threading.Thread(target=listen, daemon=True).start()
    frames.send({"event": "ready", "pid": os.getpid(), "python": sys.version.split()[0]})
    agent.run()
    agent.close()
    return 0


if __name__ == "__main__":
    code = main()
    # the daemon thread waits for the socket: interpreters that clean up under it may crash
    sys.stderr.flush()
    os._exit(code)
