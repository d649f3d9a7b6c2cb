"""The monitored set `all`: the residuals of every consumed field, as 16-bit codes.

One code is a quantum in the field's unit, too small to matter to a flight: 1 cm, 1 cm/s, 1 ms; for counters a tenth of
a step, so that a step is not lost in rounding.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import Model
from mavfi.detectors.preprocess import VehicleQueue
from mavfi.detectors.training import Sample, TrainedDetector, Training, check_finite, join
from mavfi.extras.bench import residual_state, residuals
from mavfi.numerics.jit import entry
from mavfi.states import AUTOPILOTS, ODOMETRY, STATES, State, new_state, rows

MONITORED = "all"
"""Name of the set, in models."""
QUANTA = {"m": 0.01, "m/s": 0.01, "m/s^2": 0.1, "rad": 0.01, "rad/s": 0.01, "s": 0.001, "-": 0.1, "octave": 0.01}
"""Quantum by unit."""


class _Residual(NamedTuple):
    """A residual: its name, a field of the state in whose unit it is, and its unit if that differs."""

    name: str
    field: str
    unit: str = ""


class _Watched(NamedTuple):
    """A state with its residuals.

    Attributes:
        measure: Compiled function that computes their codes.
        residuals: The residuals.
        in_list: Whether they are those of a list of elements, not of the header.
        width: Number of leading columns of the header or of an element that they read.
        from_vehicle: Whether they depend on the vehicle's odometry.
    """

    measure: Callable[..., None]
    residuals: tuple[_Residual, ...]
    in_list: bool
    width: int
    from_vehicle: bool = False


def _fields(*names: str, unit: str = "") -> tuple[_Residual, ...]:
    """Residuals that have the names of fields."""
    return tuple(_Residual(name, name, unit) for name in names)


_WATCHED = {
    "perception.collision_status": _Watched(
        residual_state.measure_status,
        (
            *_fields("time_to_collision", "distance_to_blocked", "distance_to_unknown", unit="octave"),
            *_fields("future_collision_seq", "trajectory_seq", "collision"),
        ),
        in_list=False,
        width=0,
    ),
    "planning.path": _Watched(
        residual_state.measure_path,
        (
            *_fields("entry_speed", "future_collision_seq", "junction"),
            _Residual("start", "x"),
            _Residual("end", "x"),
            _Residual("detour", "x"),
        ),
        in_list=True,
        width=3,
        from_vehicle=True,
    ),
    "planning.trajectory": _Watched(
        residual_state.measure_trajectory,
        (
            *_fields("trajectory_seq", "future_collision_seq"),
            _Residual("step", "x"),
            _Residual("change", "vx"),
            _Residual("speed", "vx"),
            _Residual("acceleration", "ax"),
            _Residual("duration", "duration"),
            _Residual("turn", "yaw"),
            _Residual("start", "x"),
            _Residual("end", "x"),
        ),
        in_list=True,
        width=11,
        from_vehicle=True,
    ),
    "planning.waypoint": _Watched(
        residual_state.measure_waypoint,
        (
            *_fields("x", "y", "z", "yaw", "vx", "vy", "vz", "ax", "ay", "az", "duration"),
            *_fields("trajectory_seq", "future_collision_seq", "index"),
        ),
        in_list=False,
        width=11,
        from_vehicle=True,
    ),
    "control.command": _Watched(
        residual_state.measure_command,
        _fields("vx", "vy", "vz", "yaw_rate", "duration"),
        in_list=False,
        width=5,
    ),
    "control.tracking": _Watched(residual_state.measure_tracking, _fields("remaining"), in_list=False, width=1),
}

_PREDICTS_NO_OTHER = "control.tracking"
"""State that predicts nothing but its own residual."""

COMPILED: dict[str, Callable[..., Any]] = {
    **{watched.measure.__name__: watched.measure for watched in _WATCHED.values()},
    "note_vehicle": residual_state.note_vehicle,
}
"""Compiled functions that compute the codes, by name."""


class FieldCodes:
    """Codes of the residuals of all states during one flight.

    Fields that no consumer reads under an autopilot profile are not watched: their code is 0.

    Args:
        autopilot: The autopilot profile.

    Attributes:
        fields: Names of the residuals, "state.field"; lists have residuals over all elements.
        stages: Stage of each.
        slots: Index of each state, by name.
        states: Names of those that it reads, and of the vehicle's odometry.
        quanta: Quantum of each residual, in its unit; 0 = not watched. Shape (n,).
        measured: The publication measured last, and the memory between publications.
        vehicles: Odometry that is not yet stored.
    """

    def __init__(self, autopilot: str) -> None:
        self.slots = {name: slot for slot, name in enumerate(_WATCHED)}
        fields: list[str] = []
        stages: list[str] = []
        quanta: list[float] = []
        self._ranges: list[tuple[int, int]] = []
        for state, watched in _WATCHED.items():
            self._ranges.append((len(fields), len(fields) + len(watched.residuals)))
            for residual in watched.residuals:
                fields.append(f"{state}.{residual.name}")
                stages.append(STATES[state].stage.value)
                field = STATES[state].find(residual.field)
                dead = autopilot in AUTOPILOTS and field.dead_in(autopilot)
                quanta.append(0.0 if dead else QUANTA[residual.unit or field.unit])
        self.fields = tuple(fields)
        self.stages = tuple(stages)
        self.quanta = np.array(quanta)
        self.states = frozenset(filter(self._is_read, self.slots)).union(ODOMETRY.values())
        self._watched = tuple(_WATCHED.values())
        self._empty = [np.zeros((0, watched.width)) for watched in self._watched]
        self.measured = residual_state.initial_state(self.quanta, np.array(self._ranges, np.int64))
        self.vehicles = VehicleQueue(self.measured)
        self.instrument({})

    def instrument(self, made: Mapping[str, Callable[..., Any]]) -> None:
        """Replace functions of `COMPILED` by those of the same name in `made`; restore all others."""
        note = made.get("note_vehicle", residual_state.note_vehicle)
        self.vehicles.store = entry(note, np.zeros(1, np.uint8), self.measured)
        self._measures = [self._measure_of(name, made) for name in _WATCHED]

    def _measure_of(self, state: str, made: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
        """The function that computes the codes of a state: of its header, its list if it has one, and `measured`."""
        watched = _WATCHED[state]
        function = made.get(watched.measure.__name__, watched.measure)
        if watched.in_list:
            return function
        return entry(function, new_state(state).header, self.measured)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without machine code and addresses, which are valid in one process only."""
        return {name: value for name, value in self.__dict__.items() if name != "_measures"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Inverse of `__getstate__`."""
        self.__dict__.update(state)
        self.instrument({})

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self.measured.known[:] = 0.0
        self.forget()

    def forget(self) -> None:
        """Forget the publication measured last; the memory stays."""
        self.vehicles.clear()
        self.measured.status[residual_state.ACCEPTED] = 0

    def _is_read(self, name: str) -> bool:
        """Whether something of a state is watched, or predicts residuals of other states."""
        return name != _PREDICTS_NO_OTHER or bool(self.quanta[slice(*self._ranges[self.slots[name]])].any())

    def range_of(self, slot: int) -> tuple[int, int]:
        """First and one past the last index of a state's residuals."""
        return self._ranges[slot]

    def read(self, state: State, slot: int) -> None:
        """Compute the codes of a publication of the state with this slot, in `measured`."""
        watched = self._watched[slot]
        if watched.from_vehicle:
            self.vehicles.store_latest()
        if watched.in_list:
            elements = self._empty[slot]
            if len(state.elements):
                elements = rows(state.elements, watched.width)
            self._measures[slot](state.header, elements, self.measured)
        else:
            self._measures[slot](state.header, self.measured)

    def accept(self) -> None:
        """The publication measured last was published: it is the reference for the next one."""
        self.measured.status[residual_state.ACCEPTED] = 1

    def record(self, state: State, slot: int, codes: np.ndarray) -> int:
        """Compute the codes of a publication, which becomes the reference for the next one.

        Args:
            state: The publication.
            slot: Index of its state.
            codes: Output, in the range `range_of(slot)`. Shape (n,), int16.

        Returns:
            The regime, or -1 - regime if a watched number is not finite; -1 for a regime that does not exist.
        """
        self.read(state, slot)
        fields = slice(*self._ranges[slot])
        codes[fields] = self.measured.codes[fields]
        self.accept()
        return int(self.measured.status[residual_state.REGIME])

    def note(self, state: State) -> None:
        """Store position and velocity of the vehicle, if this state is odometry."""
        if state.spec.name in _POSITIONS:
            self.vehicles.add(state.header)

    def settle(self) -> None:
        """Bring the memory up to date."""
        residual_state.settle(self.measured)
        self.vehicles.store_latest()

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the residuals of a publication, measured last, that divided by their quanta are not finite."""
        first, last = self._ranges[self.slots[state.spec.name]]
        values = self.measured.values[first:last]
        quanta = self.quanta[first:last]
        with np.errstate(over="ignore"):  # a residual of 1e307 m is finite, but overflows in centimetres
            wrong = (quanta > 0.0) & ~np.isfinite(values / np.where(quanta > 0.0, quanta, 1.0))
        return first + np.flatnonzero(wrong)


_POSITIONS = tuple(ODOMETRY.values())
"""States that hold position and velocity of the vehicle."""
_SIZES = np.array([len(watched.residuals) for watched in _WATCHED.values()])
"""Number of residuals of each state."""


class CodeRecorder(Detector):
    """A recorder of all codes of a flight, for training.

    Args:
        autopilot: The autopilot profile.
    """

    def __init__(self, autopilot: str) -> None:
        self._field_codes = FieldCodes(autopilot)
        self._codes = np.zeros(len(self._field_codes.fields), np.int16)
        self._recorded: list[bytes] = []
        self._slots: list[int] = []
        self._regimes: list[int] = []

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self._field_codes.start()
        self._recorded = []
        self._slots = []
        self._regimes = []

    def accept(self, state: State, time_us: int) -> None:
        """Store the codes of a published value."""
        slot = self._field_codes.slots.get(state.spec.name)
        if slot is None:
            self._field_codes.note(state)
            return
        self._regimes.append(self._field_codes.record(state, slot, self._codes))
        self._slots.append(slot)
        first, last = self._field_codes.range_of(slot)
        self._recorded.append(self._codes[first:last].tobytes())

    def recording(self) -> "Codes":
        """Codes of all publications since `start`."""
        codes = np.frombuffer(b"".join(self._recorded), np.int16)
        return Codes(np.array(self._slots, np.int8), np.array(self._regimes, np.int8), codes)


class Codes(NamedTuple):
    """The codes of one flight.

    Attributes:
        slots: State of each publication. Shape (m,), int8.
        regimes: Regime of each, see `FieldCodes.record`. Shape (m,), int8.
        codes: Codes of the published states, concatenated. Shape (total,), int16.
    """

    slots: np.ndarray
    regimes: np.ndarray
    codes: np.ndarray


def sample_of(flight: Codes, field_codes: FieldCodes) -> Sample:
    """Sample of one flight, as a detector of all fields sees it."""
    count = len(flight.slots)
    vectors = np.zeros((count, len(field_codes.fields)), np.int16)
    ends = np.cumsum(_SIZES[flight.slots])
    for slot in np.unique(flight.slots):
        first, last = field_codes.range_of(int(slot))
        rows = np.flatnonzero(flight.slots == slot)
        codes = flight.codes[ends[rows, None] - (last - first) + np.arange(last - first)]
        # a code holds until the next publication of its state
        newest = np.searchsorted(rows, np.arange(count), side="right") - 1
        vectors[:, first:last] = np.where((newest >= 0)[:, None], codes[np.maximum(newest, 0)], 0)
    first_ones = np.zeros(count, bool)
    first_ones[np.unique(flight.slots, return_index=True)[1]] = True
    return Sample(vectors, flight.slots.astype(np.int64), flight.regimes.astype(np.int64), first_ones)


class AllFields(Training):
    """Training with the codes of all fields, in one profile."""

    parts = Codes
    profiles = ("tuned",)
    # one of each family: limits of all fields that are learned in one do not hold in the other
    environments = ("training", "factory")

    def recorder(self, autopilot: str) -> CodeRecorder:
        """See `Training`."""
        return CodeRecorder(autopilot)

    def is_whole(self, recording: Codes) -> bool:
        """Whether slots, regimes and codes are consistent."""
        slots, regimes, codes = recording
        if [part.dtype for part in recording] != [np.int8, np.int8, np.int16] or any(p.ndim != 1 for p in recording):
            return False
        if len(slots) != len(regimes) or ((slots < 0) | (slots >= residuals.SLOTS)).any():
            return False
        return int(_SIZES[slots].sum()) == len(codes) and bool((np.abs(regimes) <= REGIMES).all())

    def fit(
        self,
        detectors: Mapping[str, type[TrainedDetector]],
        profile: str,
        recordings: Sequence[Codes],
        origin: Mapping[str, Any],
        figures: Mapping[str, Mapping[str, Any]],
    ) -> Iterator[Model]:
        """See `Training`."""
        field_codes = FieldCodes(origin["stack"])
        sample = join([sample_of(codes, field_codes) for codes in recordings])
        check_finite(sample)
        for name, detector in detectors.items():
            parameters = detector.fit(sample, field_codes, figures[name])
            yield Model(detector.model_kind, profile, MONITORED, "", parameters, dict(origin))


ALL_FIELDS = AllFields()
