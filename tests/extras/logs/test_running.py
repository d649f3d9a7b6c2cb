"""A running flight as seen by a WebSocket client and by a UDP socket."""

import socket
import threading

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.logs.files import Maker
from mavfi.extras.logs.ned import ned_of
from mavfi.extras.logs.tlog import Telemetry
from mavfi.faults.fault import FaultSite
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.flight.loop import Listener
from mavfi.flight.observers import ObserverListener
from mavfi.levels.state.fault import StateFault
from mavfi.mission import MissionSpec
from tests.extras.logs.viewer import Viewer

pytestmark = pytest.mark.slow

FAULT = StateFault(FaultSite("planning.waypoint", "x"), 2_000_000, 62)
SCENARIO = resolve(MissionSpec(environment="sparse", seed=3, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))


@pytest.fixture(scope="module")
def golden():
    return fly(SCENARIO, FAULT)


@pytest.fixture
def ground_station():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 24)
        yield station


def test_a_ground_station_receives_the_flight_fault_and_end(golden, ground_station):
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="pymavlink (extra logs) is not installed")
    parser, messages, done = mavlink.MAVLink(None), [], threading.Event()

    def receive():
        ground_station.settimeout(0.5)
        while not done.is_set():
            try:
                messages.extend(parser.parse_buffer(ground_station.recv(65_535)) or ())
            except TimeoutError:
                continue

    receiver = threading.Thread(target=receive)
    receiver.start()
    telemetry = Telemetry(ground_station.getsockname()[1])
    flight = fly(SCENARIO, FAULT, observers=[ObserverListener(telemetry)])
    telemetry.close()
    threading.Event().wait(0.6)
    done.set()
    receiver.join()
    assert flight.log.digest() == golden.log.digest(), "observation changes nothing"
    positions = [(m.x, m.y, m.z) for m in messages if m.get_type() == "LOCAL_POSITION_NED"]
    assert np.array_equal(np.array(positions[:50]), ned_of(flight.log.rows).position[:50].astype(np.float32))
    texts = [(m.severity, m.text) for m in messages if m.get_type() == "STATUSTEXT" and not m.chunk_seq]
    assert [text for severity, text in texts if severity == 3][0].startswith("fault: planning.waypoint.x bit 62: ")
    assert texts[-1][1].startswith(flight.log.status.label)


def test_a_viewer_sees_the_flight(golden):
    pytest.importorskip("foxglove", reason="foxglove-sdk (extra live) is not installed")
    pytest.importorskip("websocket", reason="websocket-client is not installed")
    from mavfi.extras.logs.live import LiveView

    view, viewers = LiveView(0), []

    class Connect(Listener):
        def begin(self, loop):
            viewer = Viewer(view.address)
            viewer.subscribe(12)
            viewers.append(threading.Thread(target=viewer.collect))
            viewers[0].viewer = viewer
            viewers[0].start()
            threading.Event().wait(0.3)  # the subscription arrives

    flight = fly(SCENARIO, FAULT, observers=[ObserverListener(view), Connect()])
    threading.Event().wait(0.3)
    view.close()
    viewers[0].join()
    assert flight.log.digest() == golden.log.digest(), "observation changes nothing"
    viewer = viewers[0].viewer
    assert {c["encoding"] for c in viewer.channels.values()} == {"cdr"}
    topics = {topic for topic, _, _ in viewer.messages}
    assert topics >= {"/clock", "/tf", "/odometry", "/points", "/map", "/path", "/trajectory", "/log", "/obstacles"}
    store = Maker(is_ros1=False).store
    read = [
        (t, stamp, store.deserialize_cdr(data, viewer.channels[t]["schemaName"])) for t, stamp, data in viewer.messages
    ]
    rows = {round(1e9 * row[0]): row for row in flight.log.rows}
    for topic, stamp, message in read:
        if topic == "/odometry":
            row = rows[stamp if stamp > 1 else 0]
            assert message.pose.pose.position.x == row[1]
    assert any("site=planning.waypoint.x" in m.msg for topic, _, m in read if topic == "/log")


def test_a_port_in_use_is_refused():
    pytest.importorskip("foxglove", reason="foxglove-sdk (extra live) is not installed")
    from mavfi.extras.logs.live import LiveView

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(BadInputError, match="--live: port .* cannot be served"):
            LiveView(taken.getsockname()[1])
