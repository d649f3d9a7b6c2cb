"""Readers of vehicles: SDF, URDF and xacro with motor plug-ins of Gazebo or properties of Crazyflies, and MJCF."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.models.geometry import MassProperties, Pose, lump
from mavfi.extras.models.quadrotor import MultirotorData, OppositeSpinsError, Rotor, rounded_up, vehicle_from
from mavfi.extras.models.sdf import SdfFile, SdfModel, SdfReader
from mavfi.extras.models.urdf import UrdfRobot, read_urdf, read_xacro
from mavfi.extras.models.xml_files import PATH_VARIABLES, number, numbers, read_xml
from mavfi.numerics.vectors import length
from mavfi.sim.engine import GRAVITY
from mavfi.sim.imported import ImportedVehicle
from mavfi.sim.mjcf import measure, site_motors

_ROTOR_NAME = re.compile(r"(rotor|prop|motor)", re.IGNORECASE)
"""Links of rotors, where no plug-in names them."""
_PER_MINUTE = 0.10471975511965977
"""rad/s in one revolution per minute."""
XACRO_KEY = "xacro"
"""Key of a vehicle's YAML file with arguments of its xacro file."""


def sdf_vehicle(path: Path, chosen: Mapping[str, Any]) -> ImportedVehicle:
    """See `mavfi.sim.imported.VehicleReader`; a world must hold one multirotor."""
    model = _only_multirotor(SdfReader(path).read(), path)
    if model.missing:
        raise BadInputError(
            f"{path}: includes {', '.join(model.missing)}; allowed: models beside the file, or in a folder of "
            f"{PATH_VARIABLES[0]}"
        )
    model.place(model.frames["__model__"].inverse())  # where it stands in its file does not matter
    data = MultirotorData(model.name, shapes=model.shapes)
    if model.massless:
        data.remarks.append(f"links without <inertial>, 1 kg in Gazebo, have no mass: {', '.join(model.massless)}")
    data.body = lump(model.masses.values())
    data.body_note = f"all links with mass ({len(model.masses)}) as one rigid body"
    children = {joint.name: joint.child for joint in model.joints}
    data.rotors = _rotors_of(model.plugins, children, model.links, path)
    data.rotor_note = "motor plug-ins"
    if not data.rotors:
        turning = {joint.name: joint.child for joint in model.joints if joint.kind in ("revolute", "continuous")}
        data.rotors = _named_rotors(turning, model.links)
    rotor_links = {children.get(_of(plugin, "jointName"), _of(plugin, "linkName")) for plugin in model.plugins}
    held = [
        joint.name
        for joint in model.joints
        if joint.kind not in ("fixed", "") and joint.child not in rotor_links and not _ROTOR_NAME.search(joint.child)
    ]
    if held:
        data.remarks.append(f"joints held as they stand: {', '.join(held)}")
    return vehicle_from(data, str(path), chosen)


def _only_multirotor(file: SdfFile, path: Path) -> SdfModel:
    """The model of a file that is a vehicle."""
    if not file.is_world and len(file.models) == 1:
        return file.models[0]
    flying = [model for model in file.models if is_multirotor(model)]
    if len(flying) != 1:
        names = ", ".join(model.name for model in flying) or "none"
        raise BadInputError(f"{path}: models with motor plug-ins: {names}; allowed: one")
    return flying[0]


def is_multirotor(model: SdfModel) -> bool:
    """Whether a model has plug-ins of motors."""
    return any(_is_motor(plugin) for plugin in model.plugins)


def urdf_vehicle(path: Path, chosen: Mapping[str, Any]) -> ImportedVehicle:
    """See `mavfi.sim.imported.VehicleReader`."""
    return _of_robot(read_urdf(path), path, chosen)


def xacro_vehicle(path: Path, chosen: Mapping[str, Any]) -> ImportedVehicle:
    """See `mavfi.sim.imported.VehicleReader`; the key `xacro` has the arguments of the file."""
    arguments = chosen.get(XACRO_KEY, {})
    if not isinstance(arguments, dict):
        raise BadInputError(f"{path}: key {XACRO_KEY!r}: {arguments!r}: allowed: arguments of the file with values")
    others = {key: value for key, value in chosen.items() if key != XACRO_KEY}
    return _of_robot(read_xacro(path, arguments), path, others)


def _of_robot(robot: UrdfRobot, path: Path, chosen: Mapping[str, Any]) -> ImportedVehicle:
    data = MultirotorData(robot.name, shapes=robot.shapes)
    data.body = lump(robot.masses.values())
    data.body_note = f"all links with mass ({len(robot.masses)}) as one rigid body"
    data.rotors = _rotors_of(robot.plugins, robot.moving, robot.links, path)
    data.rotor_note = "motor plug-ins"
    properties = robot.root.find("properties")
    if not data.rotors and properties is not None:
        _take_properties(data, robot, properties, path)
    if not data.rotors:
        data.rotors = _named_rotors(robot.moving, robot.links)
    rotor_links = {rotor.name for rotor in data.rotors}
    held = [name for name, child in robot.moving.items() if child not in rotor_links]
    if held:
        data.remarks.append(f"joints held as they stand: {', '.join(held)}")
    return vehicle_from(data, str(path), chosen)


# ---- MJCF ------------------------------------------------------------------------------------------------------------


def mjcf_vehicle(path: Path, chosen: Mapping[str, Any]) -> ImportedVehicle:
    """A vehicle from an MJCF model whose rotors are motors at sites; see `mavfi.sim.imported.VehicleReader`."""
    if read_xml(path).tag == "sdf":
        return sdf_vehicle(path, chosen)
    body = measure(path)
    data = MultirotorData(path.stem)
    # the motors' positions are from the centre of mass
    data.body = MassProperties(body.mass, np.zeros(3), np.diag(body.inertia))
    data.body_note = "its free body"
    if body.reach > 0.0:
        data.values["collision_radius"] = rounded_up(body.reach)
        data.notes["collision_radius"] = "reach of its geoms from the centre of mass"
    motors = site_motors(path)
    data.rotor_note = "motors at sites"
    for motor in motors:
        # the torque on the body is opposite to the turning of the rotor
        spin = int(motor.torque_ratio < 0.0) - int(motor.torque_ratio > 0.0)
        x, y, z = motor.axis.tolist()
        data.rotors.append(
            Rotor(motor.name, motor.position, spin, (x, y, z), motor.max_thrust, motor.torque_ratio or None)
        )
    if len(motors) == 1 and motors[0].max_thrust is not None:  # one motor for all rotors
        data.rotors = []
        data.values["max_rotor_thrust"] = 0.25 * motors[0].max_thrust
        data.notes["max_rotor_thrust"] = f"a quarter of motor {motors[0].name}"
    try:
        return vehicle_from(data, str(path), chosen)
    except OppositeSpinsError:
        data.rotors = [rotor._replace(spin=0) for rotor in data.rotors]
        data.remarks = ["its neighbouring rotors turn the same way; flown with opposite ones"]
        return vehicle_from(data, str(path), chosen)


# ---- motor plug-ins of RotorS, PX4 and Gazebo ------------------------------------------------------------------------


def _is_motor(plugin: ET.Element) -> bool:
    return plugin.find("motorConstant") is not None


def _of(plugin: ET.Element, name: str) -> str:
    return (plugin.findtext(name) or "").strip()


def _rotors_of(
    plugins: Iterable[ET.Element], children: Mapping[str, str], links: Mapping[str, Pose], path: Path
) -> list[Rotor]:
    """Rotors from plug-ins, each with the name of its link; those of the same motor twice count once."""
    rotors: dict[str, Rotor] = {}
    for plugin in filter(_is_motor, plugins):
        joint = _of(plugin, "jointName")
        link = children.get(joint) or _of(plugin, "linkName")
        what = f"{path}: motor plug-in of {joint or link!r}"
        pose = _pose_of_link(link, links)
        if pose is None:
            raise BadInputError(f"{what}: link {link!r} is not in the model; allowed: {', '.join(links)}")
        if _of(plugin, "motorType") not in ("", "velocity"):
            raise BadInputError(f"{what}: motorType {_of(plugin, 'motorType')!r}; allowed: velocity")
        constant = number(plugin.find("motorConstant"), f"{what}: motorConstant")
        speed = number(plugin.find("maxRotVelocity"), f"{what}: maxRotVelocity")
        if constant is not None and not constant > 0.0:
            raise BadInputError(f"{what}: motorConstant {constant:g}: allowed: above 0")
        up = number(plugin.find("timeConstantUp"), f"{what}: timeConstantUp")
        down = number(plugin.find("timeConstantDown"), f"{what}: timeConstantDown")
        lag = None
        if up is not None and down is None:
            lag = (up, up)
        elif up is not None and down is not None:
            lag = (up, down)
        thrust = None
        if constant is not None and speed is not None:
            thrust = constant * speed * speed
        x, y, z = pose.matrix[:, 2].tolist()
        rotors[link] = Rotor(
            name=link,
            position=pose.position,
            spin={"ccw": 1, "cw": -1}.get(_of(plugin, "turningDirection").lower(), 0),
            axis=(x, y, z),
            max_thrust=thrust,
            torque_ratio=number(plugin.find("momentConstant"), f"{what}: momentConstant"),
            lag=lag,
            speed_constant=constant,
            drag=number(plugin.find("rotorDragCoefficient"), f"{what}: rotorDragCoefficient"),
        )
    return list(rotors.values())


def _pose_of_link(name: str, links: Mapping[str, Pose]) -> Pose | None:
    """Pose of a link, also if the name leaves out the model inside the model that it belongs to."""
    if name in links:
        return links[name]
    for full, pose in links.items():
        if full.endswith(f"::{name}"):
            return pose
    return None


def _named_rotors(turning: Mapping[str, str], links: Mapping[str, Pose]) -> list[Rotor]:
    """Rotors of a model without motor plug-ins: links that turn, and are named so."""
    rotors = []
    for joint, link in turning.items():
        pose = _pose_of_link(link, links)
        if pose is not None and (_ROTOR_NAME.search(link) or _ROTOR_NAME.search(joint)):
            rotors.append(Rotor(link, pose.position))
    return rotors


# ---- properties of gym-pybullet-drones -------------------------------------------------------------------------------


def _take_properties(data: MultirotorData, robot: UrdfRobot, properties: ET.Element, path: Path) -> None:
    """<properties arm kf km thrust2weight ...>: thrust = kf x speed^2, torque = km x speed^2, speed in rev/min."""
    data.rotor_note = "<properties>"

    def value(name: str) -> float | None:
        text = properties.get(name)
        if text is None:
            return None
        return numbers(text, 1, f"{path}: properties: {name}")[0]

    # positions are those of the propellers' masses, which the simulation uses
    centres = {name: centre for name, centre in robot.centres.items() if _ROTOR_NAME.search(name)}
    middle: Any = 0.0
    if centres:
        middle = sum(centres.values()) / len(centres)
    if centres and max(length(centre - middle) for centre in centres.values()) > 0.0:
        data.rotors = [Rotor(name, centre) for name, centre in centres.items()]
    elif value("arm") is not None:
        data.values["arm_length"] = value("arm")
        data.notes["arm_length"] = "<properties>: arm"

    # Rotors: torque / thrust, and the largest thrust, a quarter of the vehicle's.
    kf = value("kf")
    km = value("km")
    lift = value("thrust2weight")
    if kf and km:
        data.values["rotor_torque_ratio"] = float(f"{km / kf:.6g}")
        data.notes["rotor_torque_ratio"] = "<properties>: km / kf"
    if lift and data.body is not None:
        data.values["max_rotor_thrust"] = float(f"{0.25 * lift * data.body.mass * GRAVITY:.6g}")
        data.notes["max_rotor_thrust"] = f"<properties>: thrust2weight {lift:g}"

    # The collision sphere reaches to the tips of the propellers.
    if value("prop_radius") and data.rotors and data.body is not None:
        centre = data.body.centre
        reach = max(length(rotor.position - centre) for rotor in data.rotors) + (value("prop_radius") or 0.0)
        data.values["collision_radius"] = float(f"{reach:.4g}")
        data.notes["collision_radius"] = "tips of the propellers: <properties>: prop_radius"

    # Drag, linear in the vehicle's speed.
    sideways = value("drag_coeff_xy")
    vertical = value("drag_coeff_z")
    if sideways is not None and kf and data.body is not None:
        # force = coefficient x sum of rotor speeds (rad/s) x speed of the vehicle, at hover
        speed = (data.body.mass * GRAVITY / 4.0 / kf) ** 0.5 * _PER_MINUTE
        data.linear_drag = (4.0 * sideways * speed, 4.0 * sideways * speed, 4.0 * (vertical or 0.0) * speed)
        data.linear_drag_note = "<properties>: drag_coeff_xy, drag_coeff_z, rotors at hover"
