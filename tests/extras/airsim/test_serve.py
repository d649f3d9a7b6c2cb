"""`mavfi airsim serve` saves the calls of its clients, with a fault in one of them."""

import json
import re
import signal
import socket
import subprocess
import sys

import pytest

from mavfi.extras.shared.log_readers import open_flight_log

CLIENT = """
import math
import sys
import cosysairsim as airsim
client = airsim.MultirotorClient(port=int(sys.argv[1]))
client.enableApiControl(True)
client.takeoffAsync()
for step in range(80):
    client.moveByVelocityAsync(1.0 + math.cos(step), math.sin(step), 0.0, 0.5)
    client.getMultirotorState()
"""


def start(*options):
    """A server whose time passes in calls."""
    command = [sys.executable, "-m", "mavfi", "airsim", "serve", "--environment", "sparse", "--seed", "7"]
    return subprocess.Popen(
        [*command, "--clock", "steps", "--port", "0", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def serve_once(*options):
    """Serve the client; what the server prints."""
    server = start("--once", *options)
    try:
        ready = server.stdout.readline()
        port = re.search(r"127\.0\.0\.1:(\d+)", ready)[1]
        done = subprocess.run([sys.executable, "-c", CLIENT, port], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return server.communicate(timeout=60)[0]
    finally:
        server.send_signal(signal.SIGKILL)
        server.wait(30)


def test_ctrl_c_prints_what_the_clients_did():
    msgpack = pytest.importorskip("msgpack")
    server = start("--fault", "simPause.is_paused:bit=0@100")
    try:
        port = re.search(r"127\.0\.0\.1:(\d+)", server.stdout.readline())[1]
        with socket.create_connection(("127.0.0.1", int(port))) as client:
            client.sendall(msgpack.packb([0, 1, "fly", []]))
            assert client.recv(1000)
            server.send_signal(signal.SIGINT)
            printed, errors = server.communicate(timeout=60)
    finally:
        server.kill()
        server.wait(30)
    assert (server.returncode, errors) == (130, "Stopped.\n")
    text = " ".join(printed.split())
    assert re.search(r"\d\.\d{3} s simulated, no collision, digest [0-9a-f]{16} fault: not activated", text)
    assert "refused 1 x: server could not find function 'fly'" in text


def test_calls_are_saved_as_they_come_with_the_fault(tmp_path):
    pytest.importorskip("cosysairsim")
    calls = tmp_path / "calls.jsonl"
    serve_once("--save", str(calls))
    lines = [json.loads(line) for line in calls.read_text(encoding="utf-8").splitlines()]
    sent = [line["numbers"] for line in lines if line["topic"] == "moveByVelocity(arguments)"]
    assert len(sent) == 80 and sent[0]["vx"] == 2.0 and sent[0]["duration"] == 0.5
    (state,) = {message.topic for message in open_flight_log(calls).messages(["moveByVelocity(arguments)"])}
    assert state == "moveByVelocity(arguments)"
    injected = tmp_path / "injected.jsonl"
    printed = serve_once("--fault", "moveByVelocity.vx:bit=62#40", "--save", str(injected))
    assert "fault in moveByVelocity.vx bit 62" in printed
    after = [json.loads(line) for line in injected.read_text(encoding="utf-8").splitlines()]
    vx = [line["numbers"]["vx"] for line in after if line["topic"] == "moveByVelocity(arguments)"]
    assert [index for index, value in enumerate(vx) if value == "nan"] == [39]
