"""The command between two peers: over real sockets, stopped like its users stop it."""

import json
import signal
import socket
import subprocess
import sys
import time

import pytest
from pymavlink import mavutil

from mavfi.cli import run
from mavfi.extras.mavlink.cli import EXIT_NOTHING_CHANGED
from tests.extras.mavlink.frames import KINDS, Peer, received

ATTITUDE = next(kind for kind in KINDS if kind.msgname == "ATTITUDE")


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class LinkedPeers:
    """A program, an autopilot, and the command between them."""

    def __init__(self, *options):
        self.ports = free_port(), free_port()
        self.autopilot = mavutil.mavlink_connection(f"udpin:127.0.0.1:{self.ports[1]}")
        self.program = mavutil.mavlink_connection(f"udpout:127.0.0.1:{self.ports[0]}")
        ends = "--from", f"udpin:127.0.0.1:{self.ports[0]}", "--to", f"udpout:127.0.0.1:{self.ports[1]}"
        command = [sys.executable, "-m", "mavfi", "mavlink", "inject", *ends, *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while not self.exchange(self.program, self.autopilot, b"is the link there?", 0.3):
            assert self.process.poll() is None, self.process.stderr.read()
        while self.exchange(self.program, self.autopilot, b"the last one") != b"the last one":
            pass

    def exchange(self, sender, receiver, datagram, limit=10.0):
        """Send bytes; what arrives at the other end within some time (s)."""
        sender.write(datagram)
        end = time.monotonic() + limit
        while time.monotonic() < end:
            if data := receiver.recv():
                return data
            time.sleep(0.001)
        return b""

    def finish(self):
        self.process.send_signal(signal.SIGINT)
        output, errors = self.process.communicate(timeout=20)
        self.program.close()
        self.autopilot.close()
        assert errors == ""
        return output, self.process.returncode


@pytest.mark.slow
def test_a_fault_reaches_the_autopilot_and_nothing_else_changes():
    peers = LinkedPeers("--fault", "ATTITUDE.roll:set=nan@n=2", "--json")
    peer = Peer()
    frames = [peer.frame(ATTITUDE) for _ in range(3)]
    arrived = [peers.exchange(peers.program, peers.autopilot, frame) for frame in frames]
    back = [peers.exchange(peers.autopilot, peers.program, frame) for frame in frames]
    output, code = peers.finish()
    assert code == 0
    assert [arrived[0], arrived[2], *back] == [frames[0], frames[2], *frames]
    assert received(arrived[1])[0][2]["roll"] == "nan"
    result = json.loads(output)
    assert result["frames"] == {"to": 3, "from": 3}
    assert [fault["changed"] for fault in result["faults"]] == [1]
    assert result["injections"][0]["after"] == "nan"


@pytest.mark.slow
def test_a_late_frame_of_the_autopilot_arrives_by_itself():
    peers = LinkedPeers("--fault", "ATTITUDE:delay=0.3", "--direction", "from")
    frame = Peer().frame(ATTITUDE)
    start = time.monotonic()
    assert peers.exchange(peers.autopilot, peers.program, frame) == frame
    assert time.monotonic() - start > 0.25
    output, code = peers.finish()
    assert code == 0
    assert "ATTITUDE:delay=0.3: 1 of 1 ATTITUDE changed" in output


@pytest.mark.slow
def test_the_exit_code_says_that_nothing_was_changed():
    peers = LinkedPeers("--fault", "ATTITUDE:drop@n=5")
    output, code = peers.finish()
    assert code == EXIT_NOTHING_CHANGED
    assert "ATTITUDE:drop@n=5: 0 of 0 ATTITUDE changed" in output


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("udpin:127.0.0.1", "udpin:127.0.0.1: cannot be opened (UDP ports must be specified as host:port)"),
        ("tcp:127.0.0.1:1", "tcp:127.0.0.1:1: cannot be opened ([Errno 111] Connection refused)"),
    ],
)
def test_an_address_that_cannot_be_opened_is_refused(capsys, address, message):
    assert run(["mavlink", "inject", "--from", address, "--to", "udpout:127.0.0.1:9", "--fault", "PING:drop"]) == 2
    assert capsys.readouterr().err == f"mavfi: {message}\n"


def test_the_vehicle_of_earlier_versions_is_refused_by_name(capsys):
    assert run(["mavlink", "serve"]) == 2
    assert "mavlink serve: dropped; no replacement" in capsys.readouterr().err
