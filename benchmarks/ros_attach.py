"""Measures the cost of attaching: message latency with and without mavfi as a relay, and stop time of a target.

Needs ROS 1 and a private network: `unshare -n .venv/bin/python benchmarks/ros_attach.py`.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mavfi.extras.registers import inject
from mavfi.extras.ros.node.message import Composer
from mavfi.extras.ros.node.peer import Outlet
from mavfi.extras.ros.processes import loopback_up
from mavfi.faults.fault import DEFAULT_WALK, RegisterFault
from mavfi.record import Injection
from tests.extras.ros.node.node_bench import MASTER_URI, POSITION, TARGET, URDF, NodeBench

MESSAGES = 500
ROUNDS = 3
INJECTIONS = 100
PERIOD_S = 0.002
TOPIC = "/speed"
READER = """
import sys, time
from mavfi.extras.ros.node.master import Master
from mavfi.extras.ros.node.peer import Peer

def arrived(message):
    sys.stdout.buffer.write(time.perf_counter_ns().to_bytes(8, "little"))
    sys.stdout.flush()

Peer(Master(), "/reader").subscribe("/speed", arrived)
time.sleep(3600)
"""
"""Reports the arrival time of each message; all processes share one monotonic clock."""
RELAY = ["-m", "mavfi", "ros", "corrupt", "--topic", TOPIC, "--field", "position[0]", "--at", "1000000000"]


def latencies(outlet: Outlet, message: bytes, reader: subprocess.Popen) -> list[float]:
    """Latencies from sending to arrival in another process (us) of a series of messages."""
    found = []
    assert reader.stdout is not None
    for _ in range(MESSAGES):
        sent = time.perf_counter_ns()
        outlet.send(message)
        found.append((int.from_bytes(reader.stdout.read(8), "little") - sent) / 1000)
        time.sleep(PERIOD_S)
    return found


def show(name: str, values: Sequence[float]) -> None:
    """Print median, quantiles and maximum."""
    ordered = sorted(values)
    p95, p99 = (ordered[int(share * len(ordered))] for share in (0.95, 0.99))
    median = statistics.median(ordered)
    print(f"{name:32} p50 {median:7.0f} us   p95 {p95:7.0f} us   p99 {p99:7.0f} us   max {ordered[-1]:7.0f} us")


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until a condition holds."""
    while not condition():
        time.sleep(0.01)


def measure_relay(bench: NodeBench) -> None:
    """Latency of a joint state between two processes, direct and relayed by mavfi, alternating."""
    composer = Composer("sensor_msgs/JointState")
    message = composer.pack({"name": ["a", "b"], "position": [0.5, 0.25]})
    outlet = bench.peer("/writer").advertise(TOPIC, composer.header)
    straight, relayed = [], []
    with subprocess.Popen([sys.executable, "-c", READER], stdout=subprocess.PIPE) as reader:
        wait_for(lambda: outlet.reader("/reader"))
        for _ in range(ROUNDS):
            straight += latencies(outlet, message, reader)
            with subprocess.Popen([sys.executable, *RELAY], stdout=subprocess.DEVNULL) as relay:
                wait_for(lambda: outlet.reader("/mavfi") and not outlet.reader("/reader"))
                time.sleep(0.2)
                relayed += latencies(outlet, message, reader)
                relay.kill()
            wait_for(lambda: outlet.reader("/reader") and not outlet.reader("/mavfi"))
        reader.kill()
    show("straight", straight)
    show("through mavfi", relayed)
    print(f"{'added':32} p50 {statistics.median(relayed) - statistics.median(straight):7.0f} us")


def measure_stops(bench: NodeBench) -> None:
    """Stop time of robot_state_publisher for an injection at a symbol."""
    bench.master.call("setParam", "/robot_description", URDF)
    process = bench.start([TARGET, "_publish_frequency:=10000.0"])
    bench.wait_for_node("/robot_state_publisher", process)
    composer = Composer("sensor_msgs/JointState")
    outlet = bench.peer().advertise("/joint_states", composer.header)
    message = composer.pack({"name": ["shoulder", "elbow"], "position": POSITION})
    for walk in (1, DEFAULT_WALK):
        fault = RegisterFault(symbol="SubscriptionQueue4call", walk=walk, null=True, timeout=20.0)
        done: list[Injection] = []
        injecting = threading.Thread(target=inject, args=(process.pid, fault, INJECTIONS, 0.0, done.append))
        injecting.start()
        while injecting.is_alive():
            outlet.send(message)
            time.sleep(0.005)
        show(f"stands still, walk {walk}", [injection.details["stopped_us"] for injection in done])


def main() -> None:
    """Print all results."""
    loopback_up()
    os.environ["ROS_MASTER_URI"] = MASTER_URI
    with tempfile.TemporaryDirectory() as folder, NodeBench(Path(folder)) as bench:
        measure_relay(bench)
        measure_stops(bench)


if __name__ == "__main__":
    main()
