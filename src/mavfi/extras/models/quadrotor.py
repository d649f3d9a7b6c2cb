"""From what a file says of a multirotor to our vehicle: four equal rotors at the ends of an X."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from mavfi.config import VehicleConfig
from mavfi.errors import BadInputError
from mavfi.extras.models.geometry import MESH, MassProperties, Shape, matrix_of_rpy, reach_of
from mavfi.numerics.vectors import length, product
from mavfi.sim.engine import GRAVITY
from mavfi.sim.imported import ImportedVehicle

_ROTORS = 4
_MAX_TURN = math.radians(20.0)
"""Largest angle between a rotor's arm and that of an X (rad); PX4's Iris has 14 degrees."""
_MAX_SPREAD = 0.25
"""Largest difference of an arm from the mean arm, and of the rotors' centre from the centre of mass, in mean arms."""
_MAX_TILT = math.radians(10.0)
_SPREAD_THRUST = 0.05
_DRAG_SPEED = 3.0
"""Speed at which drag that is linear in it in the file has the same force as ours, which is quadratic (m/s)."""
_RADIUS_PER_ARM = 1.5
_TORQUE_RATIO = 0.016
"""Torque / thrust of RotorS' and PX4's Gazebo models (m)."""
_LAG = 0.02
_BANDWIDTH_LAG = 0.45
"""Largest rate gain x rotor lag: the rate loop is then damped by 0.75."""
_MOST_LIFT = 8.0
"""Largest thrust / weight: the mixer keeps a tenth of a rotor's range free, below which it cannot hover."""
_DIRECTIONS = {1: "ccw", -1: "cw"}
_AMBIGUOUS = math.radians(22.5)
"""An X turned by more than this (rad) is as well one that is turned to the other side."""
_MOST_EXCESS = 0.5
"""Largest excess of an inertia over the sum of the other two that is cut, relative to that sum."""
_SMALL_ANGLE = math.radians(1.0)
_MOST_LENGTH = 1e6
"""Lengths that are not rounded (m); they are refused later."""
_SMALL_SHARE = 0.01
"""Differences below these are not worth a remark."""
_OFF_DIAGONAL = 0.05
"""Product of inertia, relative to the least moment, from which on it is worth one."""
_NEEDED = {
    "mass": "mass (kg)",
    "inertia": "inertia (kg m^2, three values)",
    "arm_length": "distance from the centre to a rotor's axis (m)",
    "max_rotor_thrust": "largest thrust of one rotor (N)",
}
"""Keys without a default, and what they are."""


class OppositeSpinsError(BadInputError):
    """Neighbouring rotors turn the same way, so that yaw is not controlled apart from roll or pitch."""


class Rotor(NamedTuple):
    """A rotor of a model.

    Attributes:
        name: For messages.
        position: In the axes of the model (m). Shape (3,).
        spin: 1 = counter-clockwise from above, -1 = clockwise, 0 = not said.
        axis: Its axis, upwards. Shape (3,).
        max_thrust: Largest thrust (N); None = not said.
        torque_ratio: Torque / thrust (m).
        lag: Time constants of the motor: when it speeds up, and when it slows down (s).
        speed_constant: Thrust / speed^2 (N s^2/rad^2), for drag that is proportional to the rotors' speed.
        drag: Drag / (speed of the rotor x speed of the vehicle) (N s^2/(rad m)).
    """

    name: str
    position: np.ndarray
    spin: int = 0
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    max_thrust: float | None = None
    torque_ratio: float | None = None
    lag: tuple[float, float] | None = None
    speed_constant: float | None = None
    drag: float | None = None


@dataclass
class MultirotorData:
    """What a file says of a multirotor.  What is None is not in the file.

    Attributes:
        name: Name of the vehicle.
        body: Mass properties.
        body_note: Where they are from.
        rotors: Its rotors.
        rotor_note: Where their data are from.
        shapes: Shapes for contacts.
        values: Values of keys that the file has directly, e.g. a largest thrust.
        notes: Where these are from, by key.
        linear_drag: Drag / speed, along x, y and z (N s/m).
        linear_drag_note: Where that is from.
        remarks: What else was decided, e.g. joints that are held.
        hover_share: Thrust of hovering / largest thrust; with the mass it gives the largest thrust.
        directions_only: Whether the rotors' positions say in which directions they are, not how far away.
    """

    name: str
    body: MassProperties | None = None
    body_note: str = ""
    rotors: list[Rotor] = field(default_factory=list)
    rotor_note: str = ""
    shapes: list[Shape] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    linear_drag: tuple[float, float, float] | None = None
    linear_drag_note: str = ""
    remarks: list[str] = field(default_factory=list)
    hover_share: float | None = None
    directions_only: bool = False


class _Frame(NamedTuple):
    """An X through the rotors.

    Attributes:
        arm: Mean distance of the rotors from their centre (m).
        turned: Angle of the X's front from the model's x axis (rad).
        remarks: What of the model is not kept.
    """

    arm: float
    turned: float
    remarks: list[str]


class _Draft:
    """Keys of a vehicle in the making: the first value of a key stays.

    Attributes:
        keys: Values, by key.
        notes: Where they are from, by key.
        assumed: Keys whose values are not from the file.
        chosen: Keys whose values are the user's.
    """

    def __init__(self, data: MultirotorData, chosen: Mapping[str, Any]) -> None:
        self.keys: dict[str, Any] = {"name": data.name, **data.values, **chosen}
        self.notes = {"name": "name of the model", **data.notes, **dict.fromkeys(chosen, "chosen")}
        self.assumed: list[str] = []
        self.chosen = frozenset(chosen)

    def take(self, key: str, value: Any, note: str) -> None:  # noqa: ANN401 - as in a YAML file
        """Set a key to a value of the file."""
        if key not in self.keys:
            self.keys[key] = value
            self.notes[key] = note

    def assume(self, key: str, value: Any, note: str) -> None:  # noqa: ANN401 - as in a YAML file
        """Set a key to a value that is not in the file."""
        if key not in self.keys:
            self.take(key, value, note)
            self.assumed.append(key)

    def number(self, key: str) -> float | None:
        """A key's value, which may be the user's, if it is a number above 0."""
        value = self.keys.get(key)
        if isinstance(value, int | float) and value > 0.0:
            return float(value)
        return None


def vehicle_from(data: MultirotorData, source: str, chosen: Mapping[str, Any]) -> ImportedVehicle:
    """Our vehicle.

    Args:
        data: What the file says.
        source: The file, for messages.
        chosen: Keys that the user has set; they go before those of the file.

    Raises:
        BadInputError: It is no quadrotor that our vehicle can be, or a key is missing that has no default.
    """
    draft = _Draft(data, chosen)

    # The frame, which turns the axes of the inertia.
    frame = _frame_of(data, source)
    if frame is not None:
        data.remarks += frame.remarks
        if not data.directions_only:
            draft.take("arm_length", _rounded(frame.arm), "mean distance of the rotors from their centre")
    centre = np.zeros(3)
    if data.body is not None:
        centre = data.body.centre
        draft.take("mass", _rounded(data.body.mass), data.body_note)
        draft.take("inertia", _diagonal(data.body, frame, data.remarks), data.body_note)

    # The rotors.  Thrust and drag may depend on the mass that the user has set.
    mass = draft.number("mass")
    _take_rotors(draft, data, mass)
    drag = _drag(data, mass)
    if drag is not None:
        note = f"{data.linear_drag_note or data.rotor_note}; the same force at {_DRAG_SPEED:g} m/s"
        draft.take("drag", drag, note)

    # The rest has defaults.
    arm = draft.number("arm_length")
    reach = reach_of(data.shapes, centre)
    if reach > 0.0:
        note = f"reach of its {len(data.shapes)} collision shapes from the centre of mass"
        draft.take("collision_radius", rounded_up(reach), note)
    elif arm is not None:
        draft.assume("collision_radius", _rounded(_RADIUS_PER_ARM * arm), f"{_RADIUS_PER_ARM:g} x arm_length")
    _say_bare_rotors(data, draft)
    draft.assume("rotor_torque_ratio", _TORQUE_RATIO, f"{_TORQUE_RATIO:g} m")
    draft.assume("rotor_time_constant", _LAG, f"{_LAG:g} s")
    draft.assume("drag", [0.0, 0.0, 0.0], "none")
    _say_top_speed(data, draft)
    _take_gains(draft)
    _check_complete(source, data, draft.keys)
    return ImportedVehicle(draft.keys, draft.notes, tuple(draft.assumed), tuple(data.remarks))


class _Corners(NamedTuple):
    """Rotors as corners of an X: rear right, front right, front left, rear left.

    Attributes:
        order: Index of the rotor at each corner. Shape (4,).
        turned: Angle of the X's front from the model's x axis (rad).
        errors: Angle of each rotor from its corner (rad). Shape (4,).
    """

    order: np.ndarray
    turned: float
    errors: np.ndarray


def _corners_of(arms: np.ndarray, spins: list[int]) -> _Corners:
    """Assign rotors to corners, by the angles of their arms; shape of arms: (4, 2)."""
    corners = np.radians([-135.0, -45.0, 45.0, 135.0])
    angles = np.array([math.atan2(arm[1], arm[0]) for arm in arms])
    order = np.argsort(angles)
    angles = angles[order]
    turned = float(np.mean(angles - corners))
    if spins[order[1]] < 0 and abs(turned) > _AMBIGUOUS:
        # Either of two arms of a + can be the front right one: the one that turns as ours does.
        if turned > 0.0:
            order = np.roll(order, 1)
            angles = np.roll(angles, 1) - [2.0 * math.pi, 0.0, 0.0, 0.0]
        else:
            order = np.roll(order, -1)
            angles = np.roll(angles, -1) + [0.0, 0.0, 0.0, 2.0 * math.pi]
        turned = float(np.mean(angles - corners))
    return _Corners(order, turned, angles - corners - turned)


def _frame_of(data: MultirotorData, source: str) -> _Frame | None:
    """The X through the rotors; None = the file has none."""
    rotors = data.rotors
    if not rotors:
        return None
    if len(rotors) != _ROTORS:
        names = ", ".join(rotor.name for rotor in rotors)
        raise BadInputError(f"{source}: {len(rotors)} rotors ({names}); allowed: a quadrotor, with {_ROTORS}")
    for rotor in rotors:
        if not rotor.axis[2] >= math.cos(_MAX_TILT):
            raise BadInputError(f"{source}: rotor {rotor.name}: its axis is tilted or points down; allowed: upwards")
    points = np.array([rotor.position[:2] for rotor in rotors])
    middle = points.mean(axis=0)
    lengths = np.array([length(arm) for arm in points - middle])
    mean = float(lengths.mean())
    if not mean > 0.0:
        raise BadInputError(f"{source}: all rotors are in one place; allowed: at the corners of an X")
    corners = _corners_of(points - middle, [rotor.spin for rotor in rotors])
    error = float(np.abs(corners.errors).max())
    spread = float(np.abs(lengths / mean - 1.0).max())
    if error > _MAX_TURN or spread > _MAX_SPREAD:
        places = ", ".join(f"({x:.3g}, {y:.3g})" for x, y in points)
        raise BadInputError(f"{source}: rotors at {places} m; allowed: about an X or +, with equal arms")
    _check_spins(source, [rotors[index] for index in corners.order])
    remarks = []
    if error > _SMALL_ANGLE or spread > _SMALL_SHARE:
        remarks.append("rotors are not at the corners of a square; flown as an X with the mean arm")
    if abs(corners.turned) > _SMALL_ANGLE:
        degrees = math.degrees(corners.turned)
        remarks.append(f"flown as an X: its front is {degrees:+.0f} degrees from the model's x axis")
    if rotors[corners.order[1]].spin < 0:
        remarks.append("its rotors turn the other way round than ours; flown as its mirror image")
    remarks += _offset_of(middle, mean, data, source)
    return _Frame(mean, corners.turned, remarks)


def _offset_of(middle: np.ndarray, mean: float, data: MultirotorData, source: str) -> list[str]:
    """What to say of the distance between the rotors' centre and the centre of mass; a large one is refused."""
    if data.body is None:
        return []
    offset = length(middle - data.body.centre[:2])
    if offset > _MAX_SPREAD * mean:
        raise BadInputError(
            f"{source}: the rotors' centre is {offset:.3g} m from the centre of mass; allowed: "
            f"{_MAX_SPREAD * mean:.3g} m at most, it hovers with equal thrusts"
        )
    if offset > _SMALL_SHARE * mean:
        return [f"the rotors' centre is {offset:.2g} m from the centre of mass; flown as if it were there"]
    return []


def _check_spins(source: str, rotors: list[Rotor]) -> None:
    """Refuse neighbours that turn the same way; in the order of their angles."""
    spins = [rotor.spin for rotor in rotors]
    if all(spins) and any(a == b for a, b in zip(spins, [*spins[1:], spins[0]], strict=True)):
        directions = ", ".join(f"{rotor.name} {_DIRECTIONS[rotor.spin]}" for rotor in rotors)
        raise OppositeSpinsError(f"{source}: {directions}; allowed: neighbours that turn in opposite directions")


def _diagonal(body: MassProperties, frame: _Frame | None, remarks: list[str]) -> list[float]:
    """Inertia in the axes of the X (kg m^2); what of it cannot be flown is added to the remarks."""
    turned = 0.0
    if frame is not None:
        turned = frame.turned
    turn = matrix_of_rpy(0.0, 0.0, turned)
    tensor = product(product(turn.T, body.tensor), turn)
    diagonal = np.diag(tensor)
    beside = np.abs(tensor - np.diag(diagonal)).max()
    if beside > _OFF_DIAGONAL * np.abs(diagonal).min():
        remarks.append(f"products of inertia up to {beside:.2g} kg m^2 are left out")
    # some models have more inertia about an axis than any rigid body of the other two can have
    axis = int(np.argmax(diagonal))
    others = float(diagonal.sum() - diagonal[axis])
    if others < diagonal[axis] <= (1.0 + _MOST_EXCESS) * others:
        remarks.append(f"inertia about {'xyz'[axis]} {diagonal[axis]:.3g} is no rigid body's; flown with {others:.3g}")
        diagonal = np.where(np.arange(3) == axis, (1.0 - 1e-5) * others, diagonal)
    return [_rounded(value) for value in diagonal]


def _take_rotors(draft: _Draft, data: MultirotorData, mass: float | None) -> None:
    """What all rotors have in common."""
    thrusts = [rotor.max_thrust for rotor in data.rotors if rotor.max_thrust is not None]
    if thrusts:
        least = min(thrusts)
        note = data.rotor_note
        if max(thrusts) > (1.0 + _SPREAD_THRUST) * least:
            note += f"; the smallest of {least:.4g} to {max(thrusts):.4g} N"
        draft.take("max_rotor_thrust", *_limited(least, mass, note))
    elif data.hover_share is not None and mass is not None:
        thrust = mass * GRAVITY / _ROTORS / data.hover_share
        draft.take("max_rotor_thrust", _rounded(thrust), f"hovers at {data.hover_share:g} of it")
    ratios = [abs(rotor.torque_ratio) for rotor in data.rotors if rotor.torque_ratio]
    if ratios:
        draft.take("rotor_torque_ratio", _rounded(float(np.mean(ratios))), data.rotor_note)
    lags = [rotor.lag for rotor in data.rotors if rotor.lag is not None]
    if lags:
        up, down = lags[0]
        note = data.rotor_note
        if up != down:
            note += f"; mean of {up:g} s up and {down:g} s down"
        draft.take("rotor_time_constant", _rounded(0.5 * (up + down)), note)


def _limited(thrust: float, mass: float | None, note: str) -> tuple[float, str]:
    """Largest thrust of one rotor (N), at most so much that it hovers within the mixer's range; and its source."""
    if mass is None or thrust <= _MOST_LIFT * mass * GRAVITY / _ROTORS:
        return _rounded(thrust), note
    limit = _MOST_LIFT * mass * GRAVITY / _ROTORS
    return _rounded(limit), f"{note}; limited from {thrust:.4g} N to {_MOST_LIFT:g} x weight"


def _drag(data: MultirotorData, mass: float | None) -> list[float] | None:
    """Coefficients of our drag, which is quadratic, from one that is linear in the speed (N s^2/m^2)."""
    if data.linear_drag is not None:
        return [_rounded(value / _DRAG_SPEED) for value in data.linear_drag]
    if mass is None or not data.rotors:
        return None
    total = 0.0
    for rotor in data.rotors:
        if rotor.drag is None or not rotor.speed_constant:
            return None
        total += rotor.drag * math.sqrt(mass * GRAVITY / len(data.rotors) / rotor.speed_constant)
    sideways = _rounded(total / _DRAG_SPEED)
    return [sideways, sideways, 0.0]


def _say_bare_rotors(data: MultirotorData, draft: _Draft) -> None:
    """Remark that rotors without collision shapes may reach out of a sphere that is the file's."""
    radius = draft.number("collision_radius")
    arm = draft.number("arm_length")
    if radius is None or arm is None or "collision_radius" in (*draft.assumed, *draft.chosen):
        return
    solid_links = {shape.owner.rpartition("::")[2] for shape in data.shapes if shape.kind != MESH}
    is_bare = not any(rotor.name.rpartition("::")[2] in solid_links for rotor in data.rotors)
    is_of_shapes = "collision_radius" not in data.values
    if radius < arm or (is_of_shapes and is_bare and radius < _RADIUS_PER_ARM * arm):
        data.remarks.append(
            f"rotor tips may be outside of collision_radius ({radius:g} m): rotors, {arm:.3g} m from their centre, "
            "have no collision shape"
        )


def _say_top_speed(data: MultirotorData, draft: _Draft) -> None:
    """Remark that drag leaves less speed than missions usually have."""
    mass = draft.number("mass")
    drag = draft.keys["drag"]
    if mass is None or not isinstance(drag, list) or not isinstance(drag[0], int | float) or not drag[0] > 0.0:
        return
    speed = math.sqrt(mass * GRAVITY * math.tan(VehicleConfig.model_fields["max_tilt"].default) / drag[0])
    if speed < _DRAG_SPEED:
        data.remarks.append(f"its drag leaves {speed:.2g} m/s at full tilt; choose a lower v_max")


def _take_gains(draft: _Draft) -> None:
    """Gains within the bandwidth of slow motors; those of fast ones are the defaults."""
    fields = VehicleConfig.model_fields
    default: tuple[float, float, float] = fields["rate_gain"].default
    lag = draft.number("rotor_time_constant")
    if lag is None or lag * default[0] <= _BANDWIDTH_LAG:
        return
    share = _BANDWIDTH_LAG / (lag * default[0])
    note = f"reduced to {100.0 * share:.0f} % for motors this slow"
    draft.take("rate_gain", [_rounded(share * gain) for gain in default], note)
    draft.take("attitude_gain", _rounded(share * fields["attitude_gain"].default), note)
    draft.take("velocity_gain", _rounded(share * fields["velocity_gain"].default), note)


def _check_complete(source: str, data: MultirotorData, keys: Mapping[str, Any]) -> None:
    """Ask for what has no default, by its key."""
    missing = [f"{key}: {what}" for key, what in _NEEDED.items() if key not in keys]
    if not missing:
        return
    hint = ""
    if "max_rotor_thrust" not in keys and data.hover_share is not None:
        hint = f" (with the mass, max_rotor_thrust follows from hovering at {data.hover_share:g})"
    raise BadInputError(
        f"{source}: does not say: {'; '.join(missing)}{hint}; allowed: a YAML file with 'model: {source}' and "
        "these keys"
    )


def _rounded(value: float) -> float:
    """Six significant digits, as a person would write it."""
    return float(f"{value:.6g}")


def rounded_up(length_m: float) -> float:
    """The next millimetre above a length (m), but for rounding errors."""
    if not length_m < _MOST_LENGTH:
        return length_m
    return math.ceil(1000.0 * length_m - 1e-6) / 1000.0
