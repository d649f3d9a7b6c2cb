"""The camera against MuJoCo's rays: worlds of boxes, and voxels as boxes."""

import mujoco
import numpy as np
import pytest

from mavfi.config import CameraConfig
from mavfi.numerics.rotations import rotation_matrix
from mavfi.sim.camera import Camera, box_distance_along, build_columns, voxel_distance_along
from mavfi.sim.environments.generated import clutter, cuboids, factory
from mavfi.sim.environments.world import World

RANGE = 20.0


def model_of(lower, upper, ground=True):
    spec = mujoco.MjSpec()
    if ground:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=np.array([0.0, 0.0, 1.0]))
    for low, high in zip(lower, upper, strict=True):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=0.5 * (low + high), size=0.5 * (high - low))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def mujoco_ranges(model, data, origin, directions, limit=RANGE):
    """Distances (m); infinity beyond the limit."""
    count = len(directions)
    geoms, distances = np.zeros(count, np.int32), np.zeros(count)
    mujoco.mj_multiRay(model, data, origin, directions.reshape(-1), None, True, -1, geoms, distances, None, count, 1e6)
    return np.where((distances >= 0.0) & (distances < limit), distances, np.inf)


def poses(world, count, seed):
    """Free places with any heading and tilts of up to about 30 degrees."""
    stream = np.random.default_rng(seed)
    drawn = []
    while len(drawn) < count:
        position = stream.uniform(world.flight_lower, world.flight_upper)
        if world.clearance(position)[0] > 0.35:
            quaternion = np.array([1.0, 0.0, 0.0, 0.0]) + np.append(0.0, stream.uniform(-0.3, 0.3, 3))
            quaternion[3] += stream.uniform(-2.0, 2.0)
            drawn.append(np.concatenate([position, quaternion / np.linalg.norm(quaternion)]))
    return drawn


def world_directions(pose, directions):
    matrix = np.empty((3, 3))
    rotation_matrix(pose[3:], matrix)
    return directions @ matrix.T


@pytest.mark.parametrize(
    "generate", (lambda s: cuboids(s, 0.2, 10.0), factory, clutter), ids=("dense", "factory", "clutter")
)
@pytest.mark.parametrize("seed", range(2))
def test_images_equal_the_rays_of_mujoco(generate, seed):
    world = generate(seed)
    model, data = model_of(world.lower, world.upper)
    camera = Camera(CameraConfig(range=RANGE), world, 0)
    columns = build_columns(world.lower, world.upper)
    for pose in poses(world, 6, seed):
        directions = world_directions(pose, camera.directions)
        expected = mujoco_ranges(model, data, pose[:3], directions)
        np.testing.assert_allclose(camera.capture(pose, 0), expected, atol=1e-5)
        exact = np.array([box_distance_along(columns, pose, *direction, RANGE) for direction in directions])
        np.testing.assert_allclose(np.where(exact < RANGE, exact, np.inf), expected, atol=1e-9)


def voxel_world(seed, cells=12, resolution=0.5):
    stream = np.random.default_rng(seed)
    occupied = stream.random((cells, cells, cells)) < 0.06
    occupied[[0, -1]] = occupied[:, [0, -1]] = occupied[:, :, [0, -1]] = True
    origin = np.array([-1.0, 2.0, 0.3])
    edge = np.full(3, cells * resolution)
    ends = origin + 0.5 * edge
    return World(
        ends,
        ends,
        origin,
        origin + edge,
        origin,
        origin + edge,
        occupied=occupied,
        origin=origin,
        resolution=resolution,
    )


@pytest.mark.parametrize("seed", range(3))
def test_voxels_equal_the_rays_of_mujoco_on_boxes(seed):
    world = voxel_world(seed)
    lower = world.origin + world.resolution * np.argwhere(world.occupied)
    model, data = model_of(lower, lower + world.resolution, ground=False)
    camera = Camera(CameraConfig(width=32, height=24, range=RANGE), world, 0)
    for pose in poses(world, 4, seed):
        directions = world_directions(pose, camera.directions)
        expected = mujoco_ranges(model, data, pose[:3], directions)
        assert np.isfinite(expected).all()
        np.testing.assert_allclose(camera.capture(pose, 0), expected, atol=1e-5)
        position = tuple(pose[:3] - world.origin)
        exact = [voxel_distance_along(world.occupied, world.resolution, position, tuple(d), RANGE) for d in directions]
        np.testing.assert_allclose(exact, expected, atol=1e-9)
