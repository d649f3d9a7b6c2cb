"""Detectors by name: the two of the paper, the acceptance test, those of other packages, and `package:Class`."""

from collections.abc import Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any, cast

from pydantic import Field

from mavfi.config import Config, names, shipped
from mavfi.detectors.chain import Chain
from mavfi.detectors.detector import Detector, check_states
from mavfi.detectors.gate import SOURCE as GATE
from mavfi.detectors.gate import UNKNOWN_ARENA, PhysicsGate
from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.model import FITTED_TO, Model, check_fits, model_name
from mavfi.detectors.preprocess import PROFILES
from mavfi.errors import BadInputError, SpecMismatchError, hint
from mavfi.files import is_file
from mavfi.plugins import build, known, load_object, parameters_of

GROUP = "mavfi.detectors"
"""Entry points of this group are detectors: classes without arguments, or, if a class has a `model_kind`, with a model
of that kind and profile.  `mavfi train` fits those with `fit(sample, preprocessor, figures)`, which returns the
parameters of the model; a class with a true `watches_all` is fitted to all fields, with an `Everything` instead of the
preprocessor, and in one profile only.  One with an `extra` needs packages of that extra; `check_installed` checks for
them.  The figures are those of configs/detectors/<name>.yaml.  A class with a true `needs_limits` is constructed with
the `MissionLimits` of the mission, one with a true `needs_seed` with its seed.  `recovery` contains
the mission keys, of `OF_RECOVERY`, that go with a detector; they give way to those of a command or an arm, and replace
`OF_OWN`."""
OF_RECOVERY = ("coupling", "grain", "same_twice", "answer_s", "degraded", "dead_node", "alarm", "epoch_liveness")
"""Mission keys that a detector may set."""
OF_OWN: Mapping[str, Any] = {"grain": "kernel", "same_twice": "limit"}
"""Mission keys of a detector that is not part of mavfi, unless it sets them: it may raise alarms without end."""
ONLY_PROFILE = "tuned"
"""The profile of detectors of all fields."""
SHIPPED_MODELS = Path(__file__).parents[1] / "data" / "models"
_SHIPPED = {
    "gaussian": "mavfi.detectors.gaussian:GaussianDetector",
    "autoencoder": "mavfi.detectors.autoencoder:AutoencoderDetector",
    "acceptance": "mavfi.detectors.acceptance:AcceptanceTest",
    "recommended": "mavfi.detectors.acceptance:AcceptanceTest",
    "rule_1": "mavfi.detectors.single_rule:SingleRule",
    "rule_2": "mavfi.detectors.single_rule:SingleRule",
    "rule_3": "mavfi.detectors.single_rule:SingleRule",
    "rule_4": "mavfi.detectors.single_rule:SingleRule",
    "rule_5": "mavfi.detectors.single_rule:SingleRule",
    "limits": "mavfi.detectors.all_fields:LimitsDetector",
    "autoencoder_all": "mavfi.detectors.all_fields:AutoencoderAllDetector",
    "cusum": "mavfi.detectors.cusum:CusumDetector",
    "conformal": "mavfi.detectors.conformal:ConformalDetector",
    "isolation_forest": "mavfi.detectors.baselines.outliers:IsolationForestDetector",
    "pca": "mavfi.detectors.baselines.outliers:PcaDetector",
    "mahalanobis": "mavfi.detectors.baselines.outliers:MahalanobisDetector",
    "half_space_trees": "mavfi.detectors.baselines.half_space_trees:HalfSpaceTreesDetector",
    "gradient_boosting": "mavfi.detectors.baselines.gradient_boosting:GradientBoostingDetector",
    "matrix_profile": "mavfi.detectors.baselines.matrix_profile:MatrixProfileDetector",
    "checksum": "mavfi.detectors.sealed:Checksum",
    "checksum_large": "mavfi.detectors.sealed:Checksum",
    "duplicate": "mavfi.detectors.duplicate:Duplicate",
    "oracle": "mavfi.detectors.sealed:Oracle",
    "random": "mavfi.detectors.random_alarms:RandomAlarms",
    "none": "mavfi.detectors.registry:NoDetector",
}


class ProfileSettings(Config):
    """A detector in one profile."""

    policy: str | None = Field(None, description="recovery policy, where there is a choice: paper or keyed")
    gate: bool = Field(False, description="whether the physics gate stands in front")
    fit: dict[str, float | int | list[int]] = Field({}, description="figures of training, by name")


class DetectorConfig(Config):
    """A trained detector in its two profiles; one without a file in configs/detectors has the defaults."""

    name: str = Field(description="entry point of the group mavfi.detectors")
    paper: ProfileSettings = Field(ProfileSettings(), description="as the paper's")
    tuned: ProfileSettings = Field(ProfileSettings(gate=True), description="limits by field and regime")
    options: dict[str, Any] = Field({}, description="arguments of the class, where nothing is trained")
    mission: dict[str, Any] = Field({}, description="keys of a mission that go with it, where these are not chosen")


class NoDetector(Chain):
    """Never raises an alarm."""


_METHODS = {"start": "", "check": "state, time_us", "accept": "state, time_us"}
"""Parameters of a detector's methods."""


def detector_names() -> list[str]:
    """Every name accepted by `load_detector`."""
    return sorted(known(GROUP, _SHIPPED))


def is_named(name: str, source: str) -> bool:
    """Whether a detector is the one that raises alarms as `source`, or a named configuration of it.

    Example: `recommended` is a configuration of `acceptance`.
    """
    places = known(GROUP, _SHIPPED)
    return name == source or (name in places and places[name] == places.get(source))


def contains(name: str, profile: str, source: str) -> bool:
    """Whether a detector has a part that raises alarms as `source`: itself, or the physics gate in front of it."""
    if source != GATE:
        return is_named(name, source)
    return hasattr(load_object("detector", name, GROUP, _SHIPPED), "model_kind") and settings_of(name, profile).gate


def trainable() -> dict[str, Any]:
    """Detectors with training, by name: those of mavfi, then those of other packages."""
    every = {name: load_object("detector", name, GROUP, _SHIPPED) for name in _SHIPPED | known(GROUP, _SHIPPED)}
    return {name: found for name, found in every.items() if hasattr(found, "model_kind") and hasattr(found, "fit")}


def of_monitored_fields() -> dict[str, Any]:
    """Detectors fitted to a monitored set, in two profiles."""
    return {name: found for name, found in trainable().items() if not _watches_all(found)}


def of_all_fields(extras: Collection[str] = ()) -> dict[str, Any]:
    """Detectors fitted to all fields, in one profile; those that need an extra only for the given `extras`."""
    wanted = ("", *extras)
    every = trainable().items()
    return {name: found for name, found in every if _watches_all(found) and getattr(found, "extra", "") in wanted}


def _watches_all(factory: Any) -> bool:  # noqa: ANN401
    return bool(getattr(factory, "watches_all", False))


def check_detector(name: str, profile: str) -> None:
    """Check the names of a detector and its profile, without importing it; `package:Class` passes.

    Raises:
        BadInputError: There is no such detector or profile.
    """
    settings_of(name, profile)
    if ":" not in name and name not in (every := detector_names()):
        text = f"not known{hint(name, every)}; allowed: {', '.join(every)}, or package:object"
        raise BadInputError(f"detector {name!r}: {text}")


def settings_of(name: str, profile: str) -> ProfileSettings:
    """Settings of a detector in a profile.

    Raises:
        BadInputError: Unknown profile, or the detector's file cannot be read.
    """
    if profile not in PROFILES:
        raise BadInputError(f"detector profile {profile!r}: not known; allowed: {', '.join(PROFILES)}")
    found: ProfileSettings = getattr(_config_of(name), profile)
    return found


def mission_keys(detector: str | Detector) -> Mapping[str, Any]:
    """Mission keys that a detector sets by default: recovery from its alarms, and the restart policy of nodes.

    Those of its file in configs/detectors; of one outside of mavfi, its class attribute `recovery` and `OF_OWN`.

    Raises:
        BadInputError: The attribute has other keys than `OF_RECOVERY`.
    """
    found: Any = detector
    if isinstance(detector, str):
        if not detector or detector in _SHIPPED or detector in names("detectors"):
            return _config_of(detector).mission
        try:
            found = load_object("detector", detector, GROUP, _SHIPPED)
        except BadInputError:  # reported where the detector is constructed
            return {}
    keys = getattr(found, "recovery", {})
    if not isinstance(keys, Mapping) or not set(keys) <= set(OF_RECOVERY):
        name = detector if isinstance(detector, str) else type(detector).__name__
        raise BadInputError(f"detector {name!r}: recovery: {keys!r}: allowed: values of {', '.join(OF_RECOVERY)}")
    return keys if getattr(found, "__module__", "").startswith("mavfi.") else {**OF_OWN, **keys}


def detector_options(name: str) -> Mapping[str, Any]:
    """Constructor arguments of a detector without training."""
    return _config_of(name).options


@cache
def _config_of(name: str) -> DetectorConfig:
    return shipped("detectors", DetectorConfig, name) if name in names("detectors") else DetectorConfig(name=name)


def load_detector(
    name: str, profile: str, models_dir: Path | None, fits: Mapping[str, Any], *, policy: str | None = None,
    gate: bool | None = None, sigmas: float | None = None, trained_for: str = "",
) -> tuple[Detector, str]:  # fmt: skip
    """A detector, ready to fly.

    Args:
        name: One of `detector_names()`, or "package:Class".
        profile: "paper" or "tuned".
        models_dir: Folder of trained models; None = the shipped ones.
        fits: What the model must have been trained for: `stack` (the autopilot profile), platform, v_max (m/s),
            planner.  Optional: `limits`, the `MissionLimits` for rules, whose arena is also used by the physics gate;
            `seed` of the mission, for random draws.
        policy: Recovery policy, overrides the profile's.
        gate: Whether the physics gate checks first; None = as the profile says.
        sigmas: Overrides the paper's n of the model.
        trained_for: "autopilot/platform" whose model is used, whether or not it fits; "" = that of `fits`.

    Returns:
        The detector, and the sha256 of its trained model ("" if it has none).

    Raises:
        BadInputError: Unknown detector, profile or model, no model for `trained_for`, or limits are needed but absent.
        SpecMismatchError: The model was trained for another configuration.
        NotInstalledError: A package that the detector needs is absent.
    """
    settings = settings_of(name, profile)
    if name == "none":
        return NoDetector(), ""
    factory = load_object("detector", name, GROUP, _SHIPPED)
    if hasattr(factory, "check_installed"):
        factory.check_installed()
    if _watches_all(factory):
        profile, settings = ONLY_PROFILE, settings_of(name, ONLY_PROFILE)
    kind = getattr(factory, "model_kind", None)
    limits: MissionLimits | None = fits.get("limits")
    if kind is None:
        return _build(name, factory, *_needed(name, factory, fits), **_config_of(name).options), ""
    if trained_for:
        own = dict(zip(("stack", "platform"), trained_for.split("/"), strict=True))
    else:
        own = {key: fits[key] for key in FITTED_TO}
    path = (models_dir or SHIPPED_MODELS) / f"{model_name(own['stack'], own['platform'], str(kind), profile)}.json"
    if trained_for and not is_file(path):
        raise BadInputError(
            f"trained_for: {trained_for!r}: there is no model {_shown(path)}; allowed: those of a model"
        )
    model = _load_model(path, str(kind), profile, "--baselines " if getattr(factory, "extra", "") else "")
    check_fits(model, **own)
    try:
        detector = _build(name, factory, model, policy=policy or settings.policy, sigmas=sigmas)
    except BadInputError as error:
        raise BadInputError(f"{path}: {error}") from None
    if settings.gate if gate is None else gate:
        detector = Chain(PhysicsGate(float(fits["v_max"]), UNKNOWN_ARENA if limits is None else limits.arena), detector)
    return detector, model.sha256


def _load_model(path: Path, kind: str, profile: str, option: str) -> Model:
    if not path.parent.is_dir():
        raise BadInputError(f"{path.parent}: there is no such folder of models")
    if not is_file(path):
        raise SpecMismatchError(
            f"{_shown(path)}: no model is trained for this autopilot and platform; train one (mavfi train {option}"
            "--autopilot ... --platform ... --out FOLDER), then name the folder with --models; "
            "or take that of another mission, key trained_for"
        )
    model = Model.load(path)
    if (model.kind, model.profile) != (kind, profile):
        raise BadInputError(f"{path}: is a model {model.kind}-{model.profile}; needed: {kind}-{profile}")
    return model


def _shown(path: Path) -> str:
    return path.name if path.parent == SHIPPED_MODELS else str(path)


def _needed(name: str, factory: Any, fits: Mapping[str, Any]) -> list[Any]:  # noqa: ANN401
    needed = [key for key in ("limits", "seed") if getattr(factory, f"needs_{key}", False)]
    for key in needed:
        if fits.get(key) is None:
            raise BadInputError(f"detector {name!r}: needs the {key} of the mission")
    return [fits[key] for key in needed]


def _build(name: str, factory: Any, *arguments: object, **options: object) -> Detector:  # noqa: ANN401
    given = {key: value for key, value in options.items() if value is not None}
    unknown = set(given) - set(parameters_of("detector", name, factory))
    if unknown:
        raise BadInputError(f"detector {name!r}: has no option {', '.join(sorted(unknown))}")
    made = build("detector", name, factory, *arguments, needs=_METHODS, **given)
    check_states(made)
    return cast(Detector, made)
