"""Airframes of PX4: start scripts (`4001_gz_x500`) and parameter files of QGroundControl (`.params`).

They hold the geometry of the rotors (CA_ROTORn_*), and with PX4's own simulation (SIH_*) mass, inertia and thrust.
Axes are forward, right, down; ours are forward, left, up.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.models.geometry import MassProperties
from mavfi.extras.models.quadrotor import MultirotorData, Rotor, vehicle_from
from mavfi.files import LARGEST_TEXT, is_file, read_file
from mavfi.sim.imported import ImportedVehicle

_SET = re.compile(r"^\s*param\s+set(?:-default)?\s+(?:-\w+\s+)*([A-Z][A-Z0-9_]*)\s+(\S+)", re.MULTILINE)
_LISTED = re.compile(r"^\s*\d+\s+\d+\s+([A-Z][A-Z0-9_]*)\s+(\S+)\s+\d+\s*$", re.MULTILINE)
_SOURCED = re.compile(r"^\s*\.\s+\S*?/airframes/([\w.+-]+)\s*$", re.MULTILINE)
_MIXER = re.compile(r"^\s*set\s+MIXER\s+(\S+)", re.MULTILINE)
_NAME = re.compile(r"^#\s*@name\s+(.+?)\s*$", re.MULTILINE)
_MULTIROTOR = 0
"""CA_AIRFRAME of multirotors."""
_QUADS = ("quad_x", "quad_w", "quad_h", "quad_+", "quad_dc", "quad_wide", "quad_x_pusher", "quad_x_can")
"""Mixers of PX4 until version 1.13 that mean four rotors."""
_DEFAULT_KM = 0.05
"""PX4's default of CA_ROTORn_KM (m)."""
_DUMPED_DEFAULTS = {**{f"CA_ROTOR{n}_CT": 6.5 for n in range(4)}, "MPC_THR_HOVER": 0.5}
"""Defaults of PX4 that say nothing of a vehicle; a parameter file lists them like all others."""
_SIH = {
    "SIH_MASS": 1.0,
    "SIH_IXX": 0.025,
    "SIH_IYY": 0.025,
    "SIH_IZZ": 0.030,
    "SIH_IXY": 0.0,
    "SIH_IXZ": 0.0,
    "SIH_IYZ": 0.0,
    "SIH_T_MAX": 5.0,
    "SIH_Q_MAX": 0.1,
    "SIH_L_ROLL": 0.2,
    "SIH_L_PITCH": 0.2,
    "SIH_KDV": 1.0,
    "SIH_T_TAU": 0.05,
}
"""PX4's defaults of the vehicle in its own simulation (SI units)."""
_DEEPEST = 5


def airframe_vehicle(path: Path, chosen: Mapping[str, Any]) -> ImportedVehicle:
    """See `mavfi.sim.imported.VehicleReader`."""
    text = _text(path, 0)
    parameters = _parameters(_SET, text)
    listed = _parameters(_LISTED, text)
    in_own_simulation = parameters.get("SYS_HITL", listed.get("SYS_HITL")) == 2
    in_own_simulation = in_own_simulation or any(key.startswith("SIH_") for key in parameters)
    parameters |= {key: value for key, value in listed.items() if value != _DUMPED_DEFAULTS.get(key)}
    mixer = _MIXER.findall(text)
    if not parameters and not mixer:
        raise BadInputError(
            f"{path}: sets no parameters; allowed: an airframe of PX4 (param set-default CA_ROTOR0_PX 0.15) or a "
            "parameter file of QGroundControl"
        )
    _check_kind(path, parameters, mixer)
    title = _NAME.findall(text)
    name = path.stem
    if title:
        name = re.sub(r"\W+", "_", title[-1]).strip("_") or name
    data = MultirotorData(name)
    if in_own_simulation:
        _take_simulation(data, parameters, path)
    else:
        _take_geometry(data, parameters, path)
    hover = parameters.get("MPC_THR_HOVER")
    if hover is not None and 0.0 < hover < 1.0:
        data.hover_share = hover
    return vehicle_from(data, str(path), chosen)


def _text(path: Path, depth: int) -> str:
    """A start script after those that it runs first."""
    if depth > _DEEPEST:
        raise BadInputError(f"{path}: scripts that run each other; allowed: {_DEEPEST} at most")
    if not is_file(path):
        raise BadInputError(f"{path}: there is no such file")
    content = read_file(path, LARGEST_TEXT)
    if b"\0" in content:
        raise BadInputError(f"{path}: not a text file; allowed: an airframe of PX4")
    text = content.decode(errors="replace")
    before = []
    for name in _SOURCED.findall(text):
        if is_file(path.parent / name):
            before.append(_text(path.parent / name, depth + 1))
    return "\n".join([*before, text])


def _parameters(pattern: re.Pattern[str], text: str) -> dict[str, float]:
    """Parameters with their last values, apart from those that are no finite numbers, e.g. variables of the shell."""
    parameters = {}
    for key, value in pattern.findall(text):
        try:
            number = float(value)
        except ValueError:
            continue
        if math.isfinite(number):
            parameters[key] = number
    return parameters


def _check_kind(path: Path, parameters: Mapping[str, float], mixer: list[str]) -> None:
    """Refuse what is no multirotor with four rotors."""
    kind = parameters.get("CA_AIRFRAME", _MULTIROTOR)
    if kind != _MULTIROTOR:
        raise BadInputError(f"{path}: CA_AIRFRAME {kind:g}: allowed: {_MULTIROTOR}, a multirotor")
    count = parameters.get("CA_ROTOR_COUNT", 4)
    if count != 4:
        raise BadInputError(f"{path}: CA_ROTOR_COUNT {count:g}: allowed: 4, a quadrotor")
    if mixer and not any(key.startswith("CA_") for key in parameters) and mixer[-1] not in _QUADS:
        raise BadInputError(f"{path}: mixer {mixer[-1]}: allowed: {', '.join(_QUADS)}")


def _take_simulation(data: MultirotorData, parameters: Mapping[str, float], path: Path) -> None:
    """The vehicle of PX4's own simulation; parameters that are not set have PX4's defaults."""
    kind = parameters.get("SIH_VEHICLE_TYPE", 0)
    if kind != 0:
        raise BadInputError(f"{path}: SIH_VEHICLE_TYPE {kind:g}: allowed: 0, a quadrotor")
    values = {key: parameters.get(key, default) for key, default in _SIH.items()}
    absent = [key for key in _SIH if key not in parameters]
    xx, yy, zz = (values[f"SIH_I{axis}"] for axis in ("XX", "YY", "ZZ"))
    xy, xz, yz = (values[f"SIH_I{axes}"] for axes in ("XY", "XZ", "YZ"))
    # y and z point the other way in our axes
    tensor = np.array([[xx, -xy, -xz], [-xy, yy, yz], [-xz, yz, zz]])
    data.body = MassProperties(values["SIH_MASS"], np.zeros(3), tensor)
    data.body_note = data.rotor_note = "SIH parameters"
    if absent:
        data.remarks.append(f"PX4's defaults of {', '.join(absent)}")
    if not values["SIH_T_MAX"] > 0.0:
        raise BadInputError(f"{path}: SIH_T_MAX {values['SIH_T_MAX']:g}: allowed: above 0")
    side = values["SIH_L_ROLL"]
    front = values["SIH_L_PITCH"]
    lag = values["SIH_T_TAU"]
    for name, x, y, spin in (
        ("0", front, -side, 1),
        ("1", -front, side, 1),
        ("2", front, side, -1),
        ("3", -front, -side, -1),
    ):
        data.rotors.append(
            Rotor(
                name,
                np.array([x, y, 0.0]),
                spin,
                max_thrust=values["SIH_T_MAX"],
                torque_ratio=values["SIH_Q_MAX"] / values["SIH_T_MAX"],
                lag=(lag, lag),
            )
        )
    data.linear_drag = (values["SIH_KDV"],) * 3
    data.linear_drag_note = "SIH_KDV"


def _take_geometry(data: MultirotorData, parameters: Mapping[str, float], path: Path) -> None:
    """Rotors from CA_ROTORn_*."""
    present = [n for n in range(4) if f"CA_ROTOR{n}_PX" in parameters or f"CA_ROTOR{n}_PY" in parameters]
    if not present:
        return
    if len(present) < 4:
        raise BadInputError(f"{path}: CA_ROTORn_PX and _PY of {len(present)} rotors; allowed: of 4")
    data.rotor_note = "CA_ROTORn_*"
    ratios = []
    for n in range(4):
        x, y, z = (parameters.get(f"CA_ROTOR{n}_P{axis}", 0.0) for axis in "XYZ")
        ratio = parameters.get(f"CA_ROTOR{n}_KM", _DEFAULT_KM)
        axis = tuple(
            parameters.get(f"CA_ROTOR{n}_A{name}", default)
            for name, default in zip("XYZ", (0.0, 0.0, -1.0), strict=True)
        )
        ratios.append(abs(ratio))
        if ratio == 0.0:
            spin = 0
        else:
            spin = int(np.sign(ratio))
        data.rotors.append(
            Rotor(
                str(n),
                np.array([x, -y, -z]),
                spin,
                axis=(axis[0], -axis[1], -axis[2]),
                max_thrust=parameters.get(f"CA_ROTOR{n}_CT"),
                torque_ratio=ratio,
            )
        )
    if any(f"CA_ROTOR{n}_KM" not in parameters for n in range(4)):
        data.remarks.append(f"PX4's default of CA_ROTORn_KM, {_DEFAULT_KM:g} m, where it is not set")
    if all(max(abs(rotor.position[0]), abs(rotor.position[1])) >= 1.0 for rotor in data.rotors):
        # many airframes give directions of the arms only
        data.remarks.append("CA_ROTORn_PX and _PY of 1 are directions, not lengths")
        data.directions_only = True
