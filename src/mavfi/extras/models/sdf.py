"""Models and worlds in SDF, the format of Gazebo: https://sdformat.org/spec, versions 1.4 to 1.12.

A model becomes its links with their poses in the axes of the model; nested models and included ones become part of it,
links of a nested model under the name `model::link`.  Poses follow the rules of version 1.7 on, which agree with those
of earlier versions where these have no attribute `relative_to`.
"""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.models.geometry import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    IDENTITY,
    MESH,
    PLANE,
    SPHERE,
    MassProperties,
    Pose,
    Shape,
    matrix_of_rpy,
    pose_of,
)
from mavfi.extras.models.xml_files import find_file, number, numbers, parse_xml, read_xml
from mavfi.files import LARGEST_TEXT, is_dir, is_file, read_file
from mavfi.numerics.rotations import rotation_matrix
from mavfi.numerics.vectors import product

_DEEPEST = 20
"""Models within each other, at most."""
_MOST_MODELS = 20_000
_TEMPLATE = ".jinja"
_SUN = re.compile(r"(^|[/:])sun(/\d+)?/?$", re.IGNORECASE)
_GROUND = re.compile(r"(^|[/:])(ground|asphalt)[ _]plane(/\d+)?/?$", re.IGNORECASE)
"""Models that Gazebo brings: a light, and grounds at z = 0."""


@dataclass
class Joint:
    """A joint of a model: its kind, and the names of its links."""

    name: str
    kind: str
    parent: str
    child: str


@dataclass
class SdfModel:
    """A model with all models inside it.

    Attributes:
        name: Its name.
        links: Poses of its links, in its axes, by name.
        frames: Poses of all its frames, in its axes, by name.
        masses: Mass properties of the links that have any, in its axes, by link.
        shapes: Shapes for contacts, in its axes.
        visual_shapes: Shapes of links that have none for contacts, in its axes.
        joints: Its joints.
        plugins: Its plug-ins (elements).
        is_static: Whether it stands still.
        has_ground: Whether it is, or includes, Gazebo's ground plane.
        massless: Links without an element <inertial>.
        missing: Models that it has, and that cannot be read, with the reason.
    """

    name: str
    links: dict[str, Pose] = field(default_factory=dict)
    frames: dict[str, Pose] = field(default_factory=dict)
    masses: dict[str, MassProperties] = field(default_factory=dict)
    shapes: list[Shape] = field(default_factory=list)
    visual_shapes: list[Shape] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    plugins: list[ET.Element] = field(default_factory=list)
    is_static: bool = False
    has_ground: bool = False
    missing: list[str] = field(default_factory=list)
    massless: list[str] = field(default_factory=list)

    def place(self, pose: Pose) -> None:
        """Express everything in the axes of another frame, in which this model has a pose."""
        self.links = {name: pose.apply(inner) for name, inner in self.links.items()}
        self.frames = {name: pose.apply(inner) for name, inner in self.frames.items()}
        for shapes in (self.shapes, self.visual_shapes):
            shapes[:] = [shape._replace(pose=pose.apply(shape.pose)) for shape in shapes]
        for name, part in self.masses.items():
            tensor = product(product(pose.matrix, part.tensor), pose.matrix.T)
            self.masses[name] = MassProperties(part.mass, pose.point(part.centre), tensor)

    def prefix(self, name: str) -> None:
        """Put the name of this model before those of its parts, which become parts of another model."""
        self.links = {f"{name}::{key}": value for key, value in self.links.items()}
        self.frames = {f"{name}::{key}": value for key, value in self.frames.items()}
        self.masses = {f"{name}::{key}": value for key, value in self.masses.items()}
        for shapes in (self.shapes, self.visual_shapes):
            shapes[:] = [shape._replace(owner=f"{name}::{shape.owner}") for shape in shapes]
        for joint in self.joints:
            joint.name, joint.parent, joint.child = (
                f"{name}::{part}" for part in (joint.name, joint.parent, joint.child)
            )

    def adopt(self, other: "SdfModel") -> None:
        """Take over the parts of another model, which has been placed in the axes of this one."""
        for name, frame in {**other.links, **other.frames}.items():
            self.frames.setdefault(name, frame)
        self.links |= other.links
        self.masses |= other.masses
        self.shapes += other.shapes
        self.visual_shapes += other.visual_shapes
        self.joints += other.joints
        self.plugins += other.plugins
        self.has_ground = self.has_ground or other.has_ground
        self.missing += other.missing
        self.massless += other.massless


@dataclass
class SdfFile:
    """Content of a file.

    Attributes:
        name: Name of its world, or of its only model.
        models: Its models, in the axes of the file.
        is_world: Whether it is a world.
    """

    name: str
    models: list[SdfModel]
    is_world: bool


class SdfReader:
    """Reads one file with all that it includes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._count = 0

    def read(self) -> SdfFile:
        """The world or the model of the file; what a world itself has is its last model.

        Raises:
            BadInputError: It cannot be read, or is not SDF.
        """
        root = _root_of(self._path)
        worlds = root.findall("world")
        if worlds:
            world = SdfModel("world")
            models = []
            for model in self._children(worlds[0], self._path, world, 0):
                world.frames[model.name] = model.frames["__model__"]
                models.append(model)
            self._apply_state(worlds[0], models)
            models.append(SdfModel(world.name, is_static=True, has_ground=world.has_ground, missing=world.missing))
            return SdfFile(worlds[0].get("name") or self._path.stem, models, is_world=True)
        elements = root.findall("model")
        if not elements:
            raise BadInputError(f"{self._path}: holds no world and no model; allowed: an SDF file with one of them")
        models = []
        for element in elements:
            model = self._model(element, self._path, 0)
            self._place_in(model, element, element, SdfModel(""))
            models.append(model)
        return SdfFile(models[0].name, models, is_world=False)

    def _apply_state(self, world: ET.Element, models: list[SdfModel]) -> None:
        """Move models to where a world that was saved while it ran has them."""
        by_name = {model.name: model for model in models}
        for element in world.findall("state/model"):
            model = by_name.get(element.get("name", ""))
            posed = element.find("pose")
            if model is not None and posed is not None:
                model.place(_pose(posed, self._what(element)).apply(model.frames["__model__"].inverse()))

    # ---- models -----------------------------------------------------------------------------------------------------
    def _model(self, element: ET.Element, path: Path, depth: int) -> SdfModel:
        """A model in its own axes: its `pose` is applied by whoever places it."""
        self._count += 1
        if depth > _DEEPEST or self._count > _MOST_MODELS:
            raise BadInputError(
                f"{path}: models within each other; allowed: {_DEEPEST} deep, and {_MOST_MODELS:,} models"
            )
        model = SdfModel(element.get("name") or path.stem)
        model.is_static = _is_true(element.find("static"))
        model.frames["__model__"] = IDENTITY

        # Frames refer to each other by name, in any order, also to those of models inside and the other way round.
        joints = {joint.get("name", ""): joint for joint in element.findall("joint")}
        pending: dict[str, Callable[[], Pose]] = {}
        for name, joint in joints.items():
            pending[name] = self._framed(joint, model, _text(joint.find("child")) or "__model__")
        for frame in element.findall("frame"):
            pending[frame.get("name", "")] = self._framed(frame, model, frame.get("attached_to") or "__model__")
        for link in element.findall("link"):
            pending[link.get("name", "")] = self._framed(link, model, "__model__")
        _resolve_frames(model, pending)
        for child in self._children(element, path, model, depth):
            model.frames.setdefault(child.name, child.frames.pop("__model__"))
            child.prefix(child.name)
            model.adopt(child)
        missing = _resolve_frames(model, pending)
        if not set(pending) <= set(joints):  # of joints, poses count only where others refer to them
            raise BadInputError(f"{path}: model {model.name!r}: a pose is relative to {missing!r}; allowed: its frames")

        # The parts of its links, whose poses are known now.
        for link in element.findall("link"):
            self._add_link(model, link)
        for joint in element.findall("joint"):
            ends = _text(joint.find("parent")), _text(joint.find("child"))
            model.joints.append(Joint(joint.get("name", ""), _kind_of(joint), *ends))
        model.plugins += element.findall("plugin")
        return model

    def _children(self, element: ET.Element, path: Path, owner: SdfModel, depth: int) -> Iterator[SdfModel]:
        """Nested and included models, placed in the axes of the element; merged ones become parts of the owner."""
        for nested in element.findall("model"):
            model = self._model(nested, path, depth + 1)
            self._place_in(model, nested, nested, owner)
            yield model
        owner.missing += [f"{part.get('name')} (population)" for part in element.findall("population")]
        for include in element.findall("include"):
            uri = _text(include.find("uri"))
            file = _included_file(uri, path)
            if file is None:
                owner.has_ground = owner.has_ground or _GROUND.search(uri) is not None
                if not _SUN.search(uri) and not _GROUND.search(uri):
                    name = _text(include.find("name")) or uri.rstrip("/").rpartition("/")[2]
                    owner.missing.append(f"{name} (not on this machine)")
                continue
            source = _root_of(file).find("model")
            if source is None:
                continue  # a light or an actor
            model = self._model(source, file, depth + 1)
            model.name = _text(include.find("name")) or model.name
            model.is_static = model.is_static or _is_true(include.find("static"))
            model.plugins += include.findall("plugin")
            posed = source
            if include.find("pose") is not None:
                posed = include
            self._place_in(model, posed, include, owner)
            if _is_true_text(include.get("merge", "")):
                model.frames.pop("__model__", None)
                owner.adopt(model)
            else:
                yield model

    def _place_in(self, model: SdfModel, posed: ET.Element, placed: ET.Element, owner: SdfModel) -> None:
        """Apply the pose of a model, of the frame `placement_frame` if it names one."""
        element = posed.find("pose")
        pose = _pose(element, self._what(posed))
        if element is None:
            base = ""
        else:
            base = element.get("relative_to", "")
        if base and base not in ("world", "__model__"):
            if base not in owner.frames:
                raise BadInputError(
                    f"{self._what(posed)}: relative to {base!r}; allowed: a frame that stands before it"
                )
            pose = owner.frames[base].apply(pose)
        frame = _text(placed.find("placement_frame")) or placed.get("placement_frame", "")
        if frame:
            if frame not in model.frames:
                raise BadInputError(f"{self._what(placed)}: placement_frame {frame!r}: no frame of {model.name}")
            pose = pose.apply(model.frames[frame].inverse())
        model.frames.setdefault("__model__", IDENTITY)
        model.place(pose)

    # ---- parts ------------------------------------------------------------------------------------------------------
    def _framed(self, element: ET.Element, model: SdfModel, default: str) -> Callable[[], Pose]:
        """The pose of an element, to be found when the frame is known to which it is relative."""
        posed = element.find("pose")
        base = default
        if posed is not None and posed.get("relative_to"):
            base = posed.get("relative_to", "")
        pose = _pose(posed, self._what(element))

        def resolve() -> Pose:
            if base not in model.frames:
                raise _PendingError(base)
            return model.frames[base].apply(pose)

        return resolve

    def _add_link(self, model: SdfModel, link: ET.Element) -> None:
        """Mass properties and shapes of a link."""
        name = link.get("name", "")
        frame = model.frames[name]
        model.links[name] = frame
        what = f"{self._path}: link {name!r}"
        inertial = link.find("inertial")
        if inertial is None:
            model.massless.append(name)
        if inertial is None:
            mass = None
        else:
            mass = number(inertial.find("mass"), f"{what}: mass")
        if inertial is not None and mass:
            placed = frame.apply(_pose(inertial.find("pose"), what))
            tensor = _tensor(inertial.find("inertia"), what)
            turned = product(product(placed.matrix, tensor), placed.matrix.T)
            model.masses[name] = MassProperties(mass, placed.position, turned)
        contacts = _shapes_of(link, "collision", model, what)
        model.shapes += contacts
        if not contacts:
            model.visual_shapes += _shapes_of(link, "visual", model, what)

    def _what(self, element: ET.Element) -> str:
        return f"{self._path}: {element.tag} {element.get('name', '')!r}"


class _PendingError(Exception):
    """A frame is not known yet."""


def _resolve_frames(model: SdfModel, pending: dict[str, Callable[[], Pose]]) -> str:
    """Resolve poses, which leave `pending`, until no frame is known that the others need; returns the name of one."""
    missing = ""
    while pending:
        resolved = {}
        for name, resolve in pending.items():
            try:
                resolved[name] = resolve()
            except _PendingError as error:
                missing = str(error)
        if not resolved:
            break
        model.frames |= resolved
        for name in resolved:
            del pending[name]
    return missing


def _kind_of(joint: ET.Element) -> str:
    """The kind of a joint; one whose limits are equal is fixed, as old versions of the format wrote it."""
    lower = joint.findtext("axis/limit/lower")
    upper = joint.findtext("axis/limit/upper")
    if lower is not None and lower == upper:
        return "fixed"
    return joint.get("type", "")


def _root_of(path: Path) -> ET.Element:
    """Root of an SDF file; a template of PX4 is filled with nothing."""
    if path.name.endswith(_TEMPLATE):
        root = _filled(path)
    else:
        root = read_xml(path)
    if root.tag == "gazebo":  # its name until version 1.2
        return root
    if root.tag != "sdf":
        raise BadInputError(f"{path}: an XML file of <{root.tag}>; allowed: <sdf>")
    return root


def _filled(path: Path) -> ET.Element:
    """Root of a template, without values for its variables."""
    import jinja2
    from jinja2.sandbox import SandboxedEnvironment  # slow to import

    if not is_file(path):
        raise BadInputError(f"{path}: there is no such file")
    text = read_file(path, LARGEST_TEXT).decode(errors="replace")
    try:
        filled = SandboxedEnvironment(autoescape=False).from_string(text).render()
    except (jinja2.TemplateError, ArithmeticError, TypeError, ValueError) as error:
        raise BadInputError(
            f"{path}: the template cannot be filled ({' '.join(str(error).split())}); allowed: the file that PX4's "
            "jinja_gen.py makes of it"
        ) from None
    return parse_xml(filled, path)


def _included_file(uri: str, path: Path) -> Path | None:
    """The file of a model that a file includes; None = it is not on this machine."""
    target = find_file(uri, path)
    if target is None:
        return None
    return _sdf_in(target)


def _sdf_in(target: Path) -> Path | None:
    """The SDF file of a model's folder, as its `model.config` says; or the file itself."""
    if not is_dir(target):
        return target
    config = target / "model.config"
    names = ["model.sdf", f"{target.name}.sdf"]
    if is_file(config):
        listed = [_text(element) for element in read_xml(config).findall("sdf")]
        names = [*reversed(listed), *names]  # the newest version comes last
    for name in names:
        for file in (target / name, target / f"{name}{_TEMPLATE}"):
            if is_file(file):
                return file
    return None


def _text(element: ET.Element | None) -> str:
    if element is None:
        return ""
    return (element.text or "").strip()


def _is_true_text(text: str) -> bool:
    return text.strip().lower() in ("1", "true")


def _is_true(element: ET.Element | None) -> bool:
    return _is_true_text(_text(element))


def _pose(element: ET.Element | None, what: str) -> Pose:
    """The pose of an element, relative to whatever frame; absent = identity."""
    text = _text(element)
    if element is None or not text:
        return IDENTITY
    if element.get("rotation_format") == "quat_xyzw":
        x, y, z, qx, qy, qz, qw = numbers(text, 7, f"{what}: pose")
        norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        if not norm > 0.0:
            raise BadInputError(f"{what}: pose {text!r}: a quaternion of zero; allowed: a unit quaternion")
        matrix = np.empty((3, 3))
        rotation_matrix(np.array([qw, qx, qy, qz]) / norm, matrix)
        return Pose(matrix, np.array([x, y, z]))
    values = numbers(text, 6, f"{what}: pose")
    if _is_true_text(element.get("degrees", "")):
        values = (*values[:3], *(math.radians(angle) for angle in values[3:]))
    return pose_of(values)


def _tensor(element: ET.Element | None, what: str) -> np.ndarray:
    """Inertia of a link about its centre of mass (kg m^2). Shape (3, 3)."""
    tensor = np.zeros((3, 3))
    if element is None:
        return tensor
    for row, first in enumerate("xyz"):
        for column, second in enumerate("xyz"):
            low, high = sorted((first, second))
            tensor[row, column] = number(element.find(f"i{low}{high}"), f"{what}: i{low}{high}") or 0.0
    return tensor


def _shapes_of(link: ET.Element, tag: str, model: SdfModel, what: str) -> list[Shape]:
    """Shapes of a link for contacts (`collision`) or to look at (`visual`), in the axes of its model."""
    owner = link.get("name", "")
    frame = model.links[owner]
    shapes = []
    for element in link.findall(tag):
        posed = element.find("pose")
        base = frame
        if posed is not None and posed.get("relative_to"):
            base = model.frames.get(posed.get("relative_to", ""), frame)
        shape = _shape(element.find("geometry"), base.apply(_pose(posed, what)), owner, what)
        if shape is not None:
            shapes.append(shape)
    return shapes


def _shape(geometry: ET.Element | None, pose: Pose, owner: str, what: str) -> Shape | None:
    """A shape; None = an empty element."""
    if geometry is None or not len(geometry):
        return None
    element = geometry[0]

    def value(name: str) -> float:
        length = number(element.find(name), f"{what}: {name}")
        if length is None:
            raise BadInputError(f"{what}: {element.tag} without {name}")
        return length

    if element.tag == "box":
        return Shape(BOX, numbers(_text(element.find("size")), 3, f"{what}: size"), pose, owner)
    if element.tag in (CYLINDER, CAPSULE):
        return Shape(element.tag, (value("radius"), value("length")), pose, owner)
    if element.tag == "sphere":
        return Shape(SPHERE, (value("radius"),), pose, owner)
    if element.tag == "ellipsoid":
        return Shape(ELLIPSOID, numbers(_text(element.find("radii")), 3, f"{what}: radii"), pose, owner)
    if element.tag == "plane":
        normal = np.array(numbers(_text(element.find("normal")) or "0 0 1", 3, f"{what}: normal"))
        return Shape(PLANE, (), Pose(product(pose.matrix, _upright(normal)), pose.position), owner)
    return Shape(MESH, (), pose, f"{owner} ({element.tag})")


def _upright(normal: np.ndarray) -> np.ndarray:
    """A rotation of the z axis to a direction. Shape (3, 3)."""
    norm = math.sqrt(float(np.square(normal).sum()))
    if not norm > 0.0:
        return np.eye(3)
    x, y, z = (normal / norm).tolist()
    return matrix_of_rpy(0.0, math.acos(min(1.0, max(-1.0, z))), math.atan2(y, x))
