"""Measures what faults in ROS 2 messages cost: `publish()`, the latency of a round trip, attaching, and killing mavfi.

Needs ROS 2 (`mavfi ros setup`), g++, and a private network with its own /dev/shm; it makes these by itself:

    make bench NAME=ros2_interposer        # all, and writes them to the page; ARGS="publish latency attach kill": parts
"""

import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mavfi.extras.ros.ros2.environment import Installation, find_installation
from mavfi.extras.ros.ros2.interposer.attach import Attachments
from mavfi.extras.ros.ros2.interposer.page import ControlPage, InterposedFault
from mavfi.faults.changes import Change, When
from mavfi.faults.operations import Operation
from tools.markers import between

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "ros2.md"
PAIRS = 10
PUBLISHED = 200_000
ROUND_TRIPS = 20_000
ATTACHES = 100
KILLS = 200
KIND = "std_msgs/msg/Float64MultiArray"
ISOLATED = "MAVFI_BENCHMARK_ISOLATED"
FLIP = Operation("flip", bit=51)
NEVER = When(first=10**15)
ALWAYS = When(times=0)
PUMP = """
import sys, time, threading, rclpy
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import Float64MultiArray
rclpy.init()
node = rclpy.create_node("pump_" + sys.argv[1])
topic = "/pump_" + sys.argv[1]
publisher = node.create_publisher(Float64MultiArray, topic, 100)
if sys.argv[2] == "watch":
    def take(message):
        print(message.data[0], int(message.data[1] != 1.0), flush=True)
    node.create_subscription(Float64MultiArray, topic, take, 1000)
    rclpy.spin(node)
def tick():
    publisher.publish(Float64MultiArray(data=[time.time(), 1.0, 2.0]))
def churn():
    while True:
        blocks = [bytearray(7 * size) for size in range(200)]
        time.sleep(0.0005)
for _ in range(4):
    node.create_timer(0.004, tick)
threading.Thread(target=churn, daemon=True).start()
executor = MultiThreadedExecutor(4)
executor.add_node(node)
executor.spin()
"""
"""A node that publishes 1,000 messages a second from four threads while another one allocates; or one that watches."""
VICTIM = """
import sys, time
from benchmarks.ros2_interposer import ALWAYS, FLIP, KIND
from mavfi.faults.changes import Change
from mavfi.extras.ros.ros2.interposer.attach import Attachments
from mavfi.extras.ros.ros2.interposer.page import ControlPage, InterposedFault
print("ready", flush=True)
page = ControlPage()
while True:
    with Attachments(page) as attachments:
        attachments.attach(int(sys.argv[1]))
        page.arm([InterposedFault(sys.argv[2], "data[1]", Change(FLIP, ALWAYS), type=KIND)])
        time.sleep(0.02)
"""
"""A mavfi that attaches, injects and detaches until it is killed."""


def compiled(installation: Installation, folder: Path) -> Path:
    """The peer in C++."""
    includes = [f"-I{path}" for path in sorted((installation.prefix / "include").iterdir())]
    source = Path(__file__).with_name("ros2_peer.cpp")
    command = ["g++", "-O2", "-std=c++17", "-rdynamic", *includes, str(source), "-o", str(folder / "peer")]
    command += [f"-L{installation.prefix}/lib", "-lrcl", "-lrcutils", "-lrmw", "-lrosidl_typesupport_cpp"]
    subprocess.run([*command, "-lstd_msgs__rosidl_typesupport_cpp", "-Wl,--allow-shlib-undefined"], check=True)
    return folder / "peer"


RESULTS: list[str] = []


def show(line: str) -> None:
    """Print a result, and keep it for the page."""
    print(line, flush=True)
    RESULTS.append(line)


def paired(name: str, measure: Callable[[int], tuple[float, float]]) -> None:
    """Print the ratios of pairs: their median, and a 95 % interval of the mean."""
    pairs = [measure(index) for index in range(PAIRS)]
    ratios = [second / first for first, second in pairs]
    mean = statistics.fmean(ratios)
    half = 2.262 * statistics.stdev(ratios) / PAIRS**0.5  # Student's t with 9 degrees of freedom
    firsts = statistics.median(first for first, _ in pairs)
    seconds = statistics.median(second for _, second in pairs)
    show(
        f"{name}: {firsts:.2f} → {seconds:.2f}; ratio {statistics.median(ratios):.3f} (median), "
        f"{mean:.3f} [{mean - half:.3f}, {mean + half:.3f}] (mean, 95 %) of {PAIRS} pairs"
    )


def output(command: Sequence[str], installation: Installation, **variables: str) -> float:
    """The number that a program prints."""
    done = subprocess.run(command, env=installation.environment(**variables), stdout=subprocess.PIPE, check=True)
    return float(done.stdout)


def measure_publish(installation: Installation, peer: Path) -> None:
    """Time of rcl_publish with a reader: without the interposer, with it idle, and with every message changed."""
    with ControlPage() as page, Reader(installation, peer):
        for size in (100, 1_000_000):
            command = [str(peer), "publish", str(PUBLISHED * 10 // (size + 10) + 200), str(size)]

            def both(index: int, *, preloaded: bool, command: list[str] = command) -> tuple[float, float]:
                """A pair of runs, in alternating order."""
                if preloaded:
                    page.disarm()
                runs = [
                    lambda: output(command, installation),
                    lambda: output(command, installation, **page.environment()),
                ]
                order = [0, 1] if index % 2 == 0 else [1, 0]
                times = {run: runs[run]() for run in order}
                return times[0], times[1]

            paired(f"publish of {size:,} bytes, idle (ns)", lambda index: both(index, preloaded=True))
            page.arm([InterposedFault("/ping", "data[1]", Change(FLIP, ALWAYS))])
            paired(f"publish of {size:,} bytes, each changed (ns)", lambda index: both(index, preloaded=False))
            page.disarm()
            page.reports()


class Reader:
    """A process that reads what is published, without the interposer; a context manager."""

    def __init__(self, installation: Installation, peer: Path) -> None:
        self._process = subprocess.Popen([str(peer), "echo"], env=installation.environment())

    def __enter__(self) -> "Reader":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()


def measure_latency(installation: Installation, peer: Path) -> None:
    """Median round trip between two processes, with and without an armed interposer in both."""
    command = [str(peer), "ping", str(ROUND_TRIPS)]

    def round_trip(**variables: str) -> float:
        echo = subprocess.Popen([str(peer), "echo"], env=installation.environment(**variables))
        try:
            return output(command, installation, **variables)
        finally:
            echo.kill()
            echo.wait()

    with ControlPage() as page:
        for name, when in (("armed, not due", NEVER), ("each message changed", ALWAYS)):
            page.arm([InterposedFault(topic, "data[1]", Change(FLIP, when)) for topic in ("/ping", "/pong")])

            def both(index: int) -> tuple[float, float]:
                domain = 10 + index
                direct = {"ROS_DOMAIN_ID": str(2 * domain)}
                armed = {"ROS_DOMAIN_ID": str(2 * domain + 1), **page.environment()}
                if index % 2 == 0:
                    first = round_trip(**direct)
                    return first, round_trip(**armed)
                second = round_trip(**armed)
                return round_trip(**direct), second

            paired(f"round trip, {name} (us)", both)


class Pumps:
    """Nodes that are busy, two of each distribution; a context manager that ends them."""

    def __init__(self) -> None:
        self.installations = [find_installation("jazzy"), find_installation("kilted")] * 2
        self.processes: list[subprocess.Popen[str]] = []

    def start(self, number: int, what: str) -> "subprocess.Popen[str]":
        """A pump, or one that watches it."""
        installation = self.installations[number]
        command = [installation.python, "-c", PUMP, str(number), what]
        stdout = subprocess.PIPE if what == "watch" else None
        process = subprocess.Popen(command, env=installation.environment(), stdout=stdout, text=True)
        self.processes.append(process)
        return process

    def __enter__(self) -> "Pumps":
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


def measure_attach() -> None:
    """Attach to busy nodes again and again; each time a message must be changed."""
    times = []
    failures = 0
    with Pumps() as pumps, ControlPage() as page:
        processes = [pumps.start(number, "pump") for number in range(4)]
        time.sleep(4.0)
        for round_number in range(ATTACHES):
            for number, process in enumerate(processes):
                with Attachments(page) as attachments:
                    began = time.perf_counter()
                    attachments.attach(process.pid)
                    times.append(1e3 * (time.perf_counter() - began))
                    page.arm([InterposedFault(f"/pump_{number}", "data[1]", Change(FLIP, When()), type=KIND)])
                    end = time.monotonic() + 5.0
                    while not page.messages_changed(0) and time.monotonic() < end:
                        time.sleep(0.001)
                    failures += not page.messages_changed(0)
                if process.poll() is not None:
                    raise SystemExit(f"a node died in round {round_number}")
            page.reports()
    show(f"attach: {len(times)} times, {failures} without an injection, {statistics.median(times):.0f} ms (median)")


def measure_kill() -> None:
    """Kill mavfi, the node, or both at random instants while mavfi attaches, injects and detaches."""
    changed_before = changed_after = silent = 0
    with Pumps() as pumps:
        targets = [pumps.start(number, "pump") for number in range(4)]
        watchers = [pumps.start(number, "watch") for number in range(4)]
        time.sleep(5.0)
        shared_memory = _files()
        for number in range(KILLS):
            what = ("mavfi", "mavfi", "node", "both")[number // 4 % 4]
            target = targets[number % 4]
            watcher = watchers[number % 4]
            _drain(watcher)
            command = [sys.executable, "-c", VICTIM, str(target.pid), f"/pump_{number % 4}"]
            victim = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
            assert victim.stdout is not None
            victim.stdout.readline()
            time.sleep(0.6 * random.random())
            if what != "mavfi":
                target.kill()
            if what != "node":
                victim.kill()
            victim.wait()  # without a node it ends by itself
            ended = time.time()
            if what != "mavfi":
                target.wait()
                targets[number % 4] = pumps.start(number % 4, "pump")
                time.sleep(1.0)
            elif target.poll() is not None:
                raise SystemExit(f"kill {number}: the node died")

            # until messages come that were published after the end
            rows: list[list[str]] = []
            for _ in range(40):
                time.sleep(0.15)
                rows += _drain(watcher)
                if any(float(row[0]) > ended + 0.005 for row in rows):
                    break
            else:
                silent += 1
            changed_before += any(row[1] == "1" for row in rows if float(row[0]) <= ended)
            changed_after += any(row[1] == "1" for row in rows if float(row[0]) > ended + 0.005)
        left = _files() - shared_memory
    show(
        f"kill -9 of mavfi, of the node, of both: {KILLS} times, {changed_before} after injections; graph silent: "
        f"{silent}; messages changed afterwards: {changed_after}; files left by mavfi: {len(left)}"
    )


def _files() -> set[str]:
    """Files in shared memory, without those of Fast DDS, which a killed node leaves behind."""
    return {name for name in os.listdir("/dev/shm") if "fastrtps" not in name and "fastdds" not in name}


def _drain(watcher: "subprocess.Popen[str]") -> list[list[str]]:
    """What a watcher has printed since the last call."""
    assert watcher.stdout is not None
    descriptor = watcher.stdout.fileno()
    os.set_blocking(descriptor, False)
    content = b""
    while True:
        try:
            part = os.read(descriptor, 1 << 16)
        except BlockingIOError:
            break
        content += part
    return [line.split() for line in content.decode().splitlines() if len(line.split()) == 2]


def main(parts: Sequence[str]) -> None:
    """Measure the named parts, or all."""
    installation = find_installation()
    with tempfile.TemporaryDirectory() as folder:
        peer = compiled(installation, Path(folder))
        if not parts or "publish" in parts:
            measure_publish(installation, peer)
        if not parts or "latency" in parts:
            measure_latency(installation, peer)
    if not parts or "attach" in parts:
        measure_attach()
    if not parts or "kill" in parts:
        measure_kill()
    if not parts:
        load = f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; without the interposer → with it"
        PAGE.write_text(between(PAGE.read_text(), "cost", "\n".join(["```text", *RESULTS, "```", "", load])))


if __name__ == "__main__":
    if os.environ.get(ISOLATED):
        main(sys.argv[1:])
    else:
        script = 'ip link set lo up; ip link set lo multicast on; mount -t tmpfs tmpfs /dev/shm; exec "$@"'
        isolated = ["unshare", "-n", "-m", "sh", "-c", script, "sh", sys.executable, *sys.argv]
        variables = {ISOLATED: "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONPATH": os.getcwd()}
        sys.exit(subprocess.run(isolated, env={**os.environ, **variables}, check=False).returncode)
