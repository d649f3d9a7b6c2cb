"""Our pipeline flies a server of AirSim's API as its world."""

import asyncio
import socket
import threading
from contextlib import contextmanager

import pytest

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.airsim.host import make_api
from mavfi.extras.airsim.remote import Remote
from mavfi.extras.airsim.server import AirsimServer, StepClock
from mavfi.flight.compose import new_loop, resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec


@contextmanager
def served(environment="sparse", *, single=False, image="", on_ground=False, **mission):
    """A server in a thread of its own; its port."""
    api = make_api(MissionSpec(environment=environment, seed=7, **mission), image, on_ground=on_ground)
    with serving(api, single=single) as port:
        yield port


@contextmanager
def serving(api, *, single=False):
    """A server of an API, in a thread of its own; its port."""
    server = AirsimServer(api, StepClock(), single=single)
    port, ready = [], threading.Event()

    def note(at):
        port.append(at)
        ready.set()

    thread = threading.Thread(target=lambda: asyncio.run(server.run(0, note, once=True)))
    thread.start()
    assert ready.wait(30.0)
    try:
        with socket.create_connection(("127.0.0.1", port[0])):  # until then it does not end
            yield port[0]
    finally:
        thread.join(30.0)
        assert not thread.is_alive()


COURSE = {"start": (2.0, 0.0, 3.0), "goal": (9.0, 0.0, 3.0)}


def flown(environment):
    """A short mission in this process, and the same on a server."""
    scenario = resolve(MissionSpec(environment=environment, seed=7, **COURSE))
    with served(environment, **COURSE) as port:
        there = fly(scenario, make_plant=lambda world, own: Remote(world, own, "127.0.0.1", port))
    return fly(scenario).log, there.log


def first(port, environment="sparse", seed=7, **mission):
    scenario = resolve(MissionSpec(environment=environment, seed=seed, **mission))
    return new_loop(scenario, make_plant=lambda world, own: Remote(world, own, "127.0.0.1", port)).plant


@pytest.mark.slow
def test_a_flight_on_a_server_has_the_bits_of_one_in_this_process():
    here, there = flown("sparse")
    assert there.digest() == here.digest() and there.status == here.status


def test_a_server_with_other_images_is_refused():
    with served(image="32x24") as port, pytest.raises(BadInputError, match="its images are 32x24; allowed: 64x48"):
        first(port)


def test_a_server_of_another_mission_is_refused():
    with served() as port:
        for mission, text in (
            ({"environment": "farm", "seed": 3}, "it has environment sparse, seed 7,.* has environment farm, seed 3,"),
            ({"seed": 8}, "it has seed 7"),
            ({"vehicle": "small_quad"}, "it has vehicle airsim_quad; this flight has vehicle small_quad; allowed"),
            ({"wind": 3.0}, "it has wind 0; this flight has wind 3; allowed: the same"),
            ({"start": (1.0, 0.0, 3.0)}, "it has start .*; this flight has start 1 0, .*height 3"),
            ({"v_max": 4.0}, "it has v_max 3; this flight has v_max 4"),
        ):
            with pytest.raises(BadInputError, match=text):
                first(port, **mission)
        first(port).close()
    with served(wind=3.0) as port:
        first(port, wind=3.0).close()


@pytest.mark.parametrize(("image", "seed"), [("32x24", 7), ("64x48", 8)])
def test_a_refused_flight_changes_nothing_on_the_server(image, seed):
    api = make_api(MissionSpec(environment="sparse", seed=7), image)
    api.vehicle.api = True
    with serving(api) as port, pytest.raises(BadInputError):
        first(port, seed=seed)
    assert api.vehicle.api and not api.scene.paused and api.vehicle.landed and api.vehicle.position == (0.0, 0.0, 0.0)


def test_after_a_flight_the_server_goes_on_as_before():
    api = make_api(MissionSpec(environment="sparse", seed=7), "64x48")
    with serving(api) as port:
        plant = first(port)
        assert api.scene.paused and api.vehicle.api
        plant.close()
        plant.close()  # without a connection: no operation
        assert not api.scene.paused and not api.vehicle.api


def test_a_server_that_is_not_there_or_goes_away_is_one_line():
    with served() as port:
        plant = first(port)
        plant.close()
    with pytest.raises(BadInputError, match=f"--world: airsim://127.0.0.1:{port}: no server there"):
        first(port)
    with pytest.raises(BadInputError, match="--localization: estimator: allowed: truth"):
        first(port, localization="estimator")


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"HTTP/1.0 400 Bad Request\r\n", "not one of msgpack-rpc"),
        (b"\xc1", "not one of msgpack-rpc"),  # a byte that msgpack does not use
        (b"\x94\x01\x01\xa4full\xc0", "simGetImages: full"),
        (b"\x94\x01\x01\xc0\x90", "not an ImageResponse"),
        (b"", "the server is gone"),
    ],
)
def test_another_protocol_and_a_refusal_are_one_line(answer, message):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(MavfiError, match=message):
            first(server.getsockname()[1])
        thread.join(30.0)
