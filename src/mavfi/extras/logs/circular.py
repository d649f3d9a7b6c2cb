"""Angles and quaternions among the numbers of messages: which they are, and their values without jumps.

An angle jumps by a full turn where it passes the end of its range, and a quaternion `q` is the same attitude as `-q`.
A detector that takes them for plain numbers learns these jumps as normal changes, and no longer sees others.  So each
value is replaced by the equal one that is nearest to the value before: an angle plus a number of turns, a quaternion
with or without the opposite sign.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mavfi.detectors.foreign import foreign_state
from mavfi.errors import BadInputError
from mavfi.states import State, floats

TURNS = {"rad": 2.0 * math.pi, "deg": 360.0, "cdeg": 36_000.0, "degE7": 3.6e9}
"""A full turn in each unit of angles."""
QUATERNION = "quaternion"
NUMBER = "number"
KINDS = (*TURNS, QUATERNION, NUMBER)
"""What a field can be declared as."""
_UNIT_SYNONYMS = {
    "rad": "rad", "radian": "rad", "radians": "rad",
    "deg": "deg", "degree": "deg", "degrees": "deg", "degheading": "deg", "°": "deg",
    "cdeg": "cdeg", "centideg": "cdeg", "centidegrees": "cdeg",
    "dege7": "degE7",
}  # fmt: skip
_UNIT_IN_NAME = re.compile(r"(?:^|[^a-z])(degrees?|radians?|deg|rad|cdeg|°)(?:[^a-z]|$)", re.IGNORECASE)
"""A unit within the name of a field, e.g. "yaw [deg]", "heading_rad"."""
_ANGLE = re.compile(
    r"(^|[^a-z])(yaw|heading|hdg|roll|pitch|course|cog|bearing|azimuth|psi|phi|theta|angle|euler|lon|longitude)"
    r"([^a-z]|$|sp|setpoint|ref|cmd|des|target)"
)
"""Names of angles, in lower case with words separated."""
_NO_ANGLE = re.compile(
    r"rate|speed|vel|acc|dot|torque|moment|thrust|control|integr|gain|std|var|cov|pwm|valid|reset|count|ratio|dps"
    r"|rad_?s|deg_?s|rad/s|deg/s"
)
"""What such a name holds if it is that of another quantity of the same axis."""
_COMPONENTS = (("w", "x", "y", "z"), ("0", "1", "2", "3"), ("1", "2", "3", "4"))
"""Marks of the four components of a quaternion."""
_UNIT_NORM = 0.02
"""Largest deviation of a quaternion's norm from 1."""
_EXACT_NORM = 1e-3
"""The same for numbers whose names do not say that they are a quaternion."""
_ROUNDING = 1.005
"""Largest value of an angle's range / its end."""
_NEAR_END = 0.9
"""Share of the range from which on a value is near its end: a field that jumps between both ends is an angle."""
_LARGEST_STEP = 0.25
"""Largest other change of such a field, in turns."""
_MAX_TURNS = 3.0
"""Values beyond this many turns are no angles but corrupted: they are not changed."""
_MAX_COUNTED = 1e6
"""The same for values without jumps, whose turns add up."""


class Numbers(NamedTuple):
    """Values of the numbers of a topic in one recording, by message.

    Attributes:
        names: Names of the numbers.
        values: NaN where a message lacks the number. Shape (messages, numbers).
    """

    names: list[str]
    values: np.ndarray


@dataclass(frozen=True)
class Geometry:
    """Numbers of a topic that are not plain.

    Attributes:
        turns: Full turn of each angle, by field.
        quaternions: Fields of each quaternion.
    """

    turns: Mapping[str, float] = field(default_factory=dict)
    quaternions: Sequence[tuple[str, ...]] = ()

    def restricted(self, names: Collection[str]) -> "Geometry":
        """The same for some of the fields."""
        turns = {name: turn for name, turn in self.turns.items() if name in names}
        return Geometry(turns, [quaternion for quaternion in self.quaternions if set(quaternion) <= set(names)])

    @property
    def fields(self) -> set[str]:
        """All of these fields."""
        return {*self.turns, *(name for quaternion in self.quaternions for name in quaternion)}

    def to_json(self) -> dict[str, str]:
        """What each of these fields is."""
        units = {turn: unit for unit, turn in TURNS.items()}
        kinds = {name: f"angle ({units[turn]})" for name, turn in self.turns.items()}
        return kinds | {name: QUATERNION for quaternion in self.quaternions for name in quaternion}


# ---- recognition -----------------------------------------------------------------------------------------------------
def recognise(
    recordings: Sequence[Numbers], units: Mapping[str, str], declared: Mapping[str, str] | None = None
) -> Geometry:
    """Which numbers of a topic are angles and quaternions, by declaration, unit, name, norm and range.

    Args:
        recordings: Its numbers in each recording, with the same names.
        units: Units of numbers, as far as the format of the file defines them.
        declared: Kind of numbers, one of `KINDS`, as the user said.

    Raises:
        BadInputError: The number of fields declared as quaternions is not a multiple of four.
    """
    declared = declared or {}
    names = recordings[0].names
    columns = {name: [numbers.values[:, index] for numbers in recordings] for index, name in enumerate(names)}
    quaternions = _declared_quaternions([name for name in names if declared.get(name) == QUATERNION])
    quaternions += _quaternions({name: columns[name] for name in names if name not in declared})
    in_quaternions = {name for quaternion in quaternions for name in quaternion}
    free = {name: columns[name] for name in names if name not in declared and name not in in_quaternions}
    turns = {name: TURNS[declared[name]] for name in names if declared.get(name) in TURNS}
    return Geometry(turns | _turns(free, units), quaternions)


def _declared_quaternions(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Fields that were declared as components of quaternions, in groups of four."""
    if len(names) % 4:
        raise BadInputError(f"--kinds: {', '.join(names)}: allowed: {QUATERNION} for all four components of one")
    return [tuple(names[start : start + 4]) for start in range(0, len(names), 4)]


def _quaternions(columns: Mapping[str, Sequence[np.ndarray]]) -> list[tuple[str, ...]]:
    """Quaternions among numbers, each by recording: those named like one with the norm 1, then any with that norm."""
    names = list(columns)
    quaternions = [
        group for group in component_groups(names) if _has_unit_norm([columns[name] for name in group], _UNIT_NORM)
    ]
    used = {name for quaternion in quaternions for name in quaternion}
    for start in range(len(names) - 3):
        neighbours = tuple(names[start : start + 4])
        if used.isdisjoint(neighbours) and _is_unnamed_quaternion([columns[name] for name in neighbours]):
            quaternions.append(neighbours)
            used.update(neighbours)
    return quaternions


def _turns(columns: Mapping[str, Sequence[np.ndarray]], units: Mapping[str, str]) -> dict[str, float]:
    """Full turn of each angle among numbers: those with its unit, its name, or a jump by a turn."""
    turns = {}
    named = []
    for name in columns:
        unit = _unit_of(name, units)
        if unit in TURNS:
            turns[name] = TURNS[unit]
        elif unit is None and _is_angle_name(name):
            named.append(name)
        elif unit is None:
            turn = _turn_by_jumps(columns[name])
            if turn is not None:
                turns[name] = turn
    # The unit of named angles, which the angles of a topic share, follows from their largest value.
    shared_turn = _turn_by_range([column for name in named for column in columns[name]])
    if shared_turn is not None:
        turns |= dict.fromkeys(named, shared_turn)
    return turns


def _unit_of(name: str, units: Mapping[str, str]) -> str | None:
    """Unit of a number, by the format or its name: a key of `TURNS`, "" = another one, None = unknown."""
    if units.get(name):
        return _UNIT_SYNONYMS.get(units[name].lower(), "")
    match = _UNIT_IN_NAME.search(name)
    if match is None:
        return None
    if _NO_ANGLE.search(name.lower()):  # deg/s, rad_s
        return ""
    return _UNIT_SYNONYMS[match[1].lower()]


def _is_angle_name(name: str) -> bool:
    """Whether a number is named like an angle."""
    last = name.rpartition(".")[2]
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", last).lower()
    return _ANGLE.search(text) is not None and _NO_ANGLE.search(text) is None


def component_groups(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Groups of four names that differ only in the mark of a component, in order of the marks."""
    order = {name: index for index, name in enumerate(names)}
    taken: set[str] = set()
    for name in names:
        for marks in _COMPONENTS:
            for match in re.finditer(rf"(?i){marks[0]}", name):
                group = [f"{name[: match.start()]}{mark}{name[match.end() :]}" for mark in marks]
                if match[0].isupper():
                    group = [f"{name[: match.start()]}{mark.upper()}{name[match.end() :]}" for mark in marks]
                if all(member in order and member not in taken for member in group):
                    taken.update(group)
                    yield tuple(group)


def _has_unit_norm(components: Sequence[Sequence[np.ndarray]], tolerance: float) -> bool:
    """Whether four numbers, each by recording, are a quaternion of norm 1 in nearly all messages."""
    with np.errstate(over="ignore", invalid="ignore"):
        norms = np.sqrt(sum(np.concatenate(component) ** 2 for component in components))
    finite = norms[np.isfinite(norms)]
    return len(finite) > 0 and float(np.mean(np.abs(finite - 1.0) <= tolerance)) > 0.99


def _is_unnamed_quaternion(components: Sequence[Sequence[np.ndarray]]) -> bool:
    """Whether four neighbouring numbers of any name are a quaternion: their norm is 1, and no one is constant."""
    if any(np.ptp(np.concatenate(component)) == 0.0 for component in components):
        return False
    return _has_unit_norm(components, _EXACT_NORM)


def _turn_by_range(columns: Sequence[np.ndarray]) -> float | None:
    """Full turn of angles by their largest values; None = these are none."""
    if not columns:
        return None
    values = np.abs(np.concatenate(columns))
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    largest = float(np.quantile(values, 0.999))
    if largest <= _ROUNDING * TURNS["rad"]:
        return TURNS["rad"]
    if largest <= _ROUNDING * TURNS["deg"]:
        return TURNS["deg"]
    if largest <= _ROUNDING * TURNS["cdeg"] and bool((values == np.floor(values)).all()):
        return TURNS["cdeg"]
    return None


def _turn_by_jumps(columns: Sequence[np.ndarray]) -> float | None:
    """Full turn of a number that jumps from one end of an angle's range to the other; None = it does not."""
    finite = [column[np.isfinite(column)] for column in columns]
    values = np.concatenate(finite)
    if not len(values):
        return None
    low = float(values.min())
    high = float(values.max())
    for turn in TURNS.values():
        for begin, end in ((-0.5 * turn, 0.5 * turn), (0.0, turn)):
            margin = (1.0 - _NEAR_END) * turn
            spare = (_ROUNDING - 1.0) * turn
            if not (begin - spare <= low <= begin + margin and end - margin <= high <= end + spare):
                continue
            changes = np.concatenate([np.diff(column) for column in finite]) / turn
            if (
                np.abs(changes).max(initial=0.0) > _NEAR_END
                and np.abs(changes - np.rint(changes)).max() < _LARGEST_STEP
            ):
                return turn
    return None


# ---- values without jumps --------------------------------------------------------------------------------------------
class Unwrapper:
    """Replaces angles and quaternions of states by the equal values nearest to those accepted last.

    Args:
        geometries: Angles and quaternions by topic; their fields are in the header of the topic's states.
    """

    def __init__(self, geometries: Mapping[str, Geometry]) -> None:
        self._geometries = {topic: geometry for topic, geometry in geometries.items() if geometry.fields}
        self._last: dict[str, State] = {}

    def start(self) -> None:
        """Forget everything at the start of a recording."""
        self._last = {}

    def unwrap(self, state: State) -> State:
        """The state without jumps; does not change the memory."""
        geometry = self._geometries.get(state.spec.name)
        last = self._last.get(state.spec.name)
        if geometry is None or last is None:
            return state
        values = _values(state)
        before = _values(last)
        for name, turn in geometry.turns.items():
            values[name] = _nearest_angle(values[name], before[name], turn)
        for quaternion in geometry.quaternions:
            if sum(values[name] * before[name] for name in quaternion) < 0.0:
                values |= {name: -values[name] for name in quaternion}
        return foreign_state(state.spec, list(values.values()))

    def accept(self, state: State) -> None:
        """Remember a state that `unwrap` has returned."""
        if state.spec.name in self._geometries:
            self._last[state.spec.name] = state

    def memory(self) -> dict[str, State]:
        """What it remembers."""
        return dict(self._last)

    def restore(self, memory: Mapping[str, State]) -> None:
        """Inverse of `memory`."""
        self._last = dict(memory)


def _values(state: State) -> dict[str, float]:
    """The values of a state's fields, all float64."""
    values = floats(state.header, len(state.spec.header)).tolist()
    return {field.name: value for field, value in zip(state.spec.header, values, strict=True)}


def _nearest_angle(angle: float, before: float, turn: float) -> float:
    """The angle plus the number of turns that brings it nearest to the one before, unless either is corrupted."""
    if not (abs(angle) <= _MAX_TURNS * turn and abs(before) <= _MAX_COUNTED * turn):
        return angle
    return angle + turn * round((before - angle) / turn)
