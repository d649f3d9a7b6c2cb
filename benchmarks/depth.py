"""Speed of a depth image: mavfi's camera against MuJoCo's `mj_multiRay`, in worlds with increasing numbers of boxes."""

import time
from collections.abc import Callable

import mujoco
import numpy as np

from benchmarks.rows import Row
from mavfi.config import CameraConfig, EnvironmentConfig
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec
from mavfi.numerics.rotations import rotation_matrix
from mavfi.sim.camera import Camera
from mavfi.sim.environments import World, build_world
from mavfi.sim.environments.generated import HALF_WIDTH, HALO, LENGTH
from mavfi.sim.scene import build_model

BOXES = (50, 200, 1000)
TARGET_BOXES, TARGET = 200, 10.0
IMAGES = 20
_BODY = 1
"""Body id of the vehicle, which its camera excludes."""


def posts(count: int) -> EnvironmentConfig:
    """Environment with a number of boxes of 1 m x 1 m base."""
    ground = LENGTH * 2.0 * HALF_WIDTH - 2.0 * (2.0 * HALO) ** 2
    return EnvironmentConfig(name="posts", generator="cuboids", parameters={"density": count / ground, "side": 1.0})


def poses(world: World) -> list[np.ndarray]:
    """Random positions in the flight volume with random headings."""
    random = np.random.default_rng(0)
    found: list[np.ndarray] = []
    while len(found) < IMAGES:
        position = random.uniform(world.flight_lower, world.flight_upper)
        if world.clearance(position)[0] > 0.5:
            half = 0.5 * random.uniform(-np.pi, np.pi)
            found.append(np.array([*position, np.cos(half), 0.0, 0.0, np.sin(half)]))
    return found


def least(action: Callable[[np.ndarray], object], views: list[np.ndarray]) -> float:
    """Minimum wall time per view over the repeats, averaged over the views (s)."""
    best = np.full(len(views), np.inf)
    for _ in range(6):
        for i, view in enumerate(views):
            start = time.perf_counter()
            action(view)
            best[i] = min(best[i], time.perf_counter() - start)
    return float(best.mean())


class TheirCamera:
    """The same image computed by MuJoCo."""

    def __init__(self, world: World, directions: np.ndarray) -> None:
        """Compile the world."""
        self._model = build_model(world, resolve(MissionSpec(environment="sparse", seed=0)).vehicle)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._directions = directions
        self._turned = np.empty_like(directions)
        self._geoms, self._distances = np.empty(len(directions), np.int32), np.empty(len(directions))
        self._matrix = np.empty((3, 3))

    def capture(self, pose: np.ndarray) -> np.ndarray:
        """Distances along the rays (m)."""
        rotation_matrix(pose[3:], self._matrix)
        np.matmul(self._directions, self._matrix.T, out=self._turned)
        return self.cast(pose, len(self._turned))

    def cast(self, pose: np.ndarray, count: int) -> np.ndarray:
        """Cast the first rays of the image, in the orientation of the last `capture`."""
        mujoco.mj_multiRay(
            self._model,
            self._data,
            pose[:3],
            self._turned[:count].reshape(-1),
            None,
            True,
            _BODY,
            self._geoms[:count],
            self._distances[:count],
            None,
            count,
            1e6,
        )
        return self._distances


def depth_rows() -> list[Row]:
    """Rows of the speed table."""
    rows = []
    for count in BOXES:
        world = build_world(posts(count), 0, None, None)
        camera = Camera(CameraConfig(), world, 0)
        theirs, views = TheirCamera(world, np.array(camera.directions)), poses(world)
        own = least(lambda view, camera=camera: camera.capture(view, 0), views)  # type: ignore[misc]
        other = least(theirs.capture, views)
        binding = least(lambda view, theirs=theirs: theirs.cast(view, 1), views)  # type: ignore[misc]
        text = (
            f"{1e3 * own:.3f} ms; mj_multiRay {1e3 * other:.3f} ms, {other / own:.1f} x (a call for one ray, Python "
            f"binding included: {1e3 * binding:.3f} ms)"
        )
        rows.append(
            Row(
                f"depth image, {count} boxes, {len(camera.directions)} rays",
                text,
                other / own,
                TARGET if count == TARGET_BOXES else None,
            )
        )
    return rows
