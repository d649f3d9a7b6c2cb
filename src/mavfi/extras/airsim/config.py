"""Configuration of a client program of AirSim under test."""

import hashlib
from pathlib import Path
from typing import Any

from pydantic import Field

from mavfi.config import Config
from mavfi.errors import BadInputError
from mavfi.files import is_dir, is_file

IMAGE = "256x144"
"""Size of images unless chosen (width x height, pixels), as in AirSim's default settings."""
VEHICLE = "SimpleFlight"
"""Name of the vehicle unless chosen, as in AirSim's default settings."""
CALL_US = 4_000
"""Time that a call takes in the clock `steps`."""


def pixels(text: str) -> tuple[int, int]:
    """Width and height from e.g. "256x144".

    Raises:
        BadInputError: Another form, or out of range.
    """
    parts = text.lower().split("x")
    if len(parts) == 2 and all(part.isdecimal() and 2 <= int(part) <= 4096 for part in parts):
        return int(parts[0]), int(parts[1])
    raise BadInputError(f"--image: {text!r}: allowed: WIDTHxHEIGHT, e.g. {IMAGE}, of 2 to 4096 pixels each")


class ProgramConfig(Config):
    """A client program of AirSim under test."""

    script: str = Field(description="file of the program")
    arguments: tuple[str, ...] = ()
    python: str = Field("", description="Python that has the program's AirSim client; mavfi's own by default")
    seconds: float = Field(120.0, gt=0, le=1e5, description="simulated time after which the program is stopped")
    wall_s: float = Field(120.0, gt=0, le=1e5, description="wall-clock time after which it counts as hanging")
    image: str = Field(IMAGE, pattern=r"^\d+x\d+$", description="size of images, width x height")
    vehicle: str = Field(VEHICLE, description="name of the vehicle, unless the settings name vehicles")
    settings: str = Field("", description="AirSim's settings.json: vehicles, cameras, wind")
    fault_vehicle: str = Field("", description="vehicle whose calls are changed; the first one by default")
    version: int = Field(0, ge=0, le=100, description="of the API; 0 = the client's own")
    call_us: int = Field(CALL_US, ge=4_000, le=1_000_000, multiple_of=4_000, description="time that a call takes")
    golden_runs: int = Field(2, ge=1, le=100, description="error-free runs of a mission; they must be the same")

    def check(self) -> None:
        """Check the size of images, and that the files exist.

        Raises:
            BadInputError: An image of this size is not allowed, or a file does not exist.
        """
        pixels(self.image)
        if not is_file(Path(self.script)):
            raise BadInputError(f"{self.script}: {_no_file(self.script)}; allowed: a client program of AirSim")
        if self.python and not is_file(Path(self.python)):
            raise BadInputError(f"--python: {self.python}: {_no_file(self.python)}; allowed: a Python interpreter")

    def to_json(self) -> dict[str, Any]:
        """Plain data, with a digest of the program's text and its settings."""
        text = b""
        for name in (self.script, self.settings):
            if name and is_file(Path(name)):
                text += Path(name).read_bytes()
        data = {**self.model_dump(mode="json"), "sha256": hashlib.sha256(text).hexdigest()}
        for key in ("settings", "fault_vehicle"):  # ledgers from before these keys have none
            if not data[key]:
                del data[key]
        return data


def _no_file(name: str) -> str:
    if is_dir(Path(name)):
        return "is a folder"
    return "there is no such file"
