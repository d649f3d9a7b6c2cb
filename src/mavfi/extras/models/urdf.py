"""Robots in URDF, the format of ROS, also with the macros of xacro: links, joints, and plug-ins for Gazebo."""

import contextlib
import io
import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, not_installed
from mavfi.extras.models.geometry import (
    BOX,
    CAPSULE,
    CYLINDER,
    IDENTITY,
    MESH,
    SPHERE,
    MassProperties,
    Pose,
    Shape,
    pose_of,
)
from mavfi.extras.models.xml_files import find_file, numbers, parse_xml, read_xml
from mavfi.files import is_dir, is_file
from mavfi.numerics.vectors import product
from mavfi.plugins import require_allowed

_NAMES = ("namespace", "robot_namespace", "mav_name", "robot_name", "prefix", "tf_prefix", "name", "ns")
"""Arguments of xacro files that are names only; launch files usually give them."""


@dataclass
class UrdfRobot:
    """A robot with all joints at zero.

    Attributes:
        name: Its name.
        root: The element <robot>.
        links: Poses of its links in the axes of the root link, by name.
        masses: Mass properties of the links that have any, in the same axes, by link.
        centres: Position of the <inertial> of every link that has one, also without mass (m), by link.
        shapes: Shapes for contacts, in the same axes.
        moving: Names of joints that are not fixed, with their child links.
        plugins: Plug-ins for Gazebo (elements).
    """

    name: str
    root: ET.Element
    links: dict[str, Pose] = field(default_factory=dict)
    masses: dict[str, MassProperties] = field(default_factory=dict)
    centres: dict[str, np.ndarray] = field(default_factory=dict)
    shapes: list[Shape] = field(default_factory=list)
    moving: dict[str, str] = field(default_factory=dict)
    plugins: list[ET.Element] = field(default_factory=list)


def read_urdf(path: Path) -> UrdfRobot:
    """A robot from a URDF file; raises a `BadInputError` if the file holds none."""
    return robot_from(read_xml(path), path)


def robot_from(root: ET.Element, path: Path) -> UrdfRobot:
    """A robot from the root of a document; `path` is for messages.

    Raises:
        BadInputError: It is no URDF, or its links do not form a tree.
    """
    if root.tag != "robot":
        raise BadInputError(f"{path}: an XML file of <{root.tag}>; allowed: <robot>")
    if any(element.tag.startswith("{") and "xacro" in element.tag for element in root.iter()):
        raise BadInputError(f"{path}: has macros of xacro; allowed: a name that ends in .xacro")
    robot = UrdfRobot(root.get("name") or path.stem, root)
    elements = {link.get("name", ""): link for link in root.findall("link")}
    if not elements:
        raise BadInputError(f"{path}: a robot without links; allowed: one link at least")
    joints = root.findall("joint")
    children = {_link_of(joint, "child") for joint in joints}

    # From the root outwards; links that no joint connects stand at the origin.
    robot.links = {name: IDENTITY for name in elements if name not in children}
    waiting = list(joints)
    while waiting:
        placed = [joint for joint in waiting if _link_of(joint, "parent") in robot.links]
        if not placed:
            names = ", ".join(joint.get("name", "") for joint in waiting)
            raise BadInputError(f"{path}: joints {names}: no way from a root link to them; allowed: a tree of links")
        for joint in placed:
            what = f"{path}: joint {joint.get('name', '')!r}"
            child = _link_of(joint, "child")
            robot.links[child] = robot.links[_link_of(joint, "parent")].apply(_origin(joint, what))
            if joint.get("type") != "fixed":
                robot.moving[joint.get("name", "")] = child
        waiting = [joint for joint in waiting if joint not in placed]
    for name, link in elements.items():
        _add_parts(robot, name, link, path)
    robot.plugins = [plugin for gazebo in root.findall("gazebo") for plugin in gazebo.findall("plugin")]
    return robot


def _add_parts(robot: UrdfRobot, name: str, link: ET.Element, path: Path) -> None:
    """Mass properties and shapes of a link."""
    what = f"{path}: link {name!r}"
    frame = robot.links[name]
    inertial = link.find("inertial")
    if inertial is not None:
        placed = frame.apply(_origin(inertial, what))
        robot.centres[name] = placed.position
        mass = _attribute(inertial.find("mass"), "value", what)
        if mass:
            tensor = _tensor(inertial.find("inertia"), what)
            turned = product(product(placed.matrix, tensor), placed.matrix.T)
            robot.masses[name] = MassProperties(mass, placed.position, turned)
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        if geometry is not None and len(geometry):
            robot.shapes.append(_shape(geometry[0], frame.apply(_origin(collision, what)), name, what))


def _link_of(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    if element is None:
        return ""
    return element.get("link", "")


def _origin(element: ET.Element, what: str) -> Pose:
    origin = element.find("origin")
    if origin is None:
        return IDENTITY
    place = numbers(origin.get("xyz", "0 0 0"), 3, f"{what}: origin xyz")
    turn = numbers(origin.get("rpy", "0 0 0"), 3, f"{what}: origin rpy")
    return pose_of((*place, *turn))


def _attribute(element: ET.Element | None, name: str, what: str) -> float:
    """The number in an attribute; 0 without the element or the attribute."""
    if element is None:
        return 0.0
    return numbers(element.get(name, "0"), 1, f"{what}: {name}")[0]


def _tensor(element: ET.Element | None, what: str) -> np.ndarray:
    """Inertia of a link about its centre of mass (kg m^2). Shape (3, 3)."""
    tensor = np.zeros((3, 3))
    for row, first in enumerate("xyz"):
        for column, second in enumerate("xyz"):
            low, high = sorted((first, second))
            tensor[row, column] = _attribute(element, f"i{low}{high}", what)
    return tensor


def _shape(element: ET.Element, pose: Pose, owner: str, what: str) -> Shape:
    if element.tag == "box":
        return Shape(BOX, numbers(element.get("size"), 3, f"{what}: size"), pose, owner)
    if element.tag in (CYLINDER, CAPSULE):
        size = (_attribute(element, "radius", what), _attribute(element, "length", what))
        return Shape(element.tag, size, pose, owner)
    if element.tag == "sphere":
        return Shape(SPHERE, (_attribute(element, "radius", what),), pose, owner)
    return Shape(MESH, (), pose, f"{owner} ({element.tag})")


# ---- xacro -----------------------------------------------------------------------------------------------------------


def read_xacro(path: Path, arguments: Mapping[str, Any]) -> UrdfRobot:
    """A robot from a file with macros, which the package xacro expands; ROS is not needed.

    Args:
        path: The file.
        arguments: Arguments of the file, by name, as `xacro` takes them.

    Raises:
        BadInputError: It cannot be expanded, e.g. as an argument or a package is missing, or is no URDF.
        NotAllowedError: It was neither typed nor allowed; its expressions are evaluated as Python.
    """
    if not is_file(path):
        raise BadInputError(f"{path}: there is no such file")
    require_allowed("xacro file", str(path))
    try:
        import xacro
        from xacro import substitution_args
    except ImportError:
        raise not_installed(str(path), "xacro (no ROS)", "models") from None

    def find_package(name: str) -> str:
        """The folder of a package of ROS: beside or above the file, or as ROS finds it."""
        for candidate in (path.absolute().parent, *path.absolute().parents):
            if candidate.name == name:
                return str(candidate)
        folder = find_file(name, path)
        if folder is None or not is_dir(folder):
            raise substitution_args.SubstitutionException(
                f"the package {name} is not on this machine; allowed: in a folder of ROS_PACKAGE_PATH"
            )
        return str(folder)

    mappings = {name: str(value) for name, value in arguments.items()}
    find_before = substitution_args._eval_find
    substitution_args._eval_find = substitution_args._eval_dict["find"] = find_package
    try:
        text = _expand(xacro, path, mappings)
    finally:
        substitution_args._eval_find = substitution_args._eval_dict["find"] = find_before
    return robot_from(parse_xml(text, path), path)


def _expand(xacro: Any, path: Path, mappings: dict[str, str]) -> str:  # noqa: ANN401 - a module
    """The expanded document; names that a launch file would give are that of the file."""
    for name in _NAMES:
        mappings.setdefault(name, path.name.partition(".")[0])
    here = os.getcwd()
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            return str(xacro.process_file(str(path), mappings=mappings).toxml())
        except SystemExit as stopped:
            raise BadInputError(f"{path}: cannot be expanded by xacro ({stopped})") from None
        except Exception as wrapped:  # noqa: BLE001 - whatever the expressions in the file raise
            error: BaseException = wrapped
            while getattr(error, "exc", None) is not None:
                error = error.exc  # type: ignore[attr-defined] # xacro wraps it once for each macro
            reason = " ".join(f"{error}".split()) or type(error).__name__
            allowed = ""
            if "ndefined substitution argument" in reason:
                allowed = "; allowed: a YAML file with 'model: FILE' and 'xacro: {ARGUMENT: VALUE}'"
            raise BadInputError(f"{path}: cannot be expanded by xacro ({reason}){allowed}") from None
        finally:
            os.chdir(here)
