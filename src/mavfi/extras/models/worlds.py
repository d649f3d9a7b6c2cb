"""Worlds of other simulators as environments: SDF worlds, MJCF scenes, and test cases of Aerialist."""

import fnmatch
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavfi.config import EnvironmentConfig, Vector
from mavfi.errors import BadInputError
from mavfi.extras.models.boxes import boxes_of
from mavfi.extras.models.geometry import BOX, CAPSULE, CYLINDER, ELLIPSOID, IDENTITY, MESH, PLANE, SPHERE, Pose, Shape
from mavfi.extras.models.sdf import SdfReader
from mavfi.extras.models.vehicles import is_multirotor
from mavfi.extras.models.xml_files import PATH_VARIABLES, read_xml
from mavfi.sim.environments.world import World
from mavfi.sim.mjcf import StaticGeom, static_geoms

LEAST_MARGIN = 20.0
"""Arena around start and goal, at least (m)."""
_EDGE = 1.0
"""Distance of the flight volume from the edge of the arena (m)."""
_LOWEST = 1.6
_HIGHEST = 9.6
"""Heights of planned paths, as in our own worlds, unless start or goal is outside (m)."""
_ABOVE = 2.4
"""Of the arena above the highest path (m), as in our own worlds."""
_AROUND_ARENA = 30.0
"""Obstacles end here outside of the arena (m), where a flight has long ended."""
_FLAT = 1e-3
_STRAIGHT = 1e-6
_MOST_NAMES = 5
_MJCF_KINDS = {"box": BOX, "sphere": SPHERE, "capsule": CAPSULE, "ellipsoid": ELLIPSOID, "cylinder": CYLINDER}


class Scene(NamedTuple):
    """Obstacles of a file.

    Attributes:
        shapes: Shapes that stand still.
        visual_shapes: Shapes to look at, of what has none that collides; obstacles only if the user wants it.
        remarks: What is flown otherwise, or left out.
    """

    shapes: list[Shape]
    visual_shapes: list[Shape]
    remarks: list[str]


# ---- SDF -------------------------------------------------------------------------------------------------------------


def sdf_environment(path: Path) -> EnvironmentConfig:
    """The environment of an SDF file; see `mavfi.sim.imported.EnvironmentReader`."""
    return _environment(path, "sdf_world", sdf_scene)


def sdf_world(  # noqa: PLR0913 - the parameters of a generator
    seed: int,
    path: str,
    start: Vector | None = None,
    goal: Vector | None = None,
    without: Sequence[str] = (),
    *,
    visual: bool = False,
) -> World:
    """The world of an SDF file.

    Args:
        seed: Not used: the file is the same for every seed.
        path: File, `.sdf` or `.world`.
        start: Start (m); required.
        goal: Goal (m); required.
        without: Names or patterns of models, links or shapes that are left out, e.g. `tree*`, or `*(mesh)`.
        visual: Whether shapes to look at are obstacles, where nothing else of a link collides.

    Raises:
        BadInputError: It cannot be read, has shapes that are no boxes, or start or goal are missing.
    """
    del seed
    return _world(path, sdf_scene(Path(path)), start, goal, without, "sdf_world", visual=visual)


def sdf_scene(path: Path) -> Scene:
    """Obstacles of an SDF file: of all its models but vehicles."""
    file = SdfReader(path).read()
    shapes: list[Shape] = []
    visual_shapes: list[Shape] = []
    vehicles = []
    moving = []
    for model in file.models:
        if is_multirotor(model):
            vehicles.append(model.name)
            continue
        if not model.is_static and model.shapes:
            moving.append(model.name)
        shapes += [shape._replace(owner=f"{model.name}::{shape.owner}") for shape in model.shapes]
        visual_shapes += [shape._replace(owner=f"{model.name}::{shape.owner}") for shape in model.visual_shapes]
        shapes += [Shape(MESH, (), IDENTITY, name) for name in model.missing]
    remarks = []
    if vehicles:
        remarks.append(f"left out, as vehicles: {_listed(vehicles)}")
    if moving:
        remarks.append(f"not static, held where they stand: {_listed(moving)}")
    return Scene(shapes, visual_shapes, remarks)


# ---- MJCF ------------------------------------------------------------------------------------------------------------


def xml_environment(path: Path) -> EnvironmentConfig:
    """The environment of an MJCF scene, or of an SDF file of that extension; see `EnvironmentReader`."""
    root = read_xml(path).tag
    if root == "sdf":
        return sdf_environment(path)
    if root != "mujoco":
        raise BadInputError(f"{path}: an XML file of <{root}>; allowed: <mujoco> or <sdf>")
    return _environment(path, "mjcf_world", mjcf_scene)


def mjcf_world(  # noqa: PLR0913 - the parameters of a generator
    seed: int,
    path: str,
    start: Vector | None = None,
    goal: Vector | None = None,
    without: Sequence[str] = (),
    *,
    visual: bool = False,
) -> World:
    """The world of an MJCF scene; see `sdf_world`."""
    del seed
    return _world(path, mjcf_scene(Path(path)), start, goal, without, "mjcf_world", visual=visual)


def mjcf_scene(path: Path) -> Scene:
    """Obstacles of an MJCF scene: geoms that collide and that no joint moves; a mesh is its convex hull, as there."""
    geoms = static_geoms(path)
    # A body usually has geoms to look at beside those that collide; geoms of the world itself stand for themselves.
    colliding_bodies = {geom.body for geom in geoms if geom.collides and geom.body}
    shapes = [_mjcf_shape(geom) for geom in geoms if geom.collides]
    visual_shapes = [_mjcf_shape(geom) for geom in geoms if not geom.collides and geom.body not in colliding_bodies]
    return Scene(shapes, visual_shapes, [])


def _mjcf_shape(geom: StaticGeom) -> Shape:
    """A geom as a shape."""
    pose = Pose(geom.matrix, geom.position)
    if geom.kind == "plane":
        return Shape(PLANE, (), pose, geom.name)
    if geom.kind == "mesh":
        return Shape(MESH, (), pose, geom.name, geom.vertices)
    if geom.kind in _MJCF_KINDS:
        return Shape(_MJCF_KINDS[geom.kind], _mjcf_size(geom.kind, geom.size), pose, geom.name)
    return Shape(MESH, (), pose, f"{geom.name} ({geom.kind})")


def _mjcf_size(kind: str, size: np.ndarray) -> tuple[float, ...]:
    """Size of a shape, from half edges and half lengths (m)."""
    x, y, z = size.tolist()
    if kind == "box":
        return (2.0 * x, 2.0 * y, 2.0 * z)
    if kind in ("cylinder", "capsule"):
        return (x, 2.0 * y)
    if kind == "sphere":
        return (x,)
    return (x, y, z)


# ---- both ------------------------------------------------------------------------------------------------------------


def _environment(path: Path, generator: str, read: Callable[[Path], Scene]) -> EnvironmentConfig:
    """The environment of a file; a warning says what its obstacles are."""
    scene = read(path)
    solids = [shape for shape in scene.shapes if shape.kind != PLANE and not _is_unknown(shape)]
    # Whoever sees a wall in the simulator expects it in the way.
    remarks = list(scene.remarks)
    visual_only = [shape.owner.partition("::")[0] for shape in scene.visual_shapes if not _is_ground_plane(shape)]
    if visual_only:
        remarks.append(
            f"only to look at, and flown through: {_listed(visual_only)} (obstacles with 'generator: {generator}' and "
            f"'parameters: {{path: {path}, visual: true}}' in an environment file)"
        )
    say_boxes(path, solids, remarks)
    return EnvironmentConfig(name=path.stem, generator=generator, parameters={"path": str(path)})


def say_boxes(path: Path, shapes: Sequence[Shape], remarks: Sequence[str]) -> None:
    """Warn of what becomes of the shapes of a file."""
    boxes = boxes_of(shapes)
    text = f"{path}: obstacles: {len(shapes)}"
    if len(boxes.lower) != len(shapes):
        text += f", as {len(boxes.lower)} boxes"
    if boxes.cell > 0.0:
        text += f"; those that are not along the axes are up to {boxes.cell:.2g} m thicker"
    warnings.warn("; ".join([text, *remarks]), stacklevel=2)


def _is_unknown(shape: Shape) -> bool:
    return shape.kind == MESH and shape.vertices is None


def _world(  # noqa: PLR0913 - the parameters of a generator
    path: str,
    scene: Scene,
    start: Vector | None,
    goal: Vector | None,
    without: Sequence[str],
    generator: str,
    *,
    visual: bool,
) -> World:
    """A world with the obstacles of a scene."""
    if start is None or goal is None:
        raise BadInputError(f"{path}: has no start and goal of its own; give both")
    if isinstance(without, str) or not all(isinstance(pattern, str) for pattern in without):
        raise BadInputError(f"parameter 'without': {without!r}; allowed: a list of names or patterns")
    if not isinstance(visual, bool):
        raise BadInputError(f"parameter 'visual': {visual!r}; allowed: true, false")
    shapes = list(scene.shapes)
    if visual:
        shapes += scene.visual_shapes
    shapes = [shape for shape in shapes if not _matches(shape.owner, without)]
    unknown = [shape.owner for shape in shapes if _is_unknown(shape)]
    if unknown:
        raise BadInputError(
            f"{path}: shapes that are no boxes: {_listed(unknown)}; allowed: without them, by an environment file with "
            f"'generator: {generator}' and 'parameters: {{path: {path}, without: [NAME, ...]}}' (a name or a pattern); "
            f"models are looked for beside the file and in folders of {PATH_VARIABLES[0]}"
        )
    return world_of(path, shapes, start, goal)


def world_of(path: str, shapes: Sequence[Shape], start: Vector, goal: Vector) -> World:
    """A world with ground at z = 0, in an arena around start and goal.

    Args:
        path: The file, for messages.
        shapes: Obstacles, among them planes.
        start: Start (m).
        goal: Goal (m).

    Raises:
        BadInputError: A plane is tilted, or the shapes are too many.
    """
    ends = np.array([start, goal], float)
    margin = max(LEAST_MARGIN, 0.5 * float(np.sqrt(np.square(ends[1] - ends[0]).sum())))
    highest = max(_HIGHEST, float(ends[:, 2].max()))
    arena_lower = np.array([*(ends.min(axis=0)[:2] - margin), 0.0])
    arena_upper = np.array([*(ends.max(axis=0)[:2] + margin), highest + _ABOVE])
    flight_lower = arena_lower + _EDGE
    flight_upper = arena_upper - _EDGE
    flight_lower[2] = min(_LOWEST, float(ends[:, 2].min()))
    flight_upper[2] = highest

    # Far from the arena nothing can be touched, and below the ground neither.
    try:
        boxes = boxes_of([shape for shape in shapes if shape.kind != PLANE])
    except BadInputError as error:
        raise BadInputError(f"{path}: {error}") from None
    planes = [_slab(path, shape) for shape in shapes if shape.kind == PLANE and not _is_ground_plane(shape)]
    lower = np.concatenate([boxes.lower, np.array([low for low, _ in planes]).reshape(-1, 3)])
    upper = np.concatenate([boxes.upper, np.array([high for _, high in planes]).reshape(-1, 3)])
    lower = np.maximum(lower, arena_lower - _AROUND_ARENA)
    upper = np.minimum(upper, arena_upper + _AROUND_ARENA)
    inside = (lower < upper).all(axis=1) & (upper[:, 2] > _FLAT)
    return World(
        start=ends[0],
        goal=ends[1],
        arena_lower=arena_lower,
        arena_upper=arena_upper,
        flight_lower=flight_lower,
        flight_upper=flight_upper,
        lower=lower[inside],
        upper=upper[inside],
    )


def _is_ground_plane(shape: Shape) -> bool:
    """Whether a shape is the ground, or a plane below it."""
    return shape.kind == PLANE and bool(shape.pose.matrix[2, 2] > 1.0 - _STRAIGHT and shape.pose.position[2] < _FLAT)


def _slab(path: str, shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Corners of what is behind a plane (m); a tilted one is refused."""
    normal = shape.pose.matrix[:, 2]
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) < 1.0 - _STRAIGHT:
        raise BadInputError(f"{path}: {shape.owner}: a tilted plane; allowed: planes along the axes, or boxes")
    lower = np.full(3, -math.inf)
    upper = np.full(3, math.inf)
    if normal[axis] > 0.0:
        upper[axis] = shape.pose.position[axis]
    else:
        lower[axis] = shape.pose.position[axis]
    return lower, upper


def _matches(owner: str, patterns: Sequence[str]) -> bool:
    """Whether a model or a link of it has one of these names."""
    names = [owner, *owner.split("::"), owner.partition(" (")[0]]
    return any(fnmatch.fnmatchcase(name, pattern) for name in names for pattern in patterns)


def _listed(names: Sequence[str]) -> str:
    """The first few names."""
    different = list(dict.fromkeys(names))
    text = ", ".join(different[:_MOST_NAMES])
    if len(different) > _MOST_NAMES:
        text += f" and {len(different) - _MOST_NAMES} more"
    return text
