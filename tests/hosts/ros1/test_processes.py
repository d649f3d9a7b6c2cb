"""What keeps a flight together and takes it down: inbox, supervisor, watchdog."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

from mavfi.errors import MachineError, MavfiError
from mavfi.hosts.ros1 import template
from mavfi.hosts.ros1.folder import PID
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Inbox
from mavfi.hosts.ros1.processes import isolate
from mavfi.hosts.ros1.remote import Counter, Watchdog
from mavfi.hosts.ros1.roll_call import is_alive
from mavfi.hosts.ros1.session import configure, fly
from mavfi.hosts.ros1.supervisor import children
from tests.hosts.ros1.flights import short
from tests.hosts.ros1.needs import ABSENT

ORPHANS = """
import ctypes, os, subprocess, sys, time
from mavfi.hosts.ros1 import supervisor
ctypes.CDLL(None).prctl(36, 1)
shell = subprocess.Popen(["sh", "-c", "setsid sleep 600 & setsid sh -c 'trap \\"\\" TERM INT; sleep 601' & sleep 0.2"])
shell.wait()
time.sleep(0.2)
print(*supervisor.children(os.getpid()), flush=True)
supervisor.end_all()
print(supervisor.reap(), flush=True)
"""
LOOPBACK = """
import socket
from mavfi.hosts.ros1.supervisor import loopback_up
def reachable():
    with socket.socket() as server:
        try:
            server.bind(("127.0.0.1", 0)); server.listen()
            socket.create_connection(server.getsockname(), 1).close()
            return True
        except OSError:
            return False
before = reachable()
loopback_up()
print(before, reachable())
"""


SHOWN = """
import os, sys
from pathlib import Path
from mavfi.hosts.ros1.processes import show_as
show_as("planner", ["python", "-m", "node", "planner", *sys.argv[2:]])
print(Path("/proc/self/comm").read_text().strip(), Path("/proc/self/cmdline").read_bytes().rstrip(b"\\0"))
print(len(Path("/proc/self/environ").read_bytes()) > 0 and os.environ["KEPT"])
"""
ISOLATED = """
import json, os, sys
from pathlib import Path
from mavfi.hosts.ros1.processes import isolate
before = os.readlink("/proc/self/ns/net"), os.getuid()
isolate(json.loads(sys.argv[1]))
links = [line.split(":")[0].strip() for line in Path("/proc/self/net/dev").read_text().splitlines()[2:]]
print(before[0] != os.readlink("/proc/self/ns/net"), links, os.getuid())
"""


def test_a_process_shows_the_name_and_the_command_line_that_it_is_given():
    done = subprocess.run(
        [sys.executable, "-c", SHOWN, " " * 200], capture_output=True, text=True, check=True,
        env={**os.environ, "KEPT": "kept"},
    )  # fmt: skip
    assert done.stdout.splitlines() == ["planner b'python\\x00-m\\x00node\\x00planner'", "kept"]


def test_a_command_line_without_room_is_cut_off():
    done = subprocess.run(
        [sys.executable, "-c", SHOWN, " " * 20, "long" * 1000], capture_output=True, text=True, check=True,
        env={**os.environ, "KEPT": "kept"},
    )  # fmt: skip
    first, second = done.stdout.splitlines()
    assert re.match(r"planner b'python.*long", first) and second == "kept"


@pytest.mark.parametrize("command", [["unshare", "-n"], ["unshare", "-Urn"]])
def test_a_process_leaves_the_network_as_unshare_does(command):
    if subprocess.run([*command, "true"], capture_output=True, check=False).returncode:
        pytest.skip("not allowed here")
    done = subprocess.run(
        [sys.executable, "-c", ISOLATED, json.dumps(command)], capture_output=True, text=True, check=True
    )
    assert done.stdout == "True ['lo'] 0\n"


@pytest.mark.slow
@pytest.mark.skipif(bool(ABSENT), reason="ROS is not installed")
def test_a_thread_keeps_its_template_until_the_interpreter_is_another_one(tmp_path, monkeypatch):
    first = template.template_of_thread(tmp_path / "log")
    assert template.template_of_thread(tmp_path / "log") is first
    others = []
    thread = threading.Thread(target=lambda: others.append(template.template_of_thread(tmp_path / "log")))
    thread.start()
    thread.join()
    assert others[0] is not first
    monkeypatch.setattr(sys, "executable", "/bin/false")
    absent = template.template_of_thread(tmp_path / "log")
    with pytest.raises(MavfiError, match="has ended"):
        absent.begin(tmp_path, [])
    assert not absent.usable()


@pytest.mark.slow
@pytest.mark.skipif(bool(ABSENT), reason="ROS is not installed")
@pytest.mark.parametrize("hit", ["supervisor", "template"])
def test_a_flight_whose_processes_are_killed_is_a_failure_of_the_machine(tmp_path, hit):
    mine = template.template_of_thread(tmp_path / "log")

    def kill(folder):
        os.kill(int((folder / PID).read_text()) if hit == "supervisor" else mine._process.pid, signal.SIGKILL)

    before = set(Path(tempfile.gettempdir()).glob("mavfi-ros-*"))
    scenario = short()
    with pytest.raises(MachineError, match="^ROS: the process that starts the nodes was killed$"):
        fly(Plan(scenario, configure(scenario)), tell=kill)
    assert set(Path(tempfile.gettempdir()).glob("mavfi-ros-*")) <= before


def test_without_a_command_a_process_stays_where_it_is():
    network = os.readlink("/proc/self/ns/net")
    isolate([])
    assert os.readlink("/proc/self/ns/net") == network


def test_an_inbox_keeps_what_came_before_it_was_wanted():
    inbox = Inbox()
    inbox.put(3, None)
    assert inbox.take(3, 0.0) is None
    with pytest.raises(TimeoutError):
        inbox.take(3, 0.01)


def test_an_inbox_wakes_the_one_that_waits():
    inbox = Inbox()
    threading.Timer(0.05, inbox.put, ("a", 1)).start()
    assert inbox.take("a", 10.0) == 1


def test_numbers_are_given_once():
    counter = Counter()
    assert [counter.take(2), counter.take(0), counter.take(), counter.take()] == [0, 2, 2, 3]


def test_the_watchdog_cuts_a_call_that_takes_too_long():
    cut = threading.Event()

    class Socket:
        def shutdown(self, how):
            cut.set()

    class Proxy:
        class transport:  # noqa: N801
            socket = Socket()

    dog = Watchdog(0.2)
    dog.begin(Proxy())
    dog.end()
    assert not cut.wait(0.5)
    dog.begin(Proxy())
    assert cut.wait(5.0)


def test_who_is_alive():
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    time.sleep(0.5)
    assert not is_alive(process.pid)  # it has ended, but nobody has asked after it
    process.wait()
    assert not is_alive(process.pid)
    assert is_alive(os.getpid())


def test_children_are_found():
    process = subprocess.Popen(["sleep", "60"])
    try:
        assert process.pid in children(os.getpid())
    finally:
        process.kill()
        process.wait()


def test_the_supervisor_ends_orphans_that_ignore_signals():
    done = subprocess.run([sys.executable, "-c", ORPHANS], capture_output=True, text=True, check=True, timeout=60)
    pids, left = done.stdout.splitlines()
    assert len(pids.split()) == 2
    assert left == "False"
    assert not any(is_alive(int(pid)) for pid in pids.split())


def test_a_private_network_has_a_loopback_and_nothing_else():
    command = ["unshare", "-Urn"] if os.geteuid() else ["unshare", "-n"]
    if subprocess.run([*command, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no private network can be made here")
    done = subprocess.run([*command, sys.executable, "-c", LOOPBACK], capture_output=True, text=True, check=False)
    assert done.stdout == "False True\n", done.stderr
