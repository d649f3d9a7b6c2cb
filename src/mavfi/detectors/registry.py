"""Detectors by name: the two of the paper, the acceptance test, those of other packages, and `package:Class`."""

from collections.abc import Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from mavfi.config import Config, names, shipped
from mavfi.detectors.detector import Chain, Detector, custom_parts, part_of, require_detector
from mavfi.detectors.gate import SOURCE as GATE
from mavfi.detectors.gate import UNKNOWN_ARENA, PhysicsGate
from mavfi.detectors.model import FITTED_TO, Model, check_fits, model_name
from mavfi.detectors.preprocess import FEATURES, PROFILES
from mavfi.detectors.training import MonitoredFields, TrainedDetector
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, SpecMismatchError, hint, not_known
from mavfi.files import is_file
from mavfi.mission import RECOVERY
from mavfi.plugins import build, known, load_object, without_class
from mavfi.states import DETECTORS, INJECTABLE, PLANNERS, unknown

GROUP = "mavfi.detectors"
"""Entry points of this group are classes that inherit `Detector`; `mavfi train` fits those that inherit
`TrainedDetector`, with the figures of configs/detectors/<name>.yaml."""
OF_RECOVERY = (*RECOVERY, "dead_node", "alarm", "epoch_liveness")
"""Mission keys that a detector may set (`Detector.recovery`)."""
OF_OWN: Mapping[str, Any] = {"grain": "kernel", "same_twice": "limit"}
"""Mission keys of a detector that is not part of mavfi, unless it sets them: it may raise alarms without end."""
SHIPPED_MODELS = Path(__file__).parents[1] / "data" / "models"
"""Folder of the models that are part of mavfi."""
_SHIPPED = {
    "gaussian": "mavfi.detectors.gaussian:GaussianDetector",
    "autoencoder": "mavfi.detectors.autoencoder:AutoencoderDetector",
    "acceptance": "mavfi.detectors.acceptance:AcceptanceTest",
    "recommended": "mavfi.detectors.acceptance:AcceptanceTest",
    "none": "mavfi.detectors.detector:NoDetector",
}
"""Detectors of the core, by name."""
_METHODS = {"start": "", "check": "state, time_us", "accept": "state, time_us"}
"""Parameters of a detector's methods."""


class DetectorConfig(Config):
    """A detector: its options, its presets, and what goes with it; one without a file has the defaults."""

    name: str = Field(description="entry point of the group mavfi.detectors")
    options: dict[str, Any] = Field({}, description="arguments of the class; an arm may set others")
    presets: dict[str, dict[str, Any]] = Field(
        {"paper": {"features": "code", "gate": False}, "tuned": {"features": "predicted", "gate": True}},
        description="of a detector of monitored fields: options by profile",
    )
    fit: dict[str, dict[str, float | int | list[int]]] = Field(
        {}, description="figures of training, by profile of the model"
    )
    mission: dict[str, Any] = Field({}, description="keys of a mission that go with it, where these are not chosen")


class Loaded(NamedTuple):
    """A detector, ready to fly, and the sha256 of its trained model ("" if it has none)."""

    detector: Detector
    model: str


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
    factory = detector_class(name)
    return _is_trained(factory) and bool(_options_of(name, profile, factory, {}).get("gate", False))


def trainable() -> dict[str, type[TrainedDetector]]:
    """Detectors with training, by name, shipped ones first."""
    every = {name: detector_class(name) for name in _SHIPPED | known(GROUP, _SHIPPED)}
    return {name: kind for name, kind in every.items() if _is_trained(kind)}


def of_monitored_fields() -> dict[str, type[TrainedDetector]]:
    """Detectors fitted to a monitored set, in two profiles."""
    return {name: factory for name, factory in trainable().items() if _has_presets(factory)}


def check_detector(name: str, profile: str) -> None:
    """Check the names of a detector and its profile, without importing it; `package:Class` passes.

    Raises:
        BadInputError: There is no such detector or profile.
    """
    _check_profile(profile)
    every = detector_names()
    if ":" not in name and name not in every:
        unknown_name = f"detector {not_known(name, every, 'or package:Class')}{without_class(name)}"
        raise BadInputError(dropped_name("detectors", name) or unknown_name)


def check_kernel(
    kernel: str, planner: str, detector: Detector | None = None, targets: Collection[str] = tuple(INJECTABLE)
) -> None:
    """Check that a kernel, or detector, of mavfi can be injected in a mission with this planner and detector.

    Args:
        kernel: Its name.
        planner: Name of the planner.
        detector: The detector; None = none.
        targets: What can be injected in this mission, for messages.

    Raises:
        BadInputError: The kernel is unknown, is a planner that the mission does not use, or is a detector that does not
            monitor the mission.
    """
    if kernel in DETECTORS:
        check_watched(kernel, detector)
        return
    if dropped_name("kernels", kernel):
        raise BadInputError(dropped_name("kernels", kernel))
    if kernel not in INJECTABLE:
        configured = next((source for source in DETECTORS if is_named(kernel, source)), "")
        if configured:
            why = f"is a configuration of {configured!r}, whose instructions can be injected"
            raise BadInputError(f"kernel {kernel!r}: {why}; allowed: {', '.join(targets)}")
        raise BadInputError(unknown("kernel", kernel, targets))
    if kernel in PLANNERS and kernel != planner:
        raise BadInputError(f"kernel {kernel!r}: the planner of this mission is {planner!r}; allowed: planner {kernel}")


def check_watched(target: str, detector: Detector | None) -> None:
    """Check that a detector is part of a flight with `detector`; `BadInputError` if not."""
    if part_of(detector, target) is not None:
        return
    if target not in DETECTORS:
        raise BadInputError(f"kernel {target!r}: is not part of this mission; allowed: with a detector")
    names = []
    for name in detector_names():
        profiles = [profile for profile in PROFILES if contains(name, profile, target)]
        if profiles:
            names.append(name)
            if PROFILES[0] not in profiles:
                names[-1] += f" (profile {profiles[0]})"
    raise BadInputError(f"kernel {target!r}: is not part of this mission; allowed: with {', '.join(names)}")


def mission_keys(detector: str | Detector) -> Mapping[str, Any]:
    """Mission keys that a detector sets by default: recovery from its alarms, and the restart policy of nodes.

    Those of its file in configs/detectors; of one outside of mavfi, its class attribute `recovery` and `OF_OWN`.

    Raises:
        BadInputError: The attribute has other keys than `OF_RECOVERY`, or the class does not inherit `Detector`.
    """
    if isinstance(detector, str):
        if not detector or detector in _SHIPPED or detector in _configs():
            return _config_of(detector).mission
        try:
            factory = detector_class(detector)
        except BadInputError:  # reported where the detector is constructed
            return {}
        keys = getattr(factory, "recovery", {})
        name = detector
    else:
        factory = type(detector)
        keys = detector.recovery
        name = factory.__name__
    if not isinstance(keys, Mapping) or not set(keys) <= set(OF_RECOVERY):
        raise BadInputError(f"detector {name!r}: recovery: {keys!r}: allowed: values of {', '.join(OF_RECOVERY)}")
    if factory.__module__.startswith("mavfi."):
        return keys
    return {**OF_OWN, **keys}


def detector_options(name: str) -> Mapping[str, Any]:
    """Constructor arguments of a detector that its file sets, whatever the profile."""
    return _config_of(name).options


def figures_of(name: str, profile: str) -> Mapping[str, Any]:
    """Figures of training of a detector, for a model of this profile."""
    return _config_of(name).fit.get(profile, {})


def load_detector(
    name: str,
    profile: str,
    models_dir: Path | None,
    mission: Mapping[str, Any],
    *,
    options: Mapping[str, Any] | None = None,
    trained_for: str = "",
) -> Loaded:
    """A detector, ready to fly.

    Args:
        name: One of `detector_names()`, or "package:Class".
        profile: Preset of the options of a detector of monitored fields: "paper" or "tuned".
        models_dir: Folder of trained models; None = the shipped ones.
        mission: What the model must have been trained for: `stack` (the autopilot profile), platform, v_max (m/s),
            planner.  Optional: `limits`, the `MissionLimits` for rules, whose arena is also used by the physics gate;
            `seed`, for random draws.
        options: Arguments of the class, over those of its file and preset.  Those of every trained detector: `gate`,
            whether the physics gate checks first; of one of monitored fields: `features`, see `FEATURES`.
        trained_for: "autopilot/platform" whose model is used, whether or not it fits; "" = that of `mission`.

    Raises:
        BadInputError: Unknown detector, profile, option or model, no model for `trained_for`, or what the constructor
            needs of the mission is absent.
        SpecMismatchError: The model was trained for another configuration.
    """
    _check_profile(profile)
    factory = detector_class(name)
    chosen = _options_of(name, profile, factory, options or {})
    if not _is_trained(factory):
        of_mission = {key: mission.get(key) for key in ("limits", "seed")}
        return Loaded(_build(name, factory, of_mission, chosen), "")

    # Options that choose the model and the gate; the rest are arguments of the class.
    has_gate = chosen.pop("gate", False)
    model_profile = factory.training.profiles[0]
    features = None
    if _has_presets(factory):
        features = chosen.pop("features", None)
    if features is not None:
        if features not in FEATURES:
            raise BadInputError(f"detector {name!r}: features: {not_known(features, FEATURES)}")
        model_profile = FEATURES[features]

    path, model = _model_of(factory, model_profile, models_dir, mission, trained_for)
    try:
        detector = _build(name, factory, {"model": model}, chosen)
    except BadInputError as error:
        raise BadInputError(f"{path}: {error}") from None
    if has_gate:
        limits = mission.get("limits")
        arena = UNKNOWN_ARENA
        if limits is not None:
            arena = limits.arena
        detector = Chain(PhysicsGate(float(mission["v_max"]), arena), detector)
    return Loaded(detector, model.sha256)


def _model_of(
    factory: type[TrainedDetector], profile: str, models_dir: Path | None, mission: Mapping[str, Any], trained_for: str
) -> tuple[Path, Model]:
    """The model of a detector that fits the mission, or is that of `trained_for`, and its file."""
    if trained_for:
        fitted_to = dict(zip(("stack", "platform"), trained_for.split("/"), strict=True))
    else:
        fitted_to = {key: mission[key] for key in FITTED_TO}
    name = model_name(fitted_to["stack"], fitted_to["platform"], factory.model_kind, profile)
    path = (models_dir or SHIPPED_MODELS) / f"{name}.json"
    shown = str(path)
    if models_dir is None:
        shown = path.name
    if not path.parent.is_dir():
        raise BadInputError(f"{path.parent}: there is no such folder of models")
    if not is_file(path):
        if trained_for:
            ending = f"-{factory.model_kind}-{profile}"
            stems = [model.stem for model in sorted(path.parent.glob(f"*{ending}.json"))]
            trained = [stem.removesuffix(ending).replace("-", "/", 1) for stem in stems]
            raise BadInputError(f"trained_for: {not_known(trained_for, trained)}")
        raise SpecMismatchError(
            f"{shown}: no model is trained for this autopilot and platform; train one (mavfi train "
            "--autopilot ... --platform ... --out FOLDER), then name the folder with --models; "
            "or take that of another mission (--trained-for, key trained_for)"
        )
    model = Model.load(path)
    if (model.kind, model.profile) != (factory.model_kind, profile):
        needed = f"{factory.model_kind}-{profile}"
        raise BadInputError(f"{path}: is a model {model.kind}-{model.profile}; needed: {needed}")
    check_fits(model, **fitted_to)
    return path, model


def _check_profile(profile: str) -> None:
    """Refuse an unknown profile."""
    if profile not in PROFILES:
        raise BadInputError(f"detector profile {not_known(profile, PROFILES)}")


def detector_class(name: str) -> Any:  # noqa: ANN401 - a class, or a function of a user's own
    """The class of a detector by name, imported; `BadInputError` if there is none."""
    return load_object("detector", name, GROUP, _SHIPPED)


def _is_trained(factory: Any) -> bool:  # noqa: ANN401
    """Whether it is a class that `mavfi train` fits."""
    return isinstance(factory, type) and issubclass(factory, TrainedDetector)


def _has_presets(factory: Any) -> bool:  # noqa: ANN401
    """Whether it is a detector of monitored fields, whose options depend on the profile."""
    return _is_trained(factory) and isinstance(factory.training, MonitoredFields)


def _options_of(name: str, profile: str, factory: Any, options: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ANN401
    """Options of a detector: those of its file, over them its preset, over them the given ones."""
    config = _config_of(name)
    chosen = dict(config.options)
    if _has_presets(factory):
        chosen |= config.presets.get(profile, {})
    return chosen | dict(options)


def _config_of(name: str) -> DetectorConfig:
    """The file of a detector in configs/detectors, or the defaults."""
    return _configs().get(name) or DetectorConfig(name=name)


@cache
def _configs() -> dict[str, DetectorConfig]:
    """The files in configs/detectors, by name of the detector."""
    return {name: shipped("detectors", DetectorConfig, name) for name in names("detectors")}


def _build(
    name: str,
    factory: Any,
    of_mission: Mapping[str, Any],
    options: Mapping[str, Any],  # noqa: ANN401
) -> Detector:
    """Construct a detector with what it takes from the mission, and its options; None = the default of the class."""
    chosen = {key: value for key, value in options.items() if value is not None}
    instance = build("detector", name, factory, needs=_METHODS, of_mission=of_mission, **chosen)
    detector = require_detector(instance)
    # The inherited check never raises an alarm: in a user's own class, its name is misspelled.
    if ":" in name and type(detector).check is Detector.check and not (detector.parts or detector.duplicates):
        methods = [method for method in vars(type(detector)) if not hasattr(Detector, method)]
        raise BadInputError(
            f"detector {name!r}: lacks check{hint('check', methods)}; allowed: with check(state, time_us)"
        )
    for part in custom_parts(detector):
        part.requested_as = name
    return detector
