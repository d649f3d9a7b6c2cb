"""Text of several faults in one mission, each at its own instant or after an event of the flight."""

import re
from dataclasses import dataclass
from typing import Any, Literal

from mavfi.errors import BadInputError

AND = " + "
"""What separates several faults in a text."""
Event = Literal["alarm", "injection"]
"""What a later fault can wait for: the first injection of the mission, or the first alarm after it."""
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
