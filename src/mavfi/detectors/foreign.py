"""GAD and AAD for the numbers of any program: same classes and arithmetic, with scales learned from the data.

Units of such numbers are unknown, so the zero threshold of the code is learned as well: for the profile `paper`, which
subtracts codes of values, an eighth of the largest magnitude; for `tuned`, which codes differences, half of the
largest difference.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.detectors.features import Events
from mavfi.detectors.model import Model
from mavfi.detectors.preprocess import Preprocessor
from mavfi.detectors.registry import detector_class, figures_of, of_monitored_fields, trainable
from mavfi.detectors.training import join, sample_of
from mavfi.errors import BadInputError
from mavfi.states import Field, Stage, State, StateSpec

SMALLEST_SAMPLE = 50
"""Messages required of each source."""
_SMALLEST_EXPONENT = -1000
"""Smallest exponent threshold of a code."""
_LARGEST_EXPONENT = 1000
"""Largest exponent threshold of a code."""
_BELOW = {"paper": 3, "tuned": 1}
"""Octaves between the code threshold and the largest magnitude or difference."""
_BELOW_CONSTANT = 20
"""Octaves between the assumed difference of a field that never changes and its magnitude."""


def foreign_spec(name: str, fields: Sequence[str]) -> StateSpec:
    """State specification for numbers that a source publishes together."""
    return StateSpec(name, "", Stage.SENSOR, "", tuple(Field(field, "f8", "-") for field in fields))


def foreign_state(spec: StateSpec, values: Sequence[float]) -> State:
    """One publication of such a state."""
    header = np.array(values, np.float64).view(spec.header_dtype)
    return State(spec, header, np.zeros(0, spec.element_dtype))


def learn(
    kind: str,
    profile: str,
    recordings: Sequence[Sequence[State]],
    specs: Mapping[str, StateSpec],
    differenced: Collection[str] = (),
) -> Detector:
    """A detector of a kind in `trainable()`, fitted to normal publications of these states.

    The publications of each recording are in order; differences are taken within a recording only.  Of the fields
    `differenced` ("state.field") the difference is coded in both profiles: codes of angles would depend on the turns.

    Raises:
        BadInputError: Unknown kind, too few publications of a source, or a number that is not finite.
    """
    classes: Mapping[str, Any] = of_monitored_fields()
    if kind not in classes:
        factory = detector_class(kind)
        if not hasattr(factory, "of_messages"):
            raise BadInputError(f"detector {kind!r}: is not fitted to messages; allowed: {', '.join(trainable())}")
        _check_sample(recordings, specs)
        of_messages: Detector = factory.of_messages(recordings, specs, figures_of(kind, "tuned"))
        return of_messages
    thresholds: list[int] = []
    for spec in specs.values():
        states_by_recording = [[state for state in states if state.spec is spec] for states in recordings]
        thresholds += _thresholds(spec, states_by_recording, profile, differenced)
    preprocessor = Preprocessor.of(specs, profile, thresholds, differenced)
    order = {name: slot for slot, name in enumerate(specs)}
    sample = join([sample_of(_events(states, order), preprocessor) for states in recordings if states])
    factory = classes[kind]
    parameters = factory.fit(sample, preprocessor, figures_of(kind, profile))
    detector: Detector = factory(Model(kind, profile, "", "", parameters, {}), preprocessor=preprocessor)
    return detector


def _check_sample(recordings: Sequence[Sequence[State]], specs: Mapping[str, StateSpec]) -> None:
    """Refuse sources with too few publications."""
    for spec in specs.values():
        count = sum(state.spec is spec for states in recordings for state in states)
        if count < SMALLEST_SAMPLE:
            raise BadInputError(f"training: {count} messages of {spec.name}; allowed: {SMALLEST_SAMPLE} or more")


def _events(states: Sequence[State], order: Mapping[str, int]) -> Events:
    """Publications as one recorded flight, given the slot of each state."""
    contents = [state.header.tobytes() for state in states]
    slots = np.array([order[state.spec.name] for state in states], np.int64)
    return Events(slots, np.cumsum([len(part) for part in contents]), np.frombuffer(b"".join(contents), np.uint8))


def _thresholds(
    spec: StateSpec, recordings: Sequence[Sequence[State]], profile: str, differenced: Collection[str]
) -> list[int]:
    """Exponent thresholds of the codes of a state's fields, from its publications by recording."""
    count = sum(map(len, recordings))
    if count < SMALLEST_SAMPLE:
        raise BadInputError(
            f"training: {count} messages of {spec.name}; allowed: {SMALLEST_SAMPLE} or more that are normal"
        )

    # All values, and their changes within each recording.
    tables = [np.array([state.header[0].item() for state in states]) for states in recordings if states]
    values = np.concatenate(tables)
    if not np.isfinite(values).all():
        field = spec.header[int(np.argwhere(~np.isfinite(values))[0, 1])].name
        raise BadInputError(f"training: {spec.name} {field}: holds numbers that are not finite; leave this field out")
    with np.errstate(over="ignore"):
        changes = np.concatenate([np.diff(table, axis=0) for table in tables])
        is_coded = np.array([profile == "paper" and f"{spec.name}.{f.name}" not in differenced for f in spec.header])
        largest = np.where(is_coded, np.abs(values).max(axis=0), np.abs(changes).max(axis=0, initial=0.0))
    largest = np.minimum(largest, np.finfo(np.float64).max)  # a difference may have overflowed

    # Below the largest number that is coded; for a field that never changes, far below its value.
    largest_values = np.abs(values).max(axis=0)
    exponents = np.where(largest > 0, np.frexp(largest)[1] - 1, np.frexp(largest_values)[1] - 1 - _BELOW_CONSTANT)
    octaves = np.where(is_coded, _BELOW["paper"], _BELOW["tuned"])
    return [int(exponent) for exponent in np.clip(exponents - octaves, _SMALLEST_EXPONENT, _LARGEST_EXPONENT)]
