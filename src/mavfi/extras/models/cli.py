"""`mavfi vehicle`: what a model's file says of a vehicle, as our YAML file."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli.console import answer
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.sim.imported import ImportedVehicle

HELP_PANEL = "Fly and look"
_WIDTH = 64
"""Column of the comments."""


def vehicle(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL",
            help=".sdf, .urdf, .xacro, MuJoCo's .xml, an airframe of PX4, or a YAML file with the key model.",
        ),
    ],
) -> None:
    """Print the vehicle that a model is flown as, in YAML.

    Each value has its source.

    Example: [bold]mavfi vehicle model.sdf > mine.yaml[/bold]
    """
    from mavfi.config import VehicleConfig, parse
    from mavfi.sim.engine import GRAVITY
    from mavfi.sim.mjcf import find_vehicle

    imported = _import(file)
    config = parse(VehicleConfig, imported.keys, str(file))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # says what is printed below
        find_vehicle(str(file))  # refuses what cannot fly
    share = config.mass * GRAVITY / (4.0 * config.max_rotor_thrust)
    answer(f"# {file}: hovers at {100.0 * share:.0f} % of the largest thrust")
    for remark in imported.remarks:
        answer(f"# {remark}")
    for key in VehicleConfig.model_fields:
        value = getattr(config, key)
        if value is None:
            continue
        note = imported.notes.get(key, "mavfi's default")
        if key in imported.assumed:
            note = f"assumed: {note}"
        answer(f"{f'{key}: {_text(value)}':{_WIDTH}} # {note}")


def _import(file: Path) -> ImportedVehicle:
    """What the file, or the model that a YAML file names, says."""
    from mavfi.config import read_yaml
    from mavfi.sim.imported import VEHICLE_FILES, extensions_of, reader_of

    chosen: dict[str, Any] = {}
    model = file
    if file.suffix.lower() in (".yaml", ".yml"):
        chosen = read_yaml(file)
        name = chosen.pop("model", None)
        if not isinstance(name, str):
            raise BadInputError(f"{file}: key 'model': {name!r}: allowed: a file of a model")
        model = file.parent / name
    reader = reader_of(VEHICLE_FILES, str(model))
    if reader is None:
        raise BadInputError(f"{model}: not a model of a vehicle; allowed: {', '.join(extensions_of(VEHICLE_FILES))}")
    imported: ImportedVehicle = reader(model, chosen)
    return imported


def _text(value: Any) -> str:  # noqa: ANN401 - of a configuration
    if isinstance(value, tuple):
        return "[" + ", ".join(f"{part:g}" for part in value) + "]"
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)
