"""A user's own vehicle: a YAML file that refers to an MJCF body, which defines mass, inertia and appearance."""

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mavfi.config import VehicleConfig, parse, read_yaml, shipped
from mavfi.errors import BadInputError
from mavfi.files import LARGEST_TEXT, check_regular, exists, is_file, read_file
from mavfi.numerics.vectors import length, product
from mavfi.sim.engine import GRAVITY, keep_quiet
from mavfi.sim.imported import VEHICLE_FILES, extensions_of, import_vehicle, vehicle_file

ROTORS = 4
_TOLERANCE = 0.01
"""Relative tolerance between mass or inertia in the YAML file and in the model, for rounding."""
_MOST_COPIES = 10_000
_COUNT, _FILE = (re.compile(rb"""\b%s\s*=\s*["']([^"']*)["']""" % word) for word in (b"count", b"file"))
_OPTIONS = [name for name in dir(mujoco.MjOption) if not name.startswith("_")]


@dataclass(frozen=True, slots=True)
class RigidBody:
    """Mass properties of a model.

    Attributes:
        mass: Mass (kg).
        inertia: About the centre of mass, diagonal in the axes of its free body (kg m^2).
        centre: Centre of mass in these axes, from the body's origin (m). Shape (3,).
        reach: Radius around the centre of mass that encloses all geoms (m).
    """

    mass: float
    inertia: tuple[float, float, float]
    centre: np.ndarray
    reach: float


def find_vehicle(name: str) -> VehicleConfig:
    """A shipped vehicle by name, a user's YAML file, or a model in a format that an extra reads.

    If the file has the key `mjcf`, a path relative to the file, mass and inertia are those of that model; if the file
    specifies them as well, they must agree within 1 %.  With the key `model`, also relative, the other keys of the
    vehicle are those of that model, unless the file has them.

    Raises:
        BadInputError: Unknown vehicle, invalid file, key or model, or its rotors cannot lift it.
    """
    if not name.endswith((".yaml", ".yml")):
        file = vehicle_file(name)
        if file is None:
            return shipped("vehicles", VehicleConfig, name, extensions_of(VEHICLE_FILES))
        return _lifted(name, parse(VehicleConfig, import_vehicle(file, {}), name))
    data = read_yaml(Path(name))
    model = data.pop("model", None)
    if model is not None:
        if not isinstance(model, str):
            raise BadInputError(f"{name}: key 'model': {model!r}: allowed: a file of a model")
        data = import_vehicle(Path(name).parent / model, data)
    if not isinstance(data.get("mjcf"), str):
        return _lifted(name, parse(VehicleConfig, data, name))
    path = Path(name).parent / data["mjcf"]
    try:
        body = measure(path)
    except BadInputError as error:
        raise BadInputError(f"{name}: key 'mjcf': {error}") from None
    vehicle = parse(VehicleConfig, {"mass": body.mass, "inertia": body.inertia} | data | {"mjcf": str(path)}, name)
    _check(name, vehicle, body)
    return _lifted(name, vehicle.model_copy(update={"mass": body.mass, "inertia": body.inertia}))


def _lifted(source: str, vehicle: VehicleConfig) -> VehicleConfig:
    """The vehicle, after checking that its rotors can lift it."""
    least = vehicle.mass * GRAVITY / ROTORS
    if not vehicle.max_rotor_thrust > least:
        raise BadInputError(
            f"{source}: key 'max_rotor_thrust': {vehicle.max_rotor_thrust:g} N: {ROTORS} such rotors do not lift "
            f"{vehicle.mass:g} kg; allowed: more than {least:.4g} N"
        )
    return vehicle


def _check(source: str, vehicle: VehicleConfig, body: RigidBody) -> None:
    ours, theirs = (vehicle.mass, *vehicle.inertia), (body.mass, *body.inertia)
    for key, chosen, modelled in zip(("mass", *["inertia"] * 3), ours, theirs, strict=True):
        if not abs(chosen - modelled) <= _TOLERANCE * modelled:
            raise BadInputError(
                f"{source}: key {key!r}: {chosen:g}: the model {vehicle.mjcf} has {modelled:.4g}; allowed: within "
                f"{100 * _TOLERANCE:g} % of it, or no such key"
            )
    if not vehicle.collision_radius >= body.reach:
        raise BadInputError(
            f"{source}: key 'collision_radius': {vehicle.collision_radius:g}: the model {vehicle.mjcf} reaches "
            f"{body.reach:.3f} m from its centre of mass; allowed: at least that"
        )


def measure(path: Path) -> RigidBody:
    """Mass, inertia, centre of mass and reach of a model's single free body with all bodies fixed to it.

    Args:
        path: MJCF file.

    Raises:
        BadInputError: It cannot be read, or is not a single rigid free body.
    """
    spec = _read(path)
    free = _free_body(spec, path)
    model, data = _compile(spec, path)
    # the free body, and the bodies fixed to it, which have higher numbers
    root = _number_of(free, model)
    tree = model.body_rootid[root]
    parts = [body for body in range(root, model.nbody) if model.body_rootid[body] == tree]

    # all in the axes of the free body
    centre = data.subtree_com[root]
    axes = data.xmat[root].reshape(3, 3)
    tensor = product(product(axes.T, _inertia_about(centre, model, data, parts)), axes)
    x, y, z = (float(value) for value in np.diag(tensor))
    offset = product(axes.T, (centre - data.xpos[root])[:, None])[:, 0]
    return RigidBody(float(model.body_subtreemass[root]), (x, y, z), offset, _reach(centre, model, data, parts))


def _number_of(free: Any, model: Any) -> int:
    """Number of the free body in the compiled model."""
    if free.name:
        return int(model.body(free.name).id)
    return next(body for body in range(model.nbody) if model.body_dofnum[body])


def _inertia_about(centre: np.ndarray, model: Any, data: Any, parts: list[int]) -> np.ndarray:
    """Inertia of bodies about a point, world axes (kg m^2), by the parallel-axis theorem. Shape (3, 3)."""
    tensor = np.zeros((3, 3))
    for body in parts:
        principal = data.ximat[body].reshape(3, 3)
        arm = data.xipos[body] - centre
        tensor += product(principal * model.body_inertia[body], principal.T)
        tensor += model.body_mass[body] * (length(arm) * length(arm) * np.eye(3) - np.outer(arm, arm))
    return tensor


def _reach(centre: np.ndarray, model: Any, data: Any, parts: list[int]) -> float:
    """Largest distance of the bodies' geometry from a point (m); 0 = no geometry.

    Of meshes and boxes it is that of their vertices, of other shapes that of their bounding spheres.
    """
    reach = 0.0
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] not in parts:
            continue
        vertices = _vertices(geom, model)
        if vertices is None:
            reach = max(reach, length(data.geom_xpos[geom] - centre) + float(model.geom_rbound[geom]))
        else:
            world = product(vertices, data.geom_xmat[geom].reshape(3, 3).T) + data.geom_xpos[geom]
            reach = max(reach, float(np.sqrt(np.square(world - centre).sum(axis=1)).max()))
    return reach


def _vertices(geom: int, model: Any) -> np.ndarray | None:
    """Vertices of a mesh or a box in the axes of its geom (m), shape (n, 3); None = another shape."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices: np.ndarray = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
        return vertices
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        signs = 2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0
        corners: np.ndarray = signs * model.geom_size[geom]
        return corners
    return None


def attach(vehicle: VehicleConfig, scene: Any, holder: Any) -> None:
    """Attach a vehicle's model to the flying body, with its centre of mass at that body's origin.

    Its geoms are visual: only the sphere collides.  Its actuators, sensors, key frames and options are ignored;
    rotors, drag and controller are those of the YAML file.

    Args:
        vehicle: A vehicle with `mjcf`.
        scene: Model under construction (MjSpec).
        holder: Body without mass of its own (MjsBody).

    Raises:
        BadInputError: The file has changed since the vehicle was read.
    """
    path = Path(str(vehicle.mjcf))
    body = measure(path)
    if (body.mass, body.inertia) != (vehicle.mass, vehicle.inertia):
        raise BadInputError(
            f"{path}: weighs {body.mass:g} kg and not {vehicle.mass:g} kg as before; allowed: no change"
        )
    spec = _read(path)
    free = _free_body(spec, path)
    for elements in (spec.actuators, spec.sensors, spec.keys):
        for element in list(elements):
            spec.delete(element)
    spec.delete(free.joints[0])
    free.pos, free.quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    free.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for name in _OPTIONS:  # MuJoCo warns if they differ, and keeps the scene's
        setattr(spec.option, name, getattr(scene.option, name))
    holder.add_frame(pos=-body.centre).attach_body(free, "model/", "")


def _read(path: Path) -> Any:
    if not is_file(path):
        raise BadInputError(f"{path}: there is no such file")
    if _copies(path, set()) > _MOST_COPIES:
        raise BadInputError(f"{path}: attributes 'count' ask for too many copies; allowed: {_MOST_COPIES:,} in all")
    keep_quiet()
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError, RuntimeError) as error:
        raise BadInputError(f"{path}: not an MJCF file ({_line(error)})") from None


def _copies(path: Path, seen: set[Path]) -> float:
    """Product of all counts in a model and its includes; all referenced files must be regular."""
    seen.add(path)
    content = read_file(path, LARGEST_TEXT)
    product_of_counts = 1.0
    for text in _COUNT.findall(content):
        for word in text.split():
            product_of_counts *= float(word) if word.isdigit() else math.inf
    for name in _FILE.findall(content):
        named = path.parent / os.fsdecode(name)
        if name and named not in seen and exists(named):
            check_regular(named)
            product_of_counts *= _copies(named, seen) if named.suffix == ".xml" else 1.0
    return product_of_counts


def _free_body(spec: Any, path: Path) -> Any:
    """The body with a free joint; other joints are rejected."""
    free = [joint.parent for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        names = f" ({', '.join(body.name or 'without a name' for body in free)})" if free else ""
        raise BadInputError(f"{path}: {len(free)} bodies with a free joint{names}; allowed: 1")
    others = [joint.name or "without a name" for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    if others:
        raise BadInputError(f"{path}: joint {others[0]}: allowed: no joint but the free one, the vehicle is rigid")
    return free[0]


def _compile(spec: Any, path: Path) -> tuple[Any, Any]:
    """The compiled model, and its data in the initial position."""
    try:
        model = spec.compile()
    except (ValueError, RuntimeError) as error:
        reason = _line(error)
        allowed = "; allowed: a mass and an inertia above 0" if "mass and inertia" in reason else ""
        raise BadInputError(f"{path}: cannot be compiled ({reason}){allowed}") from None
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


# ---- rotors and scenes of other models -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class SiteMotor:
    """An actuator that pushes along an axis of a site.

    Attributes:
        name: Its name.
        position: Of the site, in the axes of the free body, from its centre of mass (m). Shape (3,).
        axis: Direction of the force, same axes. Shape (3,).
        max_thrust: Largest force (N); None = unlimited.
        torque_ratio: Torque about the axis / force (m).
    """

    name: str
    position: np.ndarray
    axis: np.ndarray
    max_thrust: float | None
    torque_ratio: float


def site_motors(path: Path) -> list[SiteMotor]:
    """Actuators of a vehicle's MJCF file that push at sites, e.g. its rotors.

    Raises:
        BadInputError: See `measure`.
    """
    spec = _read(path)
    free = _free_body(spec, path)
    model, data = _compile(spec, path)
    root = _number_of(free, model)
    body_axes = data.xmat[root].reshape(3, 3)
    motors = []
    for actuator in range(model.nu):
        # Force and torque per unit of control, in the frame of the actuator's site.
        force = model.actuator_gear[actuator, :3]
        torque = model.actuator_gear[actuator, 3:]
        strength = length(force)
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_SITE or not strength > 0.0:
            continue
        # Axis and position in the frame of the body, from its centre of mass.
        site = model.actuator_trnid[actuator, 0]
        axis = product(data.site_xmat[site].reshape(3, 3), (force / strength)[:, None])
        offset = data.site_xpos[site] - data.subtree_com[root]
        limit = None
        if model.actuator_ctrllimited[actuator]:
            limit = float(model.actuator_gainprm[actuator, 0] * strength * model.actuator_ctrlrange[actuator, 1])
        motors.append(
            SiteMotor(
                model.actuator(actuator).name,
                product(body_axes.T, offset[:, None])[:, 0],
                product(body_axes.T, axis)[:, 0],
                limit,
                float((force * torque).sum()) / strength**2,
            )
        )
    return motors


@dataclass(frozen=True, slots=True, eq=False)
class StaticGeom:
    """A geom of a scene that stands still.

    Attributes:
        name: Its name, or that of its body, for messages.
        body: Number of its body; 0 = the world itself.
        collides: Whether others touch it.
        kind: Name of its type in lower case: plane, box, sphere, capsule, ellipsoid, cylinder, mesh, hfield, sdf.
        size: As in MJCF: half edges, radius and half length (m). Shape (3,).
        matrix: To world. Shape (3, 3).
        position: Of its centre (m). Shape (3,).
        vertices: Of a mesh or a box, in the axes of the geom (m), shape (n, 3); None = another shape.
    """

    name: str
    body: int
    collides: bool
    kind: str
    size: np.ndarray
    matrix: np.ndarray
    position: np.ndarray
    vertices: np.ndarray | None


def static_geoms(path: Path) -> list[StaticGeom]:
    """Geoms of an MJCF file that no joint moves.

    Raises:
        BadInputError: It cannot be read or compiled.
    """
    model, data = _compile(_read(path), path)
    geoms = []
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        if model.body_weldid[body] != 0:
            continue
        name = model.geom(geom).name or model.body(body).name
        geoms.append(
            StaticGeom(
                name,
                int(body),
                bool(model.geom_contype[geom] or model.geom_conaffinity[geom]),
                mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower(),
                model.geom_size[geom].copy(),
                data.geom_xmat[geom].reshape(3, 3).copy(),
                data.geom_xpos[geom].copy(),
                _vertices(geom, model),
            )
        )
    return geoms
