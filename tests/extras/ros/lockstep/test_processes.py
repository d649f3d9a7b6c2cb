"""What keeps a flight together and takes it down: inbox, supervisor, watchdog."""

import os
import subprocess
import sys
import time

import pytest

from mavfi.extras.ros.lockstep.register_injector import end_of_nodes
from mavfi.extras.ros.processes import is_alive
from mavfi.record import Event, Injection

ORPHANS = """
import ctypes, os, subprocess, sys, time
from mavfi.extras.ros import processes
ctypes.CDLL(None).prctl(36, 1)
shell = subprocess.Popen(["sh", "-c", "setsid sleep 600 & setsid sh -c 'trap \\"\\" TERM INT; sleep 601' & sleep 0.2"])
shell.wait()
time.sleep(0.2)
print(*processes.children_by_parent()[os.getpid()], flush=True)
processes.end_all()
print(processes.reap(), flush=True)
"""
LOOPBACK = """
import socket
from mavfi.extras.ros.processes import loopback_up
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


def test_who_is_alive():
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    time.sleep(0.5)
    assert not is_alive(process.pid)  # it has ended, but nobody has asked after it
    process.wait()
    assert not is_alive(process.pid)
    assert is_alive(os.getpid())


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


@pytest.mark.parametrize(
    ("why", "activated", "end"),
    [
        ("connection reset", True, "crash"),
        ("does not answer", True, "hang"),
        ("killed as planned", True, "alive"),
        (None, True, "alive"),
        ("connection reset", False, None),
    ],
)
def test_what_becomes_of_an_injected_node(why, activated, end):
    injections = [Injection("register", "rax", 1e-6, 3, "0x0", "0x8", activated, details={"node": "a"})]
    events = [Event(2, "node_lost", {"node": "b", "why": "connection reset"})]
    if why is not None:
        events.append(Event(3, "node_lost", {"node": "a", "why": why}))
    assert end_of_nodes(injections, events) == end
