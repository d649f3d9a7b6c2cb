"""Trained models: JSON files that state their provenance and are rejected where they do not fit."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, SpecMismatchError, writing
from mavfi.files import LARGEST_TEXT, read_file

FORMAT = 1
"""Version of the files of models."""
SMALLEST_LIMIT = 1e-30
"""Smallest score limit allowed in a model."""
_TEXTS = ("kind", "profile", "monitored", "prediction")
"""Keys of a model's file whose values are text."""
_LARGEST = 1e18
"""Largest magnitude of a parameter."""
FITTED_TO = ("stack", "platform", "v_max", "planner")
"""What a model must have been trained for to be used: keys of its provenance and of the mission."""


@dataclass(frozen=True)
class Model:
    """A trained detector, as plain data.

    Attributes:
        kind: "gaussian" or "autoencoder" (or a user's own).
        profile: "paper" or "tuned".
        monitored: Name of the monitored set.
        prediction: Position prediction of `tuned`, see `preprocess.PREDICTIONS`.
        parameters: Results of training: numbers and lists of numbers.
        provenance: FITTED_TO, seeds, number of flights, versions.
    """

    kind: str
    profile: str
    monitored: str
    prediction: str
    parameters: dict[str, Any]
    provenance: dict[str, Any]

    @property
    def name(self) -> str:
        """File name without ".json"."""
        return model_name(self.provenance["stack"], self.provenance["platform"], self.kind, self.profile)

    @cached_property
    def sha256(self) -> str:
        """Hash of the whole content."""
        return _hash(self._content())

    def to_json(self) -> dict[str, Any]:
        """Plain data, including the hash."""
        return {**self._content(), "sha256": self.sha256}

    @staticmethod
    def from_json(data: Mapping[str, Any], source: str = "model") -> "Model":
        """Inverse of `to_json`; `source` names the data in messages.

        Raises:
            BadInputError: Unknown format, missing key, or content that does not match its hash.
        """
        content = {key: value for key, value in data.items() if key != "sha256"}
        if content.get("format") != FORMAT:
            raise BadInputError(f"{source}: model format {content.get('format')!r}; allowed: {FORMAT}")
        if data.get("sha256") != _hash(content):
            raise BadInputError(f"{source}: the content does not match its sha256; train the model again")
        del content["format"]
        try:
            model = Model(**content)
        except TypeError as error:
            raise BadInputError(f"{source}: not a model ({error})") from None
        for key in _TEXTS:
            if not isinstance(content[key], str):
                raise BadInputError(f"{source}: key {key!r}: {content[key]!r}; allowed: text")
        if not isinstance(model.parameters, dict):
            raise BadInputError(f"{source}: key 'parameters': allowed: numbers by name")
        if not isinstance(model.provenance, dict) or not set(FITTED_TO) <= set(model.provenance):
            raise BadInputError(f"{source}: key 'provenance': allowed: values of {', '.join(FITTED_TO)}")
        return model

    def numbers(self, key: str, *shape: int, least: float = -_LARGEST) -> np.ndarray:
        """Numbers of a parameter, of this shape.

        Raises:
            BadInputError: The parameter is absent, has another shape, or contains anything but numbers >= `least`.
        """
        try:
            array = np.array(self.parameters[key], np.float64)
        except (KeyError, OverflowError, TypeError, ValueError):
            array = np.full(shape, np.nan)
        if array.shape != shape or not ((array >= least) & (array <= _LARGEST)).all():
            size = " x ".join(map(str, shape)) or "one"
            raise BadInputError(f"parameter {key!r}: allowed: {size} numbers from {least:g} to {_LARGEST:g}")
        return array

    def _content(self) -> dict[str, Any]:
        """What is stored of a model, without its digest."""
        return {"format": FORMAT, **{field.name: getattr(self, field.name) for field in fields(self)}}

    def save(self, folder: Path) -> Path:
        """Write `<name>.json` into a folder, creating it if absent.

        Raises:
            BadInputError: The file cannot be written.
        """
        path = folder / f"{self.name}.json"
        with writing(path):
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(self.to_json(), indent=1) + "\n", encoding="utf-8")
        return path

    @staticmethod
    def load(path: Path) -> "Model":
        """Read a file written by `save`.

        Raises:
            BadInputError: The file is absent, not a model, or modified.
        """
        return _parsed(read_file(path, LARGEST_TEXT), str(path))


@lru_cache(maxsize=32)  # each flight makes its detectors; a model of training rows takes 60 ms to parse and check
def _parsed(text: bytes, source: str) -> Model:
    """The model in the content of a file; `source` is for messages."""
    try:
        data = json.loads(text)
        if not isinstance(data, dict):
            raise BadInputError(f"{source}: not a model (holds {type(data).__name__})")
        return Model.from_json(data, source)
    except (RecursionError, ValueError) as error:
        raise BadInputError(f"{source}: not a model ({error})") from None


def model_name(autopilot: str, platform: str, kind: str, profile: str) -> str:
    """File name of a model, without ".json"."""
    return f"{autopilot}-{platform}-{kind}-{profile}"


def check_fits(model: Model, **here: object) -> None:
    """Reject a model that was trained for another mission: `here` has keys of `FITTED_TO`, v_max in m/s.

    Raises:
        SpecMismatchError: One line that names what differs.
    """
    for key, wanted in here.items():
        trained = model.provenance.get(key)
        same = trained == wanted
        if isinstance(trained, (int, float)) and isinstance(wanted, (int, float)):
            same = math.isclose(trained, wanted, rel_tol=1e-9)
        if not same:
            raise SpecMismatchError(
                f"model {model.name}: trained for {key} {trained!r}, used with {key} {wanted!r}; "
                f"use {trained!r}, train a model with `mavfi train`, or fly with this one, key trained_for: "
                f"{model.provenance['stack']}/{model.provenance['platform']}"
            )


def _hash(content: Mapping[str, Any]) -> str:
    """Digest of a model's content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
