"""mavfi attached to Debian's nodelet depth_image_proc/point_cloud_xyz, C++ that turns depth images into points."""

import json
import threading
import time

import numpy as np
import pytest

from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.hosts.node.message import Composer
from mavfi.hosts.node.nodelets import point_cloud_xyz
from mavfi.hosts.node.tcpros import Source
from tests.hosts.node.conftest import until

pytestmark = pytest.mark.ros

WIDTH, HEIGHT, FOCAL = 8, 6, 5.0
DEPTH = np.full((HEIGHT, WIDTH), 2.0, "<f4")
NODE = "/cloud"
SYMBOL = "PointCloudXyzNodelet7depthCb"
PIXEL = 3 * WIDTH + 2


class Camera:
    """A depth image and its camera, 100 times a second, and the points that come back."""

    def __init__(self, bench, process):
        self.master = bench.master
        self.images = bench.peer("/camera")
        self.image, self.info = Composer("sensor_msgs/Image"), Composer("sensor_msgs/CameraInfo")
        self.outlets = (
            self.images.advertise("/cam/depth", self.image.header),
            self.images.advertise("/cam/camera_info", self.info.header),
        )  # fmt: skip
        bench.wait_for_node(NODE, process)
        until(lambda: "/cam/points" in self.master.graph().topics, 20)
        self.source = Source(NODE, self.master.node_uri(NODE), "/cam/points")  # it reads only while it is read
        self.clouds, self.over = [], threading.Event()
        self.threads = [threading.Thread(target=work, daemon=True) for work in (self._listen, self._send)]
        for thread in self.threads:
            thread.start()
        until(lambda: len(self.clouds) > 3, 20)

    def _send(self):
        matrix = [FOCAL, 0, (WIDTH - 1) / 2, 0, FOCAL, (HEIGHT - 1) / 2, 0, 0, 1]
        projection = [FOCAL, 0, (WIDTH - 1) / 2, 0, 0, FOCAL, (HEIGHT - 1) / 2, 0, 0, 0, 1, 0]
        while not self.over.wait(0.01):
            now = time.time_ns()
            header = {"stamp": {"sec": now // 10**9, "nanosec": now % 10**9}, "frame_id": "camera"}
            size = {"header": header, "height": HEIGHT, "width": WIDTH}
            self.outlets[1].send(self.info.pack({**size, "K": matrix, "P": projection}))
            pixels = {"encoding": "32FC1", "step": 4 * WIDTH, "data": list(DEPTH.tobytes())}
            self.outlets[0].send(self.image.pack({**size, **pixels}))

    def _listen(self):
        definition = self.source.definition()
        for message in self.source.messages():
            start = definition.locate(message, "data[0]").offset
            step = int(definition.locate(message, "point_step").value(message))
            rows = np.frombuffer(message, np.uint8, HEIGHT * WIDTH * step, start).reshape(HEIGHT * WIDTH, step)
            self.clouds.append(rows[:, :12].copy().view("<f4"))


@pytest.fixture(scope="module")
def camera(bench, tmp_path_factory):
    remappings = {
        "image_rect": "/cam/depth", "camera_info": "/cam/camera_info", "points": "/cam/points", "__name": NODE[1:]
    }  # fmt: skip
    try:
        command, extra = point_cloud_xyz(tmp_path_factory.mktemp("nodelet"), remappings)
    except BadInputError as error:
        pytest.skip(str(error))
    made = Camera(bench, bench.start(command, extra))
    yield made
    made.over.set()
    for thread in made.threads[1:]:
        thread.join()
    made.source.close()


def expected():
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    z = DEPTH.astype(float)
    return np.stack([(u - (WIDTH - 1) / 2) * z / FOCAL, (v - (HEIGHT - 1) / 2) * z / FOCAL, z], -1).reshape(-1, 3)


def test_the_nodelet_computes_the_points(camera):
    assert np.allclose(camera.clouds[-1], expected(), atol=1e-6)


def test_one_changed_pixel_moves_exactly_one_point_of_one_cloud(camera, capsys):
    del camera.clouds[:]
    byte = 4 * PIXEL + 2  # bit 22 of the pixel: 2.0 becomes 3.0
    arguments = ["--topic", "/cam/depth", "--field", f"data[{byte}]", "--bit", "6", "--at", "4", "--json"]
    capsys.readouterr()
    assert run(["ros", "corrupt", *arguments]) == 0
    (injection,) = json.loads(capsys.readouterr().out)["injections"]
    assert (
        injection["activated"]
        and injection["details"]["kind"] == "uint8"
        and injection["after"] == injection["before"] ^ 64
    )
    changed = [cloud for cloud in camera.clouds if not np.allclose(cloud, expected(), atol=1e-6)]
    assert len(changed) == 1
    rows = np.flatnonzero(np.abs(changed[0] - expected()).max(axis=1) > 1e-6)
    assert rows.tolist() == [PIXEL]
    assert np.allclose(changed[0][PIXEL], 1.5 * expected()[PIXEL], atol=1e-6)


@pytest.mark.slow
def test_its_registers_can_be_injected(camera, capsys):
    capsys.readouterr()
    assert run(["inject", "--ros-node", NODE, "--symbol", SYMBOL, "--null", "--json"]) == 0
    (injection,) = json.loads(capsys.readouterr().out)["injections"]
    assert injection["activated"] and injection["before"] == injection["after"]
    count = len(camera.clouds)
    until(lambda: len(camera.clouds) > count + 5)
