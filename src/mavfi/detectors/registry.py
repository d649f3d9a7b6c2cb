"""Detectors by name: the two of the paper, those of other packages, and `package:Class`."""

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.gate import UNKNOWN_ARENA, Chain, PhysicsGate
from mavfi.detectors.model import FITTED_TO, Model, check_fits, model_name
from mavfi.detectors.preprocess import PROFILES
from mavfi.errors import BadInputError
from mavfi.plugins import build, known, load_object
from mavfi.states import State

GROUP = "mavfi.detectors"
"""Entry points of this group are detectors: classes without arguments, or, where a class says its `model_kind`, with a
trained model of that kind and profile."""
SHIPPED_MODELS = Path(__file__).parents[1] / "data" / "models"
_SHIPPED = {
    "autoencoder": "mavfi.detectors.autoencoder:AutoencoderDetector",
    "gaussian": "mavfi.detectors.gaussian:GaussianDetector",
    "none": "mavfi.detectors.registry:NoDetector",
}


class NoDetector:
    """Watches nothing."""

    def start(self) -> None:
        """Nothing to forget."""

    def check(self, state: State, time_us: int) -> Alarm | None:
        """No alarm."""
        return None

    def accept(self, state: State, time_us: int) -> None:
        """Nothing to remember."""


def detector_names() -> list[str]:
    """Every name that `load_detector` knows."""
    return sorted(known(GROUP, _SHIPPED))


def load_detector(
    name: str, profile: str, models_dir: Path | None, fits: Mapping[str, Any], *, policy: str | None = None,
    gate: bool | None = None, sigmas: float | None = None,
) -> tuple[Detector, str]:  # fmt: skip
    """A detector, ready to fly.

    Args:
        name: One of `detector_names()`, or "package:Class".
        profile: "paper" or "tuned".
        models_dir: Folder of trained models; None = the shipped ones.
        fits: What the model must have been trained for: stack, platform, v_max (m/s), planner; `arena`, if given, is
            the lower and upper corner that the physics gate lets way-points be in (m).
        policy: Recovery policy of the autoencoder instead of the profile's.
        gate: Whether the physics gate stands in front; None = for `tuned` only.
        sigmas: The paper's n instead of the model's.

    Returns:
        The detector, and the sha256 of its trained model ("" where it has none).

    Raises:
        BadInputError: No such detector, profile or model.
        SpecMismatchError: The model was trained for something else.
    """
    if profile not in PROFILES:
        raise BadInputError(f"detector profile {profile!r}: not known; allowed: {', '.join(PROFILES)}")
    if name == "none":
        return NoDetector(), ""
    factory = load_object("detector", name, GROUP, _SHIPPED)
    kind = getattr(factory, "model_kind", None)
    if kind is None:
        return _build(name, factory), ""
    model = _load_model(str(kind), profile, models_dir or SHIPPED_MODELS, fits)
    detector = _build(name, factory, model, **{"policy": policy, "sigmas": sigmas})
    if profile == "tuned" if gate is None else gate:
        detector = Chain(PhysicsGate(float(fits["v_max"]), fits.get("arena", UNKNOWN_ARENA)), detector)
    return detector, model.sha256


def _load_model(kind: str, profile: str, folder: Path, fits: Mapping[str, Any]) -> Model:
    path = folder / f"{model_name(fits['stack'], fits['platform'], kind, profile)}.json"
    if not path.is_file():
        raise BadInputError(f"{path}: no model is trained for this stack and platform; train one with `mavfi train`")
    model = Model.load(path)
    if (model.kind, model.profile) != (kind, profile):
        raise BadInputError(f"{path}: is a model {model.kind}-{model.profile}; needed: {kind}-{profile}")
    check_fits(model, *(fits[key] for key in FITTED_TO))
    return model


def _build(name: str, factory: Any, *arguments: Model, **options: object) -> Detector:  # noqa: ANN401
    given = {key: value for key, value in options.items() if value is not None}
    unknown = set(given) - set(inspect.signature(factory).parameters)
    if unknown:
        raise BadInputError(f"detector {name!r}: has no option {', '.join(sorted(unknown))}")
    made = build("detector", name, factory, *arguments, needs=("start", "check", "accept"), **given)
    return cast(Detector, made)
