"""Test cases of Aerialist (https://github.com/skhatiri/Aerialist) and missions of QGroundControl as environments.

A test case names obstacles and a mission.  Its x points north and its y east; ours are east and north.  A mission's
position is that of its latitude and longitude from home, on a plane.  We fly from above home, at the height of the
first way-point, to the last one with a position; those between are not flown.
"""

import json
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mavfi.config import EnvironmentConfig, Vector, read_yaml
from mavfi.errors import BadInputError
from mavfi.extras.models.geometry import BOX, CYLINDER, Pose, Shape, matrix_of_rpy
from mavfi.extras.models.worlds import say_boxes, world_of
from mavfi.files import LARGEST_TEXT, is_file, read_file
from mavfi.sim.environments.world import World

_OF_TEST_CASES = {"robot", "drone", "simulation"}
"""Keys of test cases, the second in older ones."""
_EARTH = 6371000.0
"""Mean radius (m)."""
_WAYPOINT = 16
_LAND = 21
_TAKEOFF = 22
"""Commands of MAVLink with a position that a mission flies to."""
_NUMBERS_PER_BOX = 7
_LEAST_HEIGHT = 0.5


class _TestMission(NamedTuple):
    """Ends of a mission, from home, in our axes (m).

    Attributes:
        start: Above home.
        goal: Last position.
        between: Number of positions between them.
    """

    start: Vector
    goal: Vector
    between: int


def yaml_environment(path: Path) -> EnvironmentConfig | None:
    """The environment of a test case; None = another YAML file.  See `mavfi.sim.imported.EnvironmentReader`."""
    data = read_yaml(path)
    if "generator" in data or not _OF_TEST_CASES & set(data):
        return None
    return plan_environment(path)


def plan_environment(path: Path) -> EnvironmentConfig:
    """The environment of a test case or a mission of QGroundControl; a warning says what is not flown."""
    shapes, mission = _read(path)
    remarks = []
    if path.suffix.lower() != ".plan" and _mapping(read_yaml(path), "simulation", path).get("wind"):
        remarks.append("its wind is not flown; --wind adds gusts")
    if mission is not None and mission.between:
        remarks.append(f"flown from above home to the last way-point; {mission.between} between are not")
    if shapes:
        say_boxes(path, shapes, remarks)
    elif remarks:
        warnings.warn(f"{path}: {'; '.join(remarks)}", stacklevel=2)
    return EnvironmentConfig(name=path.stem, generator="aerialist_test", parameters={"path": str(path)})


def aerialist_test(seed: int, path: str, start: Vector | None = None, goal: Vector | None = None) -> World:
    """The world of a test case or a mission.

    Args:
        seed: Not used: the file is the same for every seed.
        path: File, `.yaml` of Aerialist or `.plan` of QGroundControl.
        start: Start (m); by default above home.
        goal: Goal (m); by default the last position of the mission.

    Raises:
        BadInputError: It cannot be read, or has no mission, and start or goal are missing.
    """
    del seed
    shapes, mission = _read(Path(path))
    if mission is None and (start is None or goal is None):
        raise BadInputError(f"{path}: names no mission (robot: mission_file), so has no start and goal; give both")
    if mission is not None:
        start = start or mission.start
        goal = goal or mission.goal
    assert start is not None
    assert goal is not None
    return world_of(path, shapes, start, goal)


def _read(path: Path) -> tuple[list[Shape], _TestMission | None]:
    """Obstacles and mission of a file."""
    if path.suffix.lower() == ".plan":
        return [], _mission(path, None)
    data = read_yaml(path)
    simulation = _mapping(data, "simulation", path)
    robot = {**_mapping(data, "drone", path), **_mapping(data, "robot", path)}
    shapes = [_obstacle(row, path) for row in _rows(simulation.get("obstacles"), path)]
    name = robot.get("mission_file")
    if name is None:
        return shapes, None
    file = _beside(path, str(name))
    if file is None:
        raise BadInputError(f"{path}: key 'mission_file': {name}: there is no such file; allowed: a .plan beside it")
    return shapes, _mission(file, simulation.get("home_position"))


def _mapping(data: Mapping[str, Any], key: str, path: Path) -> dict[str, Any]:
    value = data.get(key)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise BadInputError(f"{path}: key {key!r}: {value!r}: allowed: keys with values")
    return value


def _beside(path: Path, name: str) -> Path | None:
    """A file that a test case names: from the working directory, or from one of the folders above the test case."""
    for folder in (Path(), *path.absolute().parents):
        for candidate in (folder / name, folder / Path(name).name):
            if is_file(candidate):
                return candidate
    return None


# ---- obstacles -------------------------------------------------------------------------------------------------------


def _rows(obstacles: Any, path: Path) -> list[Any]:  # noqa: ANN401 - as in a YAML file
    """Obstacles one by one: mappings, or seven numbers each, also in one list."""
    if obstacles is None:
        return []
    if not isinstance(obstacles, list):
        raise BadInputError(f"{path}: key 'obstacles': {obstacles!r}: allowed: a list")
    if obstacles and all(isinstance(value, int | float) for value in obstacles):
        if len(obstacles) % _NUMBERS_PER_BOX:
            raise BadInputError(f"{path}: key 'obstacles': {len(obstacles)} numbers: allowed: l w h x y z r for each")
        return [obstacles[n : n + _NUMBERS_PER_BOX] for n in range(0, len(obstacles), _NUMBERS_PER_BOX)]
    return obstacles


def _obstacle(row: Any, path: Path) -> Shape:  # noqa: ANN401 - as in a YAML file
    """A box, or a cylinder, on its height z."""
    kind = BOX
    if isinstance(row, dict):
        size = _mapping(row, "size", path)
        position = _mapping(row, "position", path)
        kind = row.get("shape") or BOX
        row = [*(size.get(key, 0.0) for key in "lwh"), *(position.get(key, 0.0) for key in "xyzr")]
        if kind == CYLINDER:
            row[0] = row[1] = 2.0 * size.get("r", 0.0)
    numbers = isinstance(row, list) and len(row) == _NUMBERS_PER_BOX and all(_is_number(value) for value in row)
    if kind not in (BOX, CYLINDER) or not numbers or not min(row[:3]) > 0.0:
        raise BadInputError(
            f"{path}: obstacle {row!r} ({kind}): allowed: a box or cylinder with sizes above 0 and finite positions"
        )
    north, east, height, x, y, z, turn = (float(value) for value in row)
    centre = np.array([y, x, z + 0.5 * height])
    if kind == CYLINDER:
        return Shape(CYLINDER, (0.5 * north, height), Pose(np.eye(3), centre), "obstacle")
    # angles are clockwise from above, from north to east
    matrix = matrix_of_rpy(0.0, 0.0, -math.radians(turn))
    return Shape(BOX, (east, north, height), Pose(matrix, centre), "obstacle")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


# ---- missions --------------------------------------------------------------------------------------------------------


def _mission(path: Path, home: Any) -> _TestMission:  # noqa: ANN401 - as in a YAML file
    """Ends of a mission of QGroundControl; `home` = latitude, longitude (degrees), ... instead of the planned home."""
    try:
        plan = json.loads(read_file(path, LARGEST_TEXT))
        mission = plan["mission"]
        items = mission["items"]
        home = home or mission.get("plannedHomePosition")
    except (ValueError, KeyError, TypeError, RecursionError):
        raise BadInputError(f"{path}: not a mission of QGroundControl; allowed: a .plan file") from None
    positions = [position for item in _simple_items(items) if (position := _position(item)) is not None]
    if home is None and positions:
        home = positions[0][:2]
    if not isinstance(home, list | tuple) or not all(_is_number(value) for value in home[:2]) or len(home) < 2:
        raise BadInputError(f"{path}: home {home!r}: allowed: latitude and longitude, degrees")
    if not positions:
        raise BadInputError(f"{path}: no way-point with a position; allowed: one at least")

    # To our axes; a landing keeps the height before it.
    points: list[Vector] = []
    height = max(positions[0][2], _LEAST_HEIGHT)
    for latitude, longitude, altitude in positions:
        if altitude >= _LEAST_HEIGHT:
            height = altitude
        north = math.radians(latitude - home[0]) * _EARTH
        east = math.radians(longitude - home[1]) * _EARTH * math.cos(math.radians(home[0]))
        points.append((round(east, 3), round(north, 3), height))
    return _TestMission((0.0, 0.0, points[0][2]), points[-1], len(points) - 1)


def _simple_items(items: Any) -> Sequence[Mapping[str, Any]]:  # noqa: ANN401 - as in a JSON file
    """Commands of a mission; those of a survey stand inside it."""
    if not isinstance(items, list):
        return []
    commands: list[Mapping[str, Any]] = []
    for item in items:
        if not isinstance(item, dict):
            continue
        if item.get("type") == "ComplexItem":
            inner = item.get("TransectStyleComplexItem")
            if isinstance(inner, dict):
                commands += _simple_items(inner.get("Items"))
        else:
            commands.append(item)
    return commands


def _position(item: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """Latitude, longitude (degrees) and height (m) of a command; None = it has none."""
    parameters = item.get("params")
    if item.get("command") not in (_WAYPOINT, _LAND, _TAKEOFF) or not isinstance(parameters, list):
        return None
    position = parameters[4:7]
    if len(position) < 3 or not all(_is_number(value) for value in position) or position[:2] == [0, 0]:
        return None
    latitude, longitude, altitude = (float(value) for value in position)
    return latitude, longitude, altitude
