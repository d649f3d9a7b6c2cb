"""Data preprocessing (MAVFI section IV-B) in two profiles: watched fields, their deltas, and the base of their scorers.

`paper`: sign and exponent of a float64 as a 16-bit code, then the difference to the last code.  `tuned`: the difference
to what was predicted first, in float64, then its code.  Integers: difference, saturated to 16 bits.
"""

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.parts import Reading, Scorer, Verdict
from mavfi.errors import BadInputError
from mavfi.states import MONITORED_SETS, ODOMETRY, STATES, State, StateSpec

PROFILES = ("paper", "tuned")
PREDICTIONS = {"interval": features.CODE_OF_INTERVAL, "trapezoid": features.CODE_OF_TRAPEZOID}
"""How a way-point's position is predicted, see `features.measure`: "interval" where way-points carry the mean
velocity on the way to them, "trapezoid" where they carry the velocity at their position."""

_HALF_METRE, _QUARTER, _ONE_SECOND, _EIGHTH = -1, -2, 0, -3
_POSITIONS = {"x": "vx", "y": "vy", "z": "vz"}
_PLANNED = "planning.waypoint"


class Preprocessor:
    """Deltas of the watched fields, one flight long.

    Attributes:
        fields: Names of the watched fields, "state.field", in the order of the vector.
        stages: Stage of each.
        slots: Number of each watched state, by name.
        watch: Tables and memory.
    """

    def __init__(self, monitored: str, profile: str, prediction: str = "interval") -> None:
        """Build the tables.

        Args:
            monitored: Name of a monitored set.
            profile: "paper" or "tuned".
            prediction: Key of PREDICTIONS; only `tuned` uses it.

        Raises:
            BadInputError: One of the names is not known.
        """
        watched = MONITORED_SETS[_known(monitored, MONITORED_SETS, "monitored set")]
        _known(profile, PROFILES, "profile")
        _known(prediction, PREDICTIONS, "prediction")
        specs = {state: STATES[state] for state, _ in watched}
        self._fill(specs, watched, [_row(STATES[state], field, profile, prediction) for state, field in watched])

    @classmethod
    def of(cls, specs: Mapping[str, StateSpec], profile: str, thresholds: Sequence[int]) -> "Preprocessor":
        """Deltas of every field of states that are in no table of ours; all of them are float64.

        Args:
            specs: States by name.
            profile: "paper" or "tuned".
            thresholds: Exponent threshold of each field's code, see `sign_exponent_code`.
        """
        rule = features.DELTA_OF_CODES if _known(profile, PROFILES, "profile") == "paper" else features.CODE_OF_DELTA
        watched = tuple((name, field.name) for name, spec in specs.items() for field in spec.header)
        rows = [
            (_offset(specs[state], field), rule, threshold, -1, 0)
            for (state, field), threshold in zip(watched, thresholds, strict=True)
        ]
        made = cls.__new__(cls)
        made._fill(specs, watched, rows)
        return made

    def _fill(
        self, specs: Mapping[str, StateSpec], watched: tuple[tuple[str, str], ...],
        rows: Sequence[tuple[int, int, int, int, int]],
    ) -> None:  # fmt: skip
        self.fields = tuple(f"{state}.{field}" for state, field in watched)
        self.stages = tuple(specs[state].stage.value for state, _ in watched)
        self.slots = {name: slot for slot, name in enumerate(specs)}
        size = max(spec.header_dtype.itemsize for spec in specs.values())
        self.watch = features.Watch(
            places=np.array([_place(spec, watched) for spec in specs.values()], np.int64),
            table=np.array(rows, np.int64),
            memory=np.zeros((len(specs), 2)),
            last=np.zeros((len(specs), size), np.uint8),
            vehicle=np.zeros(features.KNOWN + 1),
        )

    @property
    def kept(self) -> tuple[np.ndarray, ...]:
        """All that is remembered of a flight."""
        return self.watch.memory, self.watch.last, self.watch.vehicle

    def start(self) -> None:
        """Forget the last flight."""
        for part in self.kept:
            part[...] = 0

    def note(self, state: State) -> None:
        """Remember where the vehicle is, if this state says so."""
        if state.spec.name in ODOMETRY.values():
            features.note_vehicle(state.header.view(np.uint8), self.watch.vehicle)

    def range_of(self, slot: int) -> tuple[int, int]:
        """First and one past the last index in the vector of a watched state's fields."""
        first, last = self.watch.places[slot, : features.LAST + 1]
        return int(first), int(last)

    def slot_of(self, index: int) -> int:
        """Number of the state of the field at an index of the vector."""
        return int(np.searchsorted(self.watch.places[:, features.LAST], index, side="right"))


class DeltaScorer(Scorer):
    """A scorer of the deltas of a preprocessor, which has the fields that the model was trained on."""

    def __init__(self, preprocessor: Preprocessor) -> None:
        self.features, self.kept = preprocessor, preprocessor.kept
        self.fields, self.stages = preprocessor.fields, preprocessor.stages
        size = len(self.fields)
        self._deltas = np.zeros(size, np.int16)
        self._distance, self._unit = np.zeros(size), np.ones(size)

    @abstractmethod
    def measure(self, content: np.ndarray, slot: int) -> int:
        """Fill in `_deltas`, `_distance` and, where they are no plain numbers, `_unit`; see `features.measure`."""

    def read(self, state: State) -> Reading | None:
        """Measure a publication."""
        slot = self.features.slots.get(state.spec.name)
        if slot is None:
            return None
        regime = self.measure(state.header.view(np.uint8), slot)
        return Reading(self._distance, self._unit, *self.features.range_of(slot), regime)

    def accept(self, state: State, verdict: Verdict | None) -> None:
        """Take note of a value that was published."""
        slot = self.features.slots.get(state.spec.name)
        if slot is None:
            self.features.note(state)
            return
        content = state.header.view(np.uint8)
        if verdict is not None and self.adapts:
            self.learn(content, slot, verdict)
        features.commit(content, slot, self.features.watch)

    def learn(self, content: np.ndarray, slot: int, verdict: Verdict) -> None:  # noqa: B027 - few learn
        """Adapt to a value that was published, before it becomes the last one; `_deltas` are its own."""

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite."""
        first, last = self.features.range_of(self.features.slots[state.spec.name])
        found = features.not_finite(state.header.view(np.uint8), self.features.watch.table[first:last])
        return first + np.flatnonzero(found)


def _known(name: str, allowed: Collection[str], what: str) -> str:
    if name not in allowed:
        raise BadInputError(f"{what} {name!r}: not known; allowed: {', '.join(allowed)}")
    return name


def _offset(spec: StateSpec, field: str) -> int:
    names = [candidate.name for candidate in spec.header]
    sizes = [np.dtype(candidate.dtype).itemsize for candidate in spec.header]
    return sum(sizes[: names.index(field)])


def _place(spec: StateSpec, watched: tuple[tuple[str, str], ...]) -> tuple[int, int, int, int]:
    own = [index for index, (state, _) in enumerate(watched) if state == spec.name]
    if own != list(range(own[0], own[-1] + 1)):
        raise BadInputError(f"monitored set: the fields of {spec.name} must be neighbours")
    if spec.name != _PLANNED:
        return own[0], own[-1] + 1, -1, -1
    return own[0], own[-1] + 1, _offset(spec, "trajectory_seq"), _offset(spec, "duration")


def _row(spec: StateSpec, field: str, profile: str, prediction: str) -> tuple[int, int, int, int, int]:
    offset = _offset(spec, field)
    position = spec.name == _PLANNED and field in _POSITIONS
    kind = spec.find(field).dtype
    if kind == "i4":
        return offset, features.INTEGER, 0, -1, 0
    if kind != "f8":
        raise BadInputError(f"monitored set: {spec.name}.{field} is neither float64 nor int32")
    if field == "time_to_collision":
        return offset, features.DELTA_OF_CODES, _ONE_SECOND, -1, 0
    if profile == "paper":
        return offset, features.DELTA_OF_CODES, _HALF_METRE if position else _QUARTER, -1, 0
    if position:
        velocity, axis = _offset(spec, _POSITIONS[field]), list(_POSITIONS).index(field)
        return offset, PREDICTIONS[prediction], _EIGHTH, velocity, axis
    return offset, features.CODE_OF_ANGLE if field == "yaw" else features.CODE_OF_DELTA, _EIGHTH, -1, 0
