"""Data preprocessing (MAVFI section IV-B) in two profiles: watched fields, their deltas, and the base of their scorers.

`paper`: sign and exponent of a float64 as a 16-bit code, then the difference from the last code.  `tuned`: code of the
float64 difference from the prediction.  Integers: difference, saturated to 16 bits.
"""

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.scoring import Reading, Scorer, Threshold, checked_name, score_of
from mavfi.errors import BadInputError
from mavfi.numerics.jit import entry, is_compiled, kernel_jit
from mavfi.numerics.stored import Stored
from mavfi.states import MONITORED_SETS, ODOMETRY, STATES, State, StateSpec, bytes_of

FEATURES = {"code": "paper", "predicted": "tuned"}
"""What a detector compares, with its spelling as the profile of a model: the codes of values, or the code of the
difference from a prediction."""
PROFILES = tuple(FEATURES.values())
"""Profiles of models, see `FEATURES`."""
PREDICTIONS = {"interval": features.CODE_OF_INTERVAL, "trapezoid": features.CODE_OF_TRAPEZOID}
"""Prediction of a way-point's position, see `features.measure`: "interval" if way-points carry the mean velocity of the
leg that leads to them, "trapezoid" if they carry the velocity at their position."""

# Exponent thresholds of codes: magnitudes below 2^threshold, in the field's SI unit, have the code of zero.
_BELOW_ONE = 0
"""Of the time to collision: 1 s."""
_BELOW_HALF = -1
"""Of positions in the profile "paper": 0.5 m."""
_BELOW_QUARTER = -2
"""Of all other fields in the profile "paper"."""
_BELOW_EIGHTH = -3
"""Of all other fields in the profile "tuned"."""
_VELOCITY_OF_POSITION = {"x": "vx", "y": "vy", "z": "vz"}
"""Velocity of each position in a way-point."""
_PREDICTED_STATE = "planning.waypoint"
"""The state whose positions are predicted."""
_MAX_QUEUED = 100
"""Largest number of publications of odometry queued; older ones are forgotten."""
_UNPICKLED = ("_judge", "_stored", "_address")
"""Attributes with machine code or addresses, which are valid in one process only."""


class FieldRow(NamedTuple):
    """A watched field: row of the table `features.OFFSET`; velocity and axis belong to predicted positions only."""

    offset: int
    rule: int
    threshold: int
    velocity_offset: int = -1
    axis: int = 0


class StateRow(NamedTuple):
    """A watched state: row of the table `features.FIRST`; the offsets belong to the way-point only."""

    first: int
    last: int
    trajectory_offset: int = -1
    duration_offset: int = -1


class Preprocessor:
    """Deltas of the watched fields during one flight.

    Attributes:
        fields: Names of the watched fields, "state.field", in the order of the vector.
        stages: Stage of each.
        slots: Index of each watched state, by name.
        predicts: Whether a watched state, by slot, has fields that are predicted from the vehicle's odometry.
        states: States that it reads: the watched ones and, for predictions, the vehicle's odometry.
        watch: Tables and memory.
    """

    def __init__(self, monitored: str, profile: str, prediction: str = "interval") -> None:
        """Build the tables.

        Args:
            monitored: Name of a monitored set.
            profile: "paper" or "tuned".
            prediction: Key of PREDICTIONS; used by `tuned` only.

        Raises:
            BadInputError: Unknown name.
        """
        watched = MONITORED_SETS[checked_name(monitored, MONITORED_SETS, "monitored set")]
        checked_name(profile, PROFILES, "profile")
        checked_name(prediction, PREDICTIONS, "prediction")
        specs = {state: STATES[state] for state, _ in watched}
        self._build_tables(
            specs, watched, [_field_row(STATES[state], field, profile, prediction) for state, field in watched]
        )

    @classmethod
    def of(
        cls,
        specs: Mapping[str, StateSpec],
        profile: str,
        thresholds: Sequence[int],
        differenced: Collection[str] = (),
    ) -> "Preprocessor":
        """Deltas of every field, all float64, of states that are not defined in `mavfi.states`.

        Args:
            specs: States by name.
            profile: "paper" or "tuned".
            thresholds: Exponent threshold of each field's code, see `sign_exponent_code`.
            differenced: Fields, "state.field", of which the difference is coded in both profiles.
        """
        checked_name(profile, PROFILES, "profile")
        watched = tuple((name, field.name) for name, spec in specs.items() for field in spec.header)
        rows = []
        for (state, field), threshold in zip(watched, thresholds, strict=True):
            rule = features.CODE_OF_DELTA
            if profile == "paper" and f"{state}.{field}" not in differenced:
                rule = features.DELTA_OF_CODES
            rows.append(FieldRow(specs[state].offset(field), rule, threshold))
        preprocessor = cls.__new__(cls)
        preprocessor._build_tables(specs, watched, rows)
        return preprocessor

    def _build_tables(
        self,
        specs: Mapping[str, StateSpec],
        watched: tuple[tuple[str, str], ...],
        rows: Sequence[FieldRow],
    ) -> None:
        """Set all attributes, given the watched fields as (state, field) and their rows of the field table."""
        self.fields = tuple(f"{state}.{field}" for state, field in watched)
        self.stages = tuple(specs[state].stage.value for state, _ in watched)
        self.slots = {name: slot for slot, name in enumerate(specs)}
        self._specs = tuple(specs.values())

        # Tables and memory of the compiled functions.
        largest_header = max(spec.header_dtype.itemsize for spec in specs.values())
        self.watch = features.WatchedFields(
            places=np.array([_state_row(spec, watched) for spec in specs.values()], np.int64),
            table=np.array(rows, np.int64),
            memory=np.zeros((len(specs), 2)),
            last=np.zeros((len(specs), largest_header), np.uint8),
            vehicle=np.zeros(features.KNOWN + 1),
        )

        # The rules from `CODE_OF_INTERVAL` on predict a position, the first of a trajectory from the odometry.
        rules = self.watch.table[:, features.RULE]
        ranges = map(self.range_of, range(len(specs)))
        self.predicts = tuple(bool((rules[first:last] >= features.CODE_OF_INTERVAL).any()) for first, last in ranges)
        self.states = frozenset(self.slots)
        if any(self.predicts):
            self.states |= frozenset(ODOMETRY.values())

    @property
    def memory_arrays(self) -> dict[str, np.ndarray]:
        """All arrays of the memory, by name."""
        return {"memory": self.watch.memory, "last": self.watch.last, "vehicle": self.watch.vehicle}

    def arrays(self) -> dict[str, np.ndarray]:
        """The memory, the last publications by state and field."""
        seen = self.watch.memory[:, features.SEEN]
        regime = self.watch.memory[:, features.REGIME]
        memory = {"seen": seen, "regime": regime, "vehicle": self.watch.vehicle}
        for spec, content in zip(self._specs, self.watch.last, strict=True):
            header = content[: spec.header_dtype.itemsize].view(spec.header_dtype)
            memory |= {f"last.{spec.name}.{field.name}": header[field.name] for field in spec.header}
        return memory

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        for array in self.memory_arrays.values():
            array[...] = 0

    def range_of(self, slot: int) -> tuple[int, int]:
        """First and one past the last index of a watched state's fields in the vector."""
        first, last = self.watch.places[slot, : features.LAST + 1]
        return int(first), int(last)

    def slot_of(self, index: int) -> int:
        """Index of the state of a vector element."""
        return int(np.searchsorted(self.watch.places[:, features.LAST], index, side="right"))


@kernel_jit
def conclude(regime: int, table_row: np.ndarray, scratch: features.LastJudgement, limit: np.ndarray) -> float:
    """Score of the distances in `scratch`, also stored there; `table_row` is a row of a place table."""
    scratch.status[features.JUDGED_REGIME] = regime
    reading = Reading(scratch.distance, scratch.unit, table_row[features.FIRST], table_row[features.LAST], regime)
    score = score_of(reading, limit, scratch.ratios)
    scratch.score[0] = score
    return score


class VehicleQueue:
    """Queue of the vehicle's odometry, of which the latest finite header is stored when a prediction needs it.

    Most headers are never needed, since another one arrives before the next prediction.

    Args:
        vehicle: Where position and velocity are stored.

    Attributes:
        store: Compiled: bytes of a header, then `vehicle`; stores position and velocity, and returns whether they are
            finite.
    """

    store: Callable[..., bool]

    def __init__(self, vehicle: Any) -> None:  # noqa: ANN401 - an array, or a tuple of them
        self._vehicle = vehicle
        self._headers: deque[np.ndarray] = deque(maxlen=_MAX_QUEUED)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without machine code, which is valid in one process only."""
        return {name: value for name, value in self.__dict__.items() if name != "store"}

    def add(self, header: np.ndarray) -> None:
        """Queue a header."""
        self._headers.append(header)

    def store_latest(self) -> None:
        """Store the latest header that is finite, and drop all; if none is, what was stored before remains."""
        headers = self._headers
        while headers:
            if self.store(bytes_of(headers.pop()), self._vehicle):
                headers.clear()

    def clear(self) -> None:
        """Drop all queued headers."""
        self._headers.clear()


class DeltaScorer(Scorer):
    """A scorer of the deltas of a preprocessor that watches the fields of the model.

    One compiled call scores a publication and commits the previous one if that was accepted.

    Args:
        preprocessor: Deltas of the watched fields.
        tables: Further tables and memory of the compiled functions.

    Attributes:
        judge: Compiled: bytes and slot of a publication, `features.WatchedFields`, `features.LastJudgement`,
            limits of the threshold, then the tables; returns the score.
        settle: Compiled: commits the publication judged last; same arguments without bytes and slot.
        judge_at: Compiled: `judge` with the address of its tables and of `cached_results`, see `numerics.stored`.
        kind: `kind_of` these.
        cached_results: Results that need not be computed again.
        features: The preprocessor.
        scratch: The publication judged last.
    """

    judge: ClassVar[Callable[..., float]]
    settle: ClassVar[Callable[..., None]]
    judge_at: ClassVar[Callable[..., float]]
    kind: ClassVar[Any]
    cached_results: tuple[Any, ...] = ()

    def __init__(self, preprocessor: Preprocessor, *tables: Any) -> None:  # noqa: ANN401 - arrays, tuples of them, numbers
        self.features = preprocessor
        self.memory_arrays = preprocessor.memory_arrays
        self.fields = preprocessor.fields
        self.stages = preprocessor.stages
        self.states = preprocessor.states
        self._tables: tuple[Any, ...] = tables
        self._slots = preprocessor.slots
        self._uses_prediction = preprocessor.predicts
        self._odometry_states = preprocessor.states.difference(preprocessor.slots)
        self._odometry_queue = VehicleQueue(preprocessor.watch.vehicle)

    def use(self, threshold: Threshold) -> None:
        """Set the threshold; called before the first flight."""
        super().use(threshold)
        # Memory of the compiled functions for one publication, and all of their arguments in the order of `judge`.
        size = len(self.fields)
        self.scratch = features.LastJudgement(
            content=np.zeros(self.features.watch.last.shape[1], np.uint8),
            status=np.zeros(4, np.int64),
            score=np.zeros(1),
            deltas=np.zeros(size, np.int16),
            distance=np.zeros(size),
            unit=np.ones(size),
            ratios=threshold.ratios,
        )
        self._tables = (self.features.watch, self.scratch, threshold.limit, *self._tables)
        self._status = self.scratch.status
        self.instrument({})

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Scorer.compiled`."""
        return {"judge": self.judge}

    def instrument(self, instrumented: Mapping[str, Callable[..., float]]) -> None:
        """Replace `judge` by the function of that name in `instrumented`; restore it if there is none."""
        # The compiled function reads its tables at one address; any other function receives them as arguments.
        judge = instrumented.get("judge", self.judge)
        self._stored = Stored(self.kind, *self._tables, *self.cached_results)
        self._address = self._stored.address
        if is_compiled(judge):
            self._judge: Callable[..., float] = entry(self.judge_at, self.scratch.content, 0, 0)
        else:
            self._judge = lambda content, slot, _: judge(content, slot, *self._tables)
        vehicle = self.features.watch.vehicle
        self._odometry_queue.store = entry(features.note_vehicle, vehicle.view(np.uint8), vehicle)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without machine code, which is valid in one process only."""
        return {name: value for name, value in self.__dict__.items() if name not in _UNPICKLED}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Inverse of `__getstate__`."""
        self.__dict__.update(state)
        self.instrument({})

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        super().start()
        self._forget()

    def _forget(self) -> None:
        """Drop the publication that was judged last, and queued odometry."""
        self.candidate = None
        self.scratch.status[features.ACCEPTED] = 0
        self._odometry_queue.clear()

    def score(self, state: State) -> float | None:
        """Score of a publication."""
        slot = self._slots.get(state.spec.name)
        if slot is None:
            return None
        if self._uses_prediction[slot]:
            self._odometry_queue.store_latest()
        self.candidate = state
        return self._judge(bytes_of(state.header), slot, self._address)

    def last_reading(self) -> Reading:
        """Reading of the publication scored last."""
        scratch = self.scratch
        first, last = self.features.range_of(int(scratch.status[features.SLOT]))
        regime = int(scratch.status[features.JUDGED_REGIME])
        return Reading(scratch.distance, scratch.unit, first, last, regime)

    def accept(self, state: State) -> None:
        """Record a published value."""
        if state is not self.candidate:
            if state.spec.name in self._odometry_states:
                self._odometry_queue.add(state.header)
                return
            if self.score(state) is None:
                return
        self._status[features.ACCEPTED] = 1

    def memory(self) -> tuple[bytes, ...]:
        """Memory between publications."""
        if self.scratch.status[features.ACCEPTED]:
            self.settle(*self._tables)
        self._odometry_queue.store_latest()
        return super().memory()

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name: the arrays themselves, not copies."""
        self.memory()  # commits the publication judged last
        self.candidate = None
        arrays = self.features.arrays()
        for name, array in self.memory_arrays.items():
            if name not in self.features.memory_arrays:
                arrays[name] = array
        return arrays

    def restore(self, memory: tuple[bytes, ...]) -> None:
        """Inverse of `memory`."""
        super().restore(memory)
        self._forget()

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite."""
        first, last = self.features.range_of(self.features.slots[state.spec.name])
        not_finite = features.not_finite(state.header.view(np.uint8), self.features.watch.table[first:last])
        return first + np.flatnonzero(not_finite)


def _state_row(spec: StateSpec, watched: tuple[tuple[str, str], ...]) -> StateRow:
    """Row of the place table for a watched state.

    Raises:
        BadInputError: Fields of another state lie between those of this one.
    """
    fields = [index for index, (state, _) in enumerate(watched) if state == spec.name]
    if fields != list(range(fields[0], fields[-1] + 1)):
        raise BadInputError(f"monitored set: the fields of {spec.name} must be neighbours")
    if spec.name != _PREDICTED_STATE:
        return StateRow(fields[0], fields[-1] + 1)
    return StateRow(fields[0], fields[-1] + 1, spec.offset("trajectory_seq"), spec.offset("duration"))


def _field_row(spec: StateSpec, field: str, profile: str, prediction: str) -> FieldRow:
    """Row of the field table for a watched field."""
    is_position = spec.name == _PREDICTED_STATE and field in _VELOCITY_OF_POSITION
    rule, threshold = _rule_of(spec, field, profile, prediction, is_position=is_position)
    if not is_position:
        return FieldRow(spec.offset(field), rule, threshold)
    velocity_offset = spec.offset(_VELOCITY_OF_POSITION[field])
    axis = list(_VELOCITY_OF_POSITION).index(field)
    return FieldRow(spec.offset(field), rule, threshold, velocity_offset, axis)


def _rule_of(spec: StateSpec, field: str, profile: str, prediction: str, *, is_position: bool) -> tuple[int, int]:
    """Delta rule of a field, and exponent threshold of its code."""
    dtype = spec.find(field).dtype
    if dtype == "i4":
        return features.INTEGER, 0
    if dtype != "f8":
        raise BadInputError(f"monitored set: {spec.name}.{field} is neither float64 nor int32")
    if field == "time_to_collision":
        return features.DELTA_OF_CODES, _BELOW_ONE
    if profile == "paper":
        threshold = _BELOW_QUARTER
        if is_position:
            threshold = _BELOW_HALF
        return features.DELTA_OF_CODES, threshold
    if is_position:
        return PREDICTIONS[prediction], _BELOW_EIGHTH
    if field == "yaw":
        return features.CODE_OF_ANGLE, _BELOW_EIGHTH
    return features.CODE_OF_DELTA, _BELOW_EIGHTH
