"""Several faults in one mission, each at its own instant or after an event of the flight."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, fault_from_json
from mavfi.states import WATCHING

AND = " + "
"""What separates several faults in a text."""
Event = Literal["alarm", "injection"]
"""What a later fault can wait for: the first injection of the mission, or the first alarm after it."""
STARTED_BY_EVENTS = ("state", "message", "memory", "sensor")
"""Levels whose faults can wait for an event: they are injected by the loop of the flight."""
START_FORM = "alarm, injection, each with +SECONDS"
"""What a fault can wait for, for messages."""
_START = re.compile(r"(alarm|injection)(?:\+(\d+(?:\.\d*)?))?")
_LATEST_S = 1e6


def levels_in(text: str | None) -> set[str]:
    """Names of the levels in the text of one fault or several."""
    return {member.partition(":")[0] for member in (text or "").split(AND)}


@dataclass(frozen=True, slots=True)
class Start:
    """Start of a fault that waits for an event, as text e.g. `alarm` or `injection+0.5`.

    Attributes:
        event: What it waits for.
        delay_s: Time from the event to the instant of the fault (s).
    """

    event: Event
    delay_s: float = 0.0

    def __str__(self) -> str:
        if self.delay_s == 0.0:
            return self.event
        return f"{self.event}+{self.delay_s:g}"

    @classmethod
    def parse(cls, text: str) -> "Start | None":
        """The start in a text; None = the text is an instant, or no start at all."""
        match = _START.fullmatch(text)
        if match is None:
            return None
        delay_s = float(match[2] or 0.0)
        if delay_s > _LATEST_S:
            raise BadInputError(f"start {text!r}: {delay_s:g} s: allowed: 0 to {_LATEST_S:g}")
        event: Any = match[1]
        return cls(event, delay_s)


def waits_for_alarm(text: str | None) -> bool:
    """Whether a fault in a text waits for an alarm."""
    starts = [Start.parse(member.rpartition("@")[2]) for member in (text or "").split(AND)]
    return any(start is not None and start.event == "alarm" for start in starts)


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
            if start is not None and fault.level not in STARTED_BY_EVENTS:
                allowed = ", ".join(STARTED_BY_EVENTS)
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
