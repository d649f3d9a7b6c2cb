"""Fits trained detectors to recorded error-free flights."""

from collections.abc import Collection, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.detectors.model import FITTED_TO, Model
from mavfi.detectors.preprocess import PREDICTIONS, PROFILES, Preprocessor
from mavfi.detectors.recorder import Recording
from mavfi.detectors.registry import ONLY_PROFILE, figures_of, of_all_fields, of_monitored_fields
from mavfi.detectors.samples import check_finite, collect, join
from mavfi.errors import BadInputError
from mavfi.extras.bench.field_codes import MONITORED, Codes, FieldCodes, sample_of

_VELOCITY = ("vx", "vy", "vz")


def fit(
    recordings: Sequence[Recording],
    provenance: Mapping[str, Any],
    monitored: str = "paper-13",
    extras: Collection[str] = (),
    only: Collection[tuple[str, str]] | None = None,
) -> dict[str, Model]:
    """Fit all trainable detectors: those of monitored fields in both profiles, those of all fields in one.

    Args:
        recordings: Error-free flights, 100 or more for stable thresholds; with or without codes of all fields.
        provenance: Origin of the flights: `stack` (the autopilot profile), platform, v_max, planner, and further keys
            (seeds, flights).
        monitored: Name of the set of monitored fields.
        extras: Include detectors that need packages of these extras: "bench".
        only: Detectors to fit, as (name, profile); None = all.  A model does not depend on the others.

    Returns:
        Models by "<kind>-<profile>".  Identical recordings give identical models.

    Raises:
        BadInputError: The recordings lack publications, or hold numbers that are not finite.
    """
    missing = [key for key in FITTED_TO if key not in provenance]
    if missing:
        raise BadInputError(f"provenance of a model: lacks {', '.join(missing)}")
    prediction, errors = best_prediction(recordings)
    origin = {**provenance, "versions": {name: version(name) for name in ("numpy", "scikit-learn")}}
    models = fit_all_fields(recordings, origin, extras, only)
    for profile in PROFILES:
        wanted = {name: one for name, one in of_monitored_fields().items() if only is None or (name, profile) in only}
        if not wanted:
            continue
        preprocessor = Preprocessor(monitored, profile, prediction)
        sample = collect(recordings, preprocessor)
        model_origin = origin if profile == "paper" else {**origin, "innovation_m": errors}
        for name, detector in wanted.items():
            parameters = detector.fit(sample, preprocessor, figures_of(name, profile))
            kind = detector.model_kind
            models[f"{kind}-{profile}"] = Model(kind, profile, monitored, prediction, parameters, model_origin)
    return models


def fit_all_fields(
    recordings: Sequence[Recording], origin: Mapping[str, Any], extras: Collection[str] = (),
    only: Collection[tuple[str, str]] | None = None,
) -> dict[str, Model]:  # fmt: skip
    """Fit the detectors of all fields; none if the recordings lack their codes.  Arguments as for `fit`."""
    wanted = {
        name: detector
        for name, detector in of_all_fields(extras).items()
        if only is None or (name, ONLY_PROFILE) in only
    }
    if not wanted:
        return {}
    found = [Codes(recording.slots, recording.regimes, recording.codes) for recording in recordings]
    if not all(len(codes.slots) for codes in found):
        return {}
    field_codes = FieldCodes(origin["stack"])
    sample = join([sample_of(codes, field_codes) for codes in found])
    check_finite(sample)
    models = {}
    for name, detector in wanted.items():
        parameters = detector.fit(sample, field_codes, figures_of(name, ONLY_PROFILE))
        kind = detector.model_kind
        models[kind] = Model(kind, ONLY_PROFILE, MONITORED, "", parameters, dict(origin))
    return models


def save(models: Mapping[str, Model], folder: Path) -> list[Path]:
    """Write every model into a folder.

    Raises:
        BadInputError: The folder cannot be written.
    """
    return [model.save(folder) for model in models.values()]


def innovations(recording: Recording) -> dict[str, np.ndarray]:
    """By prediction, errors (m) of way-points predicted from the previous one of the same trajectory. Shape (k, 3)."""
    _, headers = recording.headers("planning.waypoint")
    position, velocity = (np.stack([headers[name] for name in names], 1) for names in (("x", "y", "z"), _VELOCITY))
    same = headers["trajectory_seq"][1:] == headers["trajectory_seq"][:-1]
    step = np.diff(position, axis=0)
    mean = (velocity[1:] + velocity[:-1]) / 2.0
    duration = headers["duration"][1:, None]
    return {"interval": (step - velocity[1:] * duration)[same], "trapezoid": (step - mean * duration)[same]}


def best_prediction(recordings: Sequence[Recording]) -> tuple[str, dict[str, dict[str, float]]]:
    """Best-fitting key of `preprocess.PREDICTIONS`; by prediction, the 99 % quantile and the largest error (m)."""
    found = [innovations(recording) for recording in recordings]
    fits = {}
    for name in PREDICTIONS:
        errors = np.abs(np.concatenate([part[name].ravel() for part in found] or [np.zeros(0)]))
        if len(errors) == 0:
            raise BadInputError("training: the recordings hold no trajectory of two way-points")
        fits[name] = {"p99": float(np.quantile(errors, 0.99)), "max": float(errors.max())}
    return min(fits, key=lambda name: fits[name]["p99"]), fits
