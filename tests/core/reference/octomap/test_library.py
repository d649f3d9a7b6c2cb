"""Both kinds of map against OctoMap itself, on the point clouds of golden flights."""

import os
from functools import cache

import numpy as np
import pytest

from mavfi.config import MapConfig
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.kernels.perception import octree
from mavfi.mission import MissionSpec
from mavfi.pipeline.maps import DenseMap, OctreeMap
from mavfi.states import floats
from tests.core.flights.missions import mission
from tests.core.reference.octomap import trees
from tests.night import at_night

os.environ["OMP_NUM_THREADS"] = "1"  # the library inserts with OpenMP
library = pytest.importorskip("octomap", reason="the oracle of the map is the package octomap-python")

RANGE = 20.0
RESOLUTIONS = (0.5, *at_night(0.25))
SHORT = {"start": (2.0, 0.0, 3.0), "goal": (16.0, 0.0, 3.0)}
WHOLE = [  # the short one; at night the worlds of the paper
    ("sparse", "hardened", 0, 0.5, SHORT),
    *(
        pytest.param(*row, {}, marks=pytest.mark.long)
        for row in (
            ("sparse", "hardened", 0, 0.5),
            ("factory", "published", 1, 0.5),
            ("dense", "published", 0, 0.5),
            ("farm", "hardened", 1, 0.5),
            ("dense", "published", 0, 0.25),
            ("factory", "published", 1, 0.25),
        )
    ),
]


def recorded(scenario):
    """A flight, and its scans: points (n, 3) float32 and origin (3,)."""
    scans = []

    def watch(state, _time_us):
        if state.spec.name == "perception.point_cloud":
            points = state.elements.view(np.float32).reshape(-1, 3).copy()
            scans.append((points, floats(state.header, 3).copy()))

    return fly(scenario, recorders=[watch]), scans


@cache
def short_flight():
    return recorded(mission())[1]


def library_tree(resolution):
    tree = library.OcTree(resolution)
    tree.setProbHit(0.7)
    tree.setProbMiss(0.4)
    tree.setClampingThresMin(0.12)
    tree.setClampingThresMax(0.97)
    return tree


def feed(tree, points, origin):
    """Insert a scan into the library's tree: moved by half a voxel and rounded to float32, as the kernel does it."""
    half = 0.5 * tree.getResolution()
    shifted = (points.astype(np.float64) + half).astype(np.float32)
    assert np.isfinite(shifted).all()
    start = (origin + half).astype(np.float32)
    tree.insertPointCloud(shifted.astype(np.float64), start.astype(np.float64), RANGE)


def nodes_of(tree):
    """What the library writes of its nodes."""
    return tree.write().partition(b"\ndata\n")[2]


def frame_of(scans, resolution):
    """A grid that no ray leaves: then the trees must have the same nodes, not just the same values."""
    origins = np.array([origin for _, origin in scans])
    return trees.frame_around(origins.min(0) - RANGE - 1.0, origins.max(0) + RANGE + 1.0, resolution)


def assert_equal_maps(ours, dense, theirs, frame):
    """Every node, and every voxel of a grid; returns how many voxels are known."""
    data = nodes_of(theirs)
    assert trees.tree_data(ours.tree) == data
    assert ours.tree.counters[octree.NODES] == theirs.size() == theirs.calcNumNodes() == len(data) // 5
    expected = trees.dense_from(data, frame)
    known_cells = ~np.isnan(expected)
    assert np.nan_to_num(expected).tobytes() == dense.log_odds.tobytes() == ours.log_odds.tobytes()
    return int(known_cells.sum())


@pytest.mark.slow
@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_both_maps_equal_the_library_after_each_scan(resolution):
    scans = short_flight()[: 30 if resolution == 0.5 else 20 : 6]
    frame = frame_of(scans, resolution)
    ours, dense = OctreeMap(frame, trees.RULE, RANGE), DenseMap(frame, trees.RULE, RANGE)
    theirs = library_tree(resolution)
    known_cells = [0]
    for points, origin in scans:
        voxels, after = ours.insert(points, origin)
        dense_voxels, dense_after = dense.insert(points, origin)
        assert voxels.tobytes() == dense_voxels.tobytes() and after.tobytes() == dense_after.tobytes()
        feed(theirs, points, origin)
        known_cells.append(assert_equal_maps(ours, dense, theirs, frame))
        assert known_cells[-1] > known_cells[-2]
    depth, pruned = trees.depth_of(nodes_of(theirs))
    assert depth == theirs.getTreeDepth() == octree.DEPTH and pruned > 20


def test_each_value_that_is_found_is_the_librarys():
    points, origin = short_flight()[20]
    frame = frame_of([(points, origin)], 0.5)
    ours, theirs = OctreeMap(frame, trees.RULE, RANGE), library_tree(0.5)
    ours.insert(points, origin)
    feed(theirs, points, origin)
    for point in points[::16].astype(np.float64) + 0.25:
        node = theirs.search(point)
        try:
            expected = node.getValue()
        except library.NullPointerException:
            expected = np.nan
        value = octree.search(ours.tree, *(int(k) for k in np.floor(point / 0.5)))
        assert value == expected or np.isnan(value) and np.isnan(expected)


@pytest.mark.slow
@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_taking_scans_back_leaves_the_tree_that_the_library_has_without_them(resolution):
    scans = short_flight()[: 60 if resolution == 0.5 else 36 : 12]
    frame = frame_of(scans, resolution)
    ours, theirs = OctreeMap(frame, trees.RULE, RANGE), library_tree(resolution)
    for n, (points, origin) in enumerate(scans):
        ours.mark()
        ours.insert(*scans[(n + 2) % len(scans)])
        ours.rollback()
        assert trees.tree_data(ours.tree) == nodes_of(theirs)
        ours.insert(points, origin)
        feed(theirs, points, origin)
        assert trees.tree_data(ours.tree) == nodes_of(theirs)


@pytest.mark.slow
@pytest.mark.parametrize(("environment", "autopilot", "seed", "resolution", "course"), WHOLE)
def test_both_maps_equal_the_library_over_whole_missions(environment, autopilot, seed, resolution, course):
    scenario = resolve(MissionSpec(environment=environment, seed=seed, autopilot=autopilot, **course))
    flight, scans = recorded(scenario.model_copy(update={"map": MapConfig(resolution=resolution)}))
    assert len(scans) > 20
    frame = frame_of(scans, resolution)
    ours, dense = OctreeMap(frame, trees.RULE, RANGE), DenseMap(frame, trees.RULE, RANGE)
    theirs = library_tree(resolution)
    for points, origin in scans:
        ours.insert(points, origin)
        dense.insert(points, origin)
        feed(theirs, points, origin)
    assert assert_equal_maps(ours, dense, theirs, frame) > 10_000
    flown = flight.pipeline["octomap"]  # its own grid ends a few metres outside of the arena
    in_flight = trees.dense_from(nodes_of(theirs), flown.frame)
    assert np.nan_to_num(in_flight).tobytes() == flown.map.log_odds.tobytes()
