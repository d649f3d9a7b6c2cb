"""Kernel `point_cloud` by Debian's C++ nodelet: sends the depth image in standard types, and receives the points.

The nodelet subscribes to images only while its points have subscribers, and roslaunch restarts it after a crash:
therefore a one-pixel image probes whether it is available.  Every wait has a timeout; an unanswered scan is lost.
"""

import os
import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from mavfi.config import CameraConfig
from mavfi.hosts.ros1.convert import to_stamp
from mavfi.hosts.ros1.graph import IMAGE, INFO, NODELET, POINTS
from mavfi.hosts.ros1.mirrors import OPTICAL, fill_camera_info, ros_type
from mavfi.hosts.ros1.pinhole import Pinhole
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Inbox, Ports
from mavfi.hosts.ros1.roll_call import ask_foreign, is_alive, is_traced, note_hung
from mavfi.pipeline.perception import PointCloud
from mavfi.states import State

_ANSWER_S, _ASKS = 2.0, 2
"""Timeout of a response (s), and number of transmissions of the same image."""
_LOOK_S, _PROBE_S = 0.05, 0.1
_FLOAT32_POINT = 12
_STAMPS = 1000


class NoCloudError(Exception):
    """The nodelet returned no points."""


class NodeletCloud(PointCloud):
    """Kernel `point_cloud` whose points a nodelet computes; stateless."""

    def __init__(self, plan: Plan, ports: Ports) -> None:
        self.exchange = Exchange(plan.scenario.camera, plan.patience_s)
        ports.also(self.exchange.probe)
        pinhole = Pinhole(plan.scenario.camera, self.exchange.ask)
        functions = replace(plan.config.functions, back_project=pinhole.back_project)
        super().__init__(replace(plan.config, functions=functions))

    def step(self, time_us: int) -> list[State]:
        """Back-project the image in the nodelet; without a response the scan is lost."""
        self.exchange.time_us = time_us
        try:
            return super().step(time_us)
        except NoCloudError as loss:
            sys.stderr.write(f"{1e-6 * time_us:.3f} s: a scan is lost: {loss}\n")
            return []


class Exchange:
    """Exchange of depth images for point clouds with the nodelet; `time_us`: instant of the flight, for stamps.

    A tracer may stop the nodelet for at most `patience_s` in total per image.
    """

    def __init__(self, camera: CameraConfig, patience_s: float) -> None:
        import rospy

        self.time_us = 0
        self._patience_s = patience_s / (2 * _ASKS)  # below the patience of the world, which waits for this node
        self._pid, self._number = 0, 0
        self._inbox = Inbox()
        self._image, self._info = ros_type("sensor_msgs/Image"), ros_type("sensor_msgs/CameraInfo")
        self._camera_info = self._info()
        fill_camera_info(self._camera_info, camera)
        options: dict[str, Any] = {"queue_size": None, "tcp_nodelay": True}
        self._images = rospy.Publisher(IMAGE, self._image, **options)
        self._infos = rospy.Publisher(INFO, self._info, **options)
        self._points = rospy.Subscriber(
            POINTS, ros_type("sensor_msgs/PointCloud2"), self._arrived, buff_size=1 << 22, **options
        )

    def ask(self, depth: np.ndarray) -> np.ndarray:
        """Compute the points of an image (see `pinhole.Projection`).

        `NoCloudError`: the nodelet is unavailable, crashes, or hangs and is killed.
        """
        if not is_alive(self._pid) and not self.probe():
            raise NoCloudError(f"{NODELET} is away")
        key = self._next()
        for _ in range(_ASKS):
            self._send(key, depth)
            cloud = self._await(key)
            if cloud is not None:
                return points_of(cloud, depth.size)
        note_hung(self._pid)
        with suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)  # roslaunch restarts it
        raise NoCloudError(f"{NODELET} does not answer (pid {self._pid})")

    def _await(self, key: int) -> Any:
        """The cloud of an image; None = timeout.  A nodelet stopped by a tracer does not count as hung."""
        end = time.monotonic() + _ANSWER_S
        longest = end + self._patience_s
        while time.monotonic() < end:
            with suppress(TimeoutError):
                return self._inbox.take(key, _LOOK_S)
            if not is_alive(self._pid):
                raise NoCloudError(f"{NODELET} has ended (pid {self._pid})")
            if is_traced(self._pid):
                end = min(longest, time.monotonic() + _ANSWER_S)
        return None

    def probe(self) -> bool:
        """Whether the nodelet responds to a one-pixel image."""
        if min(each.get_num_connections() for each in (self._images, self._infos, self._points)) < 1:
            return False
        key = self._next()
        self._send(key, np.ones((1, 1), np.float32))
        try:
            self._inbox.take(key, _PROBE_S)
        except TimeoutError:
            return False
        self._pid = ask_foreign(NODELET) or 0
        return self._pid != 0

    def _next(self) -> int:
        """A key that distinguishes images of the same instant, stored in the nanoseconds of the stamp."""
        self._number = (self._number + 1) % _STAMPS
        with suppress(TimeoutError):
            self._inbox.take(self._number, 0.0)  # discard a late response to an earlier image with this key
        return self._number

    def _send(self, key: int, depth: np.ndarray) -> None:
        """Publish an image and its camera info, which the nodelet pairs by stamp."""
        image, info = self._image(), self._camera_info
        to_stamp(image.header.stamp, self.time_us)
        image.header.stamp.nsecs += key
        image.header.frame_id = OPTICAL
        info.header.stamp, info.header.frame_id = image.header.stamp, OPTICAL
        image.height, image.width = depth.shape
        image.encoding, image.step, image.data = "32FC1", 4 * image.width, depth.tobytes()
        self._infos.publish(info)
        self._images.publish(image)

    def _arrived(self, cloud: Any) -> None:
        self._inbox.put(cloud.header.stamp.nsecs % _STAMPS, cloud)


def points_of(cloud: Any, count: int) -> np.ndarray:
    """The points of a `sensor_msgs/PointCloud2`, robust against malformed messages of an injected node.

    Returns:
        `count` coordinates (m), NaN where missing. Shape (count, 3), float32.
    """
    points = np.full((count, 3), np.nan, np.float32)
    step = int(cloud.point_step)
    if step >= _FLOAT32_POINT:
        rows = np.frombuffer(cloud.data, np.uint8)
        rows = rows[: min(len(rows) // step, count) * step].reshape(-1, step)
        points[: len(rows)] = rows[:, :_FLOAT32_POINT].copy().view("<f4")
    return points
