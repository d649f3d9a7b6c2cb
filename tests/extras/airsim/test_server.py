"""The server's connections."""

import asyncio
import contextlib
import gc
import socket

import pytest

from mavfi.extras.airsim.host import make_api
from mavfi.extras.airsim.server import Server, Steps
from mavfi.mission import MissionSpec

PLANAR = {
    "camera_name": "0",
    "image_type": 1,
    "pixels_as_float": True,
    "compress": False,
    "annotation_name": "",
}
IMAGES = 40
MISSION = MissionSpec(environment="sparse", seed=7)


def cancelled(server, client, until):
    """Serve a client that has just connected; cancel the server once the coroutine `until` has ended."""

    async def run():
        ports = []
        serving = asyncio.create_task(server.run(0, ports.append))
        while not ports:
            await asyncio.sleep(0.01)
        client.connect(("127.0.0.1", ports[0]))
        await until()
        serving.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await serving

    asyncio.run(run())
    gc.collect()  # a connection that is left open would be a ResourceWarning, and warnings are errors


def make_server():
    return Server(make_api(MISSION, "256x144"), Steps(limit_us=10**9))


def test_a_server_ends_while_answers_wait_for_a_client_that_does_not_read():
    msgpack = pytest.importorskip("msgpack")
    server = make_server()
    requests = [msgpack.packb([0, number, "simGetImages", [[PLANAR], "", False]]) for number in range(IMAGES)]
    with socket.socket() as client:

        async def served():
            client.sendall(b"".join(requests))
            while server.calls["simGetImages"] < IMAGES:
                await asyncio.sleep(0.01)

        cancelled(server, client, served)
    assert not server.errors


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_a_server_ends_while_a_client_is_coming(steps):
    """Cancelled between the connection and the first step of the task that serves it, too."""
    pytest.importorskip("msgpack")

    async def some_steps():
        for _ in range(steps):
            await asyncio.sleep(0)

    with socket.socket() as client:
        cancelled(make_server(), client, some_steps)
