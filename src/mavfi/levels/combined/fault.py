"""Several planned faults in one mission."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

from mavfi.errors import BadInputError
from mavfi.faults.combined import START_FORM, Start
from mavfi.faults.fault import Fault, FliesFrom, fault_from_json, find_level, level_names
from mavfi.states import WATCHING


@dataclass(frozen=True, slots=True)
class CombinedFault(Fault):
    """Several faults in one mission.

    Attributes:
        faults: The faults; they change the same publication in this order.
        starts: For each, the event that it waits for; None = it has an instant of its own.

    Raises:
        BadInputError: The first fault waits for an event, or a fault of a level that cannot.
    """

    level: ClassVar[Literal["combined"]] = "combined"
    faults: tuple[Fault, ...]
    starts: tuple[Start | None, ...]

    def __post_init__(self) -> None:
        if not self.faults or len(self.faults) != len(self.starts):
            raise BadInputError(f"fault of level combined: {len(self.faults)} faults, {len(self.starts)} starts")
        for fault, start in self.members:
            if fault.level == self.level:
                raise BadInputError("fault of level combined: level combined: allowed: faults of other levels")
            if start is not None and not find_level(fault.level).can_wait:
                allowed = ", ".join(name for name in level_names() if find_level(name).can_wait)
                raise BadInputError(f"fault in {fault.site}: @{start}: allowed for faults of the levels {allowed}")
        if self.starts[0] is not None:
            text = "no fault precedes it; allowed: an instant, or a fault before it"
            raise BadInputError(f"fault in {self.faults[0].site}: @{self.starts[0]}: {text}")

    @property
    def members(self) -> tuple[tuple[Fault, Start | None], ...]:
        """The faults, each with what it waits for."""
        return tuple(zip(self.faults, self.starts, strict=True))

    @property
    def site(self) -> str:
        """Sites of all faults as text."""
        return " + ".join(fault.site for fault in self.faults)

    @property
    def kernel(self) -> str:
        """The detector or recovery in which one of the faults is; "" = none of them is in one."""
        targets = [getattr(fault, "kernel", "") for fault in self.faults]
        return next((target for target in targets if target in WATCHING), "")

    @property
    def in_detector(self) -> bool:
        """See `Fault.in_detector`."""
        return any(fault.in_detector for fault in self.faults)

    @property
    def bit(self) -> None:
        """None: there is no single one."""
        return None

    @property
    def stratum(self) -> str:
        """Always "": tables by bit class have faults in one bit."""
        return ""

    @property
    def weight(self) -> float:
        """Always 1."""
        return 1.0

    @property
    def seed(self) -> int:
        """Seed of the first fault."""
        return self.faults[0].seed

    @property
    def has_site(self) -> bool:
        """Whether one of the faults has a value to change."""
        return any(fault.has_site for fault in self.faults)

    def to_json(self) -> dict[str, Any]:
        """Plain data: each fault in the form of its level, with a key `start` if it waits for an event."""
        faults = []
        for fault, start in self.members:
            data = fault.to_json()
            if start is not None:
                data["start"] = str(start)
            faults.append(data)
        return {"level": self.level, "faults": faults}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        values = data.get("faults")
        if not isinstance(values, list | tuple) or not all(isinstance(value, dict) for value in values):
            raise BadInputError("fault of level combined: key 'faults': allowed: a list of faults")
        faults = []
        starts = []
        for value in values:
            content = dict(value)
            text = content.pop("start", None)
            start = None
            if text is not None:
                start = Start.parse(str(text))
                if start is None:
                    raise BadInputError(f"fault of level combined: key 'start': {text!r}: allowed: {START_FORM}")
            starts.append(start)
            faults.append(fault_from_json(content))
        return cls(tuple(faults), tuple(starts))


def is_in_calls(fault: Fault) -> bool:
    """Whether a fault is in calls of compiled functions, for which flights fork."""
    return find_level(fault.level).flies_from(fault) in (FliesFrom.CALL, FliesFrom.CALLS)
