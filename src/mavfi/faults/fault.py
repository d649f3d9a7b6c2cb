"""Planned faults: pure data.  The resulting event is a `record.Injection`.

Each level has its own type of fault; `fault_from_json` reads all of them.  What a level means (how its faults are
written, drawn, injected, made smaller) is in its `mavfi.levels`.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from enum import Enum, auto
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mavfi.config import checked
from mavfi.errors import BadInputError, not_known
from mavfi.faults.changes import Change, parse_text
from mavfi.plugins import known, load_object
from mavfi.states import DETECTORS

if TYPE_CHECKING:
    from mavfi.ir.injection.variant import InjectionReport, Variant
    from mavfi.record import Injection

GROUP = "mavfi.levels"
"""Entry-point group of fault levels: subclasses of `mavfi.levels.level.Level`."""
SHIPPED = {
    "state": "mavfi.levels.state:StateLevel",
    "memory": "mavfi.levels.memory:MemoryLevel",
    "sensor": "mavfi.levels.sensor:SensorLevel",
    "instruction": "mavfi.levels.instruction:InstructionLevel",
    "message": "mavfi.levels.message:MessageLevel",
    "combined": "mavfi.levels.combined:CombinedLevel",
}
"""Levels of the core, by name."""
NO_SITE = -1
"""`time_us` or `call` of a draw for which the golden run has no site."""
RESTART_S = 0.57
"""Restart time of a node after a crash: measured for a ROS 1 node killed and respawned by roslaunch (s)."""


class FliesFrom(Enum):
    """Where a flight with a fault begins to differ from its golden flight, and so where it is flown from."""

    TAKE_OFF = auto()  # an injector takes part from the start
    CHECKPOINT = auto()  # nothing happens before its instant: from the last golden checkpoint before it
    CALL = auto()  # a fork of the golden flight at a call of a function
    CALLS = auto()  # forks at several calls in one flight, each within the one before


@dataclass(frozen=True, slots=True)
class Fault:
    """Base of the planned faults of all levels.

    Attributes:
        level: Name of the level.
        later_fields: Fields that are not stored with their default values, so that older faults keep their identity.
    """

    level: ClassVar[str]
    later_fields: ClassVar[tuple[str, ...]] = ("change", "role")
    if TYPE_CHECKING:  # subclasses have these as fields, each in another order

        @property
        def bit(self) -> int | None:
            """The flipped bit, if there is exactly one that is known before the run."""

        @property
        def stratum(self) -> str:
            """Stratum of the draw; "" = not drawn by stratum."""

        @property
        def weight(self) -> float:
            """Probability that a draw from everything falls in the stratum."""

        @property
        def seed(self) -> int:
            """Seed of the draw."""

        @property
        def time_us(self) -> int:
            """Earliest instant (us), of faults that have one."""

    @property
    def site(self) -> str:
        """What is changed, as text."""
        raise NotImplementedError

    @property
    def bit_class(self) -> str:
        """Meaning of the bit, e.g. "exponent"; "" if unknown."""
        return ""

    @property
    def has_site(self) -> bool:
        """Whether there is a value to change, as far as known before the run."""
        return getattr(self, "time_us", 0) != NO_SITE

    @property
    def start_s(self) -> float:
        """Earliest instant (s); 0 without a site."""
        return max(self.time_us, 0) / 1e6

    @property
    def changed_state(self) -> str:
        """Name of the inter-kernel state whose publications are changed; "" = of none."""
        return ""

    @property
    def in_detector(self) -> bool:
        """Whether it is in a detector itself, and so in flights with that detector only."""
        return False

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        values = asdict(self)
        data: dict[str, Any] = {"level": self.level}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in self.later_fields and value == field.default:
                continue
            if isinstance(value, Change):
                data[field.name] = str(value)
            elif value == math.inf:
                data[field.name] = "inf"  # JSON has no infinity
            else:
                data[field.name] = values[field.name]
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        change = data.get("change")
        if isinstance(change, str):
            data = {**data, "change": parse_text(change)}
        return checked(cls, data, f"fault of level {cls.level}")


@dataclass(frozen=True, slots=True)
class CallFault(Fault):
    """Base of faults in calls of compiled functions, for which flights fork."""

    if TYPE_CHECKING:  # as of `Fault`

        @property
        def call(self) -> int:
            """Index of the call in the flight."""

        @property
        def times(self) -> int:
            """Number of calls that are changed."""

        @property
        def kernel(self) -> str:
            """Kernel, plug-in or detector that makes the call."""

        @property
        def role(self) -> str:
            """Kind of the plug-in, as in `states.PLUG_INS`; "" = none."""

        @property
        def entry(self) -> str:
            """Name of the function."""

        @property
        def index(self) -> int:
            """Dynamic index of the value in the call."""

        @property
        def budget(self) -> int:
            """Number of values after which the call counts as a hang."""

        @property
        def ir_sha256(self) -> str:
            """Digest of the code to which the index refers."""

        @property
        def restart_s(self) -> float:
            """Time after which a crashed node has restarted (s)."""

        @property
        def counter(self) -> str:
            """Name under which a flight counts the calls of its function."""

        @property
        def masks(self) -> tuple[int, int]:
            """Keep and flip masks: the value becomes (value & keep) ^ flip."""

    def check(self, variant: "Variant", function: Any) -> None:
        """Raise a MismatchError if it was drawn for another function or other machine code."""
        raise NotImplementedError

    def injection(self, report: "InjectionReport | None", time_s: float = 0.0, call: int | None = None) -> "Injection":
        """The record of an injection at an instant (s), from the report of the machine code (None = not reached).

        `call` is the injected call, if not the planned one.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class FaultSite:
    """A field of an inter-kernel state, and the index of its element if it is in a list."""

    state: str
    field: str
    element: int | None = None

    def __str__(self) -> str:
        if self.element is None:
            return f"{self.state}.{self.field}"
        return f"{self.state}.{self.field}[{self.element}]"


def is_detector(kernel: str, role: str) -> bool:
    """Whether a kernel, or a plug-in of a role, is a detector."""
    return role == "detector" or (not role and kernel in DETECTORS)


@cache
def find_level(name: str) -> Any:  # noqa: ANN401 - a `mavfi.levels.level.Level`, which imports this module
    """A fault level by name; a BadInputError if there is none, or what brings it is not installed."""
    return load_object("level", name, GROUP, SHIPPED)()


@cache
def level_names() -> tuple[str, ...]:
    """Names of all levels, those of the core first."""
    return tuple(dict.fromkeys([*SHIPPED, *sorted(known(GROUP, SHIPPED))]))


def fault_from_json(data: dict[str, Any]) -> Fault:
    """Inverse of `to_json` of any fault; an unknown level is a BadInputError."""
    content: dict[str, Any] = {}
    if isinstance(data, dict):
        content = dict(data)
    level = content.pop("level", None)
    if not isinstance(level, str) or level not in level_names():
        raise BadInputError(f"fault: level {not_known(level, level_names())}")
    fault: Fault = find_level(level).fault.from_json(content)
    return fault
