"""The server's connections."""

import asyncio
import contextlib
import gc
import socket

import pytest

from mavfi.bridges.airsim.clock import Steps
from mavfi.bridges.airsim.program import make_api
from mavfi.bridges.airsim.server import Server
from mavfi.mission import MissionSpec

PLANAR = {
    "camera_name": "0", "image_type": 1, "pixels_as_float": True, "compress": False, "annotation_name": "",
}  # fmt: skip
IMAGES = 40


def test_a_server_ends_while_answers_wait_for_a_client_that_does_not_read():
    """A connection that is left open would be a ResourceWarning when its memory is freed, and warnings are errors."""
    msgpack = pytest.importorskip("msgpack")
    server = Server(make_api(MissionSpec(environment="sparse", seed=7), "256x144"), Steps(limit_us=10**9))
    requests = [msgpack.packb([0, number, "simGetImages", [[PLANAR], "", False]]) for number in range(IMAGES)]

    async def run(client):
        ports = []
        serving = asyncio.create_task(server.run(0, ports.append))
        while not ports:
            await asyncio.sleep(0.01)
        client.connect(("127.0.0.1", ports[0]))
        client.sendall(b"".join(requests))
        while server.calls["simGetImages"] < IMAGES:
            await asyncio.sleep(0.01)
        serving.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await serving

    with socket.socket() as client:
        asyncio.run(run(client))
        assert not server.errors
        gc.collect()


@pytest.mark.parametrize("steps", range(6))
def test_a_server_ends_while_a_client_is_coming(steps):
    """Cancelled between the connection and the first step of the task that serves it, too."""
    pytest.importorskip("msgpack")
    server = Server(make_api(MissionSpec(environment="sparse", seed=7), "256x144"), Steps(limit_us=10**9))

    async def run(client):
        ports = []
        serving = asyncio.create_task(server.run(0, ports.append))
        while not ports:
            await asyncio.sleep(0.01)
        client.connect(("127.0.0.1", ports[0]))
        for _ in range(steps):
            await asyncio.sleep(0)
        serving.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await serving

    with socket.socket() as client:
        asyncio.run(run(client))
        gc.collect()
