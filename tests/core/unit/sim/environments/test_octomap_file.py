"""Reading OctoMap's files: small ones that the tests write, and a real scan."""

import math
import warnings

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.flight.compose import new_loop, resolve
from mavfi.mission import MissionSpec
from mavfi.sim.environments import octomap_file as octomap_file_module
from mavfi.sim.environments.octomap_file import octomap_file
from tests.core.unit.sim.environments.octrees import bits, count, tree_of, values

RESOLUTION = 0.25
CENTRE = 32768
START, GOAL = (0.3, 0.3, 0.3), (0.6, 0.3, 0.3)


def write(path, voxels, body, kind="OcTree", resolution=RESOLUTION):
    title = b"# Octomap OcTree binary file" if body is bits else b"# Octomap OcTree file"
    header = b"%s\n# a comment\nid %s\nsize 1\nres %g\ndata\n" % (title, kind.encode(), resolution)
    path.write_bytes(header + body(tree_of(voxels)))
    return path


@pytest.fixture
def voxels():
    """A free room of 6 x 4 x 4 voxels with a pruned cube in it, one occupied voxel, and an occupied wall."""
    occupied = {(CENTRE + i, CENTRE + j, CENTRE + k): False for i in range(6) for j in range(4) for k in range(4)}
    occupied |= {(CENTRE + 6, CENTRE + j, CENTRE + k): True for j in range(4) for k in range(4)}
    return occupied | {(CENTRE + 4, CENTRE + 2, CENTRE + 1): True}


@pytest.mark.slow
@pytest.mark.parametrize(("ending", "body"), ((".bt", bits), (".ot", values)))
def test_a_written_map_is_read_voxel_by_voxel(tmp_path, voxels, ending, body):
    path = write(tmp_path / f"room{ending}", voxels, body)
    world = octomap_file(0, str(path), START, GOAL)
    assert world.resolution == RESOLUTION
    solid = np.ones(world.occupied.shape, bool)
    for key, occupied in voxels.items():
        index = tuple(np.round((np.array(key) - CENTRE) - world.origin / RESOLUTION).astype(int))
        solid[index] = occupied
    np.testing.assert_array_equal(world.occupied, solid)
    assert world.occupied.shape == (9, 6, 6)


def test_unknown_space_is_solid_and_distances_follow(tmp_path, voxels):
    world = octomap_file(0, str(write(tmp_path / "room.bt", voxels, bits)), START, GOAL)
    points = np.array([(0.5, 0.5, 0.5), (0.1, 0.5, 0.5), (0.75, 0.625, 0.375), (-0.1, 0.5, 0.5), (9.0, 9.0, 9.0)])
    np.testing.assert_allclose(world.clearance(points), (0.5, 0.1, 0.25, 0.0, 0.0), atol=1e-12)
    assert math.isnan(world.clearance(np.array([math.nan, 0.0, 0.0]))[0])


@pytest.mark.parametrize(("ending", "body"), ((".bt", bits), (".ot", values)))
@pytest.mark.parametrize("lost", (1, 20))
def test_a_truncated_map_is_refused_by_name(tmp_path, voxels, ending, body, lost):
    path = write(tmp_path / f"room{ending}", voxels, body)
    path.write_bytes(path.read_bytes()[:-lost])
    with pytest.raises(BadInputError, match=rf"room{ending}.*truncated"):
        octomap_file(0, str(path), START, GOAL)


@pytest.mark.parametrize(
    "content",
    (
        b"# Octomap OcTree binary file\nid OcTree\nres 0.1\n",
        b"# Octomap OcTree binary file\nid ColorOcTree\nres 0.1\ndata\n\x00\x00",
        b"# Octomap OcTree binary file\nid OcTree\nres nan\ndata\n\x00\x00",
        b"# Octomap OcTree binary file\nid OcTree\nres 0.1\ndata\n\x00\x00",
    ),
)
def test_a_foreign_file_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "foreign.bt"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=r"foreign\.bt") as caught:
        octomap_file(0, str(path), START, GOAL)
    assert "\n" not in str(caught.value)


def test_an_absent_file_or_end_is_refused(tmp_path, voxels):
    with pytest.raises(BadInputError, match="cannot be read"):
        octomap_file(0, str(tmp_path / "none.bt"), START, GOAL)
    with pytest.raises(BadInputError, match="give both"):
        octomap_file(0, str(write(tmp_path / "room.bt", voxels, bits)), START, None)
    with pytest.raises(BadInputError, match="path"):
        octomap_file(0, 7, START, GOAL)


@pytest.mark.parametrize(
    ("kind", "more"), (("OcTreeStamped", b""), ("ColorOcTree", b"\xff\x80\x00"), ("SemanticOcTree", bytes(range(9))))
)
def test_trees_whose_nodes_have_more_than_occupancy_are_the_same_map(tmp_path, voxels, kind, more):
    tree = tree_of(voxels)
    plain = octomap_file(0, str(write(tmp_path / "plain.ot", voxels, values)), START, GOAL)
    path = tmp_path / "other.ot"
    header = f"# Octomap OcTree file\nid {kind}\nsize {count(tree)}\nres {RESOLUTION}\ndata\n".encode()
    path.write_bytes(header + values(tree, more))
    assert octomap_file(0, str(path), START, GOAL).digest() == plain.digest()
    bits_path = write(tmp_path / "other.bt", voxels, bits, kind)
    assert octomap_file(0, str(bits_path), START, GOAL).digest() == plain.digest()
    path.write_bytes(header + values(tree, more) + b"\0" * 3)
    if kind == "SemanticOcTree":  # the size of its nodes follows from the length of the file
        with pytest.raises(BadInputError, match="id 'SemanticOcTree'.*nodes of equal size"):
            octomap_file(0, str(path), START, GOAL)


@pytest.mark.parametrize(
    ("content", "message"),
    (
        (b"# Octomap OcTree binary file\nid OcTree\nsize 0\nres 0.1\ndata\n", "the map is empty .size 0."),
        (b"# Octomap OcTree file\nid ColorOcTree\nsize 0\nres 0.1\ndata\n", "the map is empty .size 0."),
        (b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.1\ndata\n\0\0", "the map is empty"),
        (b"# Octomap OcTree file\nid CountingOcTree\nsize 1\nres 1\ndata\n\1\0\0\0\0", "'CountingOcTree': .* no occup"),
        (b"# Octomap OcTree file\nid OcTree\nsize 1\nres 1\ndata\nabcd\0", "do not start with log-odds"),
    ),
)
def test_maps_without_known_space_are_said_to_be_so(tmp_path, content, message):
    path = tmp_path / "map.ot"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=message):
        octomap_file(0, str(path), START, GOAL)


def test_unknown_space_of_a_map_of_obstacles_can_be_free(tmp_path):
    pillar = {(CENTRE + i, CENTRE + j, CENTRE + k): True for i in range(2) for j in range(2) for k in range(8)}
    path = str(write(tmp_path / "pillar.bt", pillar, bits))
    ends = (-4.0, 0.3, 1.0), (4.0, 0.3, 1.0)
    with pytest.raises(BadInputError, match="no free voxel .* unknown space counts as solid; allowed: --unknown-space"):
        octomap_file(0, path, *ends)
    world = octomap_file(0, path, *ends, unknown="free")
    assert world.occupied.sum() == 32
    distances = world.clearance(np.array([(0.25, 0.25, 1.0), (-4.0, 0.25, 1.0), (0.25, 2.5, 1.0)]))
    np.testing.assert_allclose(distances, (0.0, 2.0, 2.0), atol=1e-12)  # to the floor of the grid
    spec = MissionSpec(environment=path, start=ends[0], goal=ends[1], unknown_space="free")
    assert resolve(spec).environment.parameters["unknown"] == "free"
    assert "unknown_space" not in MissionSpec(environment=path).to_json()
    with pytest.raises(BadInputError, match="unknown_space: free: environment 'sparse' is no scanned map"):
        resolve(MissionSpec(environment="sparse", unknown_space="free"))


def test_the_map_of_a_large_scan_is_as_coarse_as_the_scan_and_a_finer_one_is_refused_with_one_that_is_allowed(tmp_path):
    field = {(CENTRE, CENTRE, CENTRE + k): False for k in range(4)} | {(CENTRE + 500, CENTRE + 500, CENTRE + 50): True}
    large = str(write(tmp_path / "field.bt", field, bits, resolution=0.2))
    assert resolve(MissionSpec(environment=large, start=START, goal=GOAL)).map.resolution == 0.2
    room = {(CENTRE, CENTRE, CENTRE + k): False for k in range(4)}
    small = str(write(tmp_path / "small.bt", room, bits, resolution=0.2))
    assert resolve(MissionSpec(environment=small, start=START, goal=GOAL)).map.resolution == 0.08


def test_a_start_that_is_closer_to_a_wall_than_paths_are_is_warned_about(tmp_path):
    free = {(CENTRE + i, CENTRE + j, CENTRE + k): False for i in range(24) for j in range(16) for k in range(8)}
    path = str(write(tmp_path / "hall.bt", free, bits))
    # small_quad: planner's distance 1.4 m x 0.06 / 0.35, a voxel of 0.08 m
    near = resolve(MissionSpec(environment=path, start=(1.0, 0.25, 1.0), goal=(5.0, 2.0, 1.0)))
    with pytest.warns(UserWarning, match=r"start \(1, 0.25, 1\): 0.25 m from a wall; less than 0.32 m"):
        new_loop(near)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        new_loop(near.model_copy(update={"start": (1.0, 0.35, 1.0)}))


def hall(wall=()):
    """Free space of 20 x 10 x 4 m in voxels of 0.25 m, with solid slices at x = 10 m."""
    occupied = np.ones((82, 42, 18), bool)
    occupied[1:-1, 1:-1, 1:-1] = False
    for low, high in wall:
        occupied[40, low:high] = True
    return occupied


def test_ends_without_a_way_between_them_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "hall.bt"
    path.write_bytes(b"")
    blocked = (hall([(0, 42)]), np.array([0.0, -5.25, 0.0]), 0.25)
    monkeypatch.setattr(octomap_file_module, "_read_grid", lambda *_: blocked)
    with pytest.raises(BadInputError, match="no way"):
        octomap_file(0, str(path), (5.0, 0.0, 1.5), (15.0, 0.0, 2.0))
