"""Divergence of an injected flight from its golden run, in publications and in the flown path."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavfi.record import FlightLog
from mavfi.states import STATES, State, differing_rows

LEFT = 0.1
"""Distance beyond which a flight has left the golden run's path (m)."""


@dataclass(frozen=True, slots=True)
class TimedState:
    """A published state as received by consumers, with its instant (us)."""

    time_us: int
    state: State


@dataclass(frozen=True, slots=True)
class FirstDifference:
    """The first publication in which two flights differ; publications are paired by state and number."""

    state: str
    field: str  # with its element; "" if only the instant differs or one flight lacks the publication
    golden_us: int | None  # instant in the golden run; None = not published
    injected_us: int | None  # instant in the injected run; None = not published
    golden: object = None  # value in the golden run; None without a field
    injected: object = None  # value in the injected run; None without a field

    @property
    def time_us(self) -> int:
        """Instant of divergence: the earlier of the two instants."""
        return min(time for time in (self.golden_us, self.injected_us) if time is not None)


def first_difference(golden: Sequence[TimedState], injected: Sequence[TimedState]) -> FirstDifference | None:
    """Find the first publication that differs in value or instant; None = the flights are bit-identical.

    Publications are paired by state and number, so that a delayed one is compared with its counterpart.
    """
    golden_by_key = _numbered(golden)
    injected_by_key = _numbered(injected)
    earliest: FirstDifference | None = None
    for key in dict.fromkeys((*golden_by_key, *injected_by_key)):  # in data-flow order, which breaks ties
        pair = golden_by_key.get(key), injected_by_key.get(key)
        times = [publication.time_us for publication in pair if publication is not None]
        if earliest is not None and min(times) >= earliest.time_us:
            continue  # the comparison takes long: only publications that may be the first to differ
        name, _ = key
        difference = _difference(name, *pair)
        if difference is not None:
            earliest = difference
    return earliest


@dataclass(frozen=True, slots=True)
class StateSpread:
    """Interval in which a state differs from the golden run."""

    name: str  # of the state
    kernel: str  # its writer
    first_us: int  # instant of the first value that differs
    last_us: int  # instant of the last value that differs
    differing: int  # number of values that differ
    compared: int  # number of values present in both flights
    to_the_end: bool  # whether the last value present in both flights differs


def spread(golden: Sequence[TimedState], injected: Sequence[TimedState]) -> list[StateSpread]:
    """Propagation of an error: the affected states, in the order in which they first differ in value.

    Publications are paired by state and number; differences in time only are ignored.
    """
    golden_by_key = _numbered(golden)
    values: dict[str, list[tuple[int, bool]]] = {}  # by state, instants and whether the value differs
    for (name, number), publication in _numbered(injected).items():
        counterpart = golden_by_key.get((name, number))
        if counterpart is not None:
            differs = not counterpart.state.same_bits(publication.state)
            values.setdefault(name, []).append((publication.time_us, differs))
    spreads = []
    for name, pairs in values.items():
        times = [time_us for time_us, differs in pairs if differs]
        if times:
            _, last_differs = pairs[-1]
            kernel = STATES[name].writer
            spreads.append(
                StateSpread(name, kernel, times[0], times[-1], len(times), len(pairs), to_the_end=last_differs)
            )
    return sorted(spreads, key=lambda spread: spread.first_us)


def _numbered(publications: Sequence[TimedState]) -> dict[tuple[str, int], TimedState]:
    """Publications by state and number, counted from 1."""
    counts: dict[str, int] = {}
    by_key = {}
    for publication in publications:
        name = publication.state.spec.name
        counts[name] = counts.get(name, 0) + 1
        by_key[name, counts[name]] = publication
    return by_key


def _difference(name: str, golden: TimedState | None, injected: TimedState | None) -> FirstDifference | None:
    """How two publications of a state differ, of which at most one is missing (None); None = they are equal."""
    if golden is None:
        return FirstDifference(name, "", None, None if injected is None else injected.time_us)
    if injected is None:
        return FirstDifference(name, "", golden.time_us, None)
    if not golden.state.same_bits(injected.state):
        field, golden_value, injected_value = _first_field(golden.state, injected.state)
        return FirstDifference(name, field, golden.time_us, injected.time_us, golden_value, injected_value)
    if golden.time_us != injected.time_us:
        return FirstDifference(name, "", golden.time_us, injected.time_us)
    return None


class _FieldDifference(NamedTuple):
    """A field that differs, and its values."""

    field: str
    golden: object
    injected: object


def _first_field(golden: State, injected: State) -> _FieldDifference:
    """The first field that differs bitwise; or the numbers of elements, if these differ."""
    if len(golden.elements) != len(injected.elements):
        return _FieldDifference("number of elements", len(golden.elements), len(injected.elements))
    for records, other_records in ((golden.header, injected.header), (golden.elements, injected.elements)):
        for name in records.dtype.names or ():
            rows = differing_rows(records[name], other_records[name])
            if len(rows):
                field = name
                if records is golden.elements:
                    field = f"{name}[{rows[0]}]"
                return _FieldDifference(field, records[name][rows[0]].item(), other_records[name][rows[0]].item())
    raise AssertionError(f"{injected.spec.name}: bits differ and no field does")


@dataclass(frozen=True, slots=True)
class Departure:
    """Deviation of a flight from the golden run's path, and its final delay."""

    time_s: float | None  # first time at a distance above `LEFT` from the path; None = never
    position: tuple[float, float, float] | None  # at that time (m)
    largest_m: float  # largest distance from the path
    largest_s: float  # time of the largest distance
    behind_s: float | None  # end time minus the golden run's time at the nearest point; None = no finite position


def departure(golden: FlightLog, injected: FlightLog) -> Departure:
    """Compute the deviation of a flight from the path of its golden run, and its final delay."""
    time = injected.column("time")
    positions = injected.columns("x", "y", "z")
    distance, golden_time = _project(golden, positions)

    # where the flight leaves the path
    departure_time = None
    departure_position = None
    outside = np.flatnonzero(distance > LEFT)
    if len(outside):
        first = outside[0]
        x, y, z = positions[first].tolist()
        departure_time = float(time[first])
        departure_position = (x, y, z)

    # how far it gets from the path, and how far behind it ends
    farthest = int(np.argmax(distance))
    behind = None
    if np.isfinite(distance[-1]):
        behind = float(time[-1] - golden_time[-1])
    return Departure(departure_time, departure_position, float(distance[farthest]), float(time[farthest]), behind)


def _project(golden: FlightLog, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (m) of points (m), shape (n, 3), from a flown path, and times (s) of the nearest points of the path.

    The search finds the nearest recorded position, then the nearest point on the two legs adjacent to it.
    Distances are infinite for non-finite points. Shapes (n,), (n,).
    """
    from scipy.spatial import cKDTree  # in the extra `report`

    path = golden.columns("x", "y", "z")
    time = golden.column("time")
    distance = np.full(len(points), np.inf)
    golden_time = np.zeros(len(points))

    # the nearest recorded position
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    position = points[finite]
    distance[finite], row = cKDTree(path).query(position)
    golden_time[finite] = time[row]

    # the nearest point on the leg before it, and on the leg after it, where that is nearer than the recorded position
    for begin in (np.maximum(row - 1, 0), np.minimum(row, max(0, len(path) - 2))):
        end = np.minimum(begin + 1, len(path) - 1)
        leg = path[end] - path[begin]
        square = (leg**2).sum(axis=1)
        # share of the leg at which the point projects onto it; a leg without length has the share 0
        share = ((position - path[begin]) * leg).sum(axis=1) / np.where(square > 0.0, square, 1.0)
        share = np.clip(share, 0.0, 1.0)
        leg_distance = np.linalg.norm(position - path[begin] - share[:, None] * leg, axis=1)
        is_nearer = leg_distance < distance[finite]
        distance[finite[is_nearer]] = leg_distance[is_nearer]
        golden_time[finite[is_nearer]] = (time[begin] + share * (time[end] - time[begin]))[is_nearer]
    return distance, golden_time
