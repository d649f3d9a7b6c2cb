"""What a fault is: planned data (`Fault`), and what happened (`Injection`)."""

import math
from dataclasses import asdict, dataclass
from typing import Any

NO_SITE = -1
"""`Fault.time_us` of a draw for which the golden flight has no publication."""


@dataclass(frozen=True, slots=True)
class FaultSite:
    """Where a fault strikes: a field of an inter-kernel state, in one of its elements if it is in a list."""

    state: str
    field: str
    element: int | None = None

    def __str__(self) -> str:
        element = "" if self.element is None else f"[{self.element}]"
        return f"{self.state}.{self.field}{element}"


@dataclass(frozen=True, slots=True)
class Fault:
    """A planned fault.

    Attributes:
        level: "state" or "instruction"; "register" exists for another injector.
        site: Where.
        time_us: The first publication at or after this instant is struck (of those that consumers act on); `NO_SITE`
            = the golden flight has no site for what was drawn, which is reported and never redrawn.
        bit: Bit that is flipped; None = null fault: the whole path through the injector with an empty mask.
        lifetime: "once".
        operation: "flip".
        stratum: Stratum of the draw, e.g. "sign_exponent" (see faults/strata.py), "" where named by hand.
        weight: Probability that a bit drawn from the whole word falls in the stratum, for whole-word rates. Of the
            level "instruction": how much likelier a uniform draw comes to its value class and line; 1 = as likely.
        stage: PPC stage that was drawn.
        seed: Seed of the draw.
        instruction: Of the level "instruction": the planned `InstructionFault` as plain data; the site is then kernel
            and function, and the instant that of the struck call.
    """

    level: str
    site: FaultSite
    time_us: int = 0
    bit: int | None = None
    lifetime: str = "once"
    operation: str = "flip"
    stratum: str = ""
    weight: float = 1.0
    stage: str = ""
    seed: int = 0
    instruction: dict[str, Any] | None = None

    @property
    def has_site(self) -> bool:
        """Whether the golden flight had a publication to strike when the fault was drawn."""
        return self.time_us != NO_SITE

    def to_json(self) -> dict[str, Any]:
        """Plain data; without what faults of this level do not have."""
        data = asdict(self)
        if self.instruction is None:
            del data["instruction"]
        return data

    @staticmethod
    def from_json(data: dict[str, Any]) -> "Fault":
        """Inverse of `to_json`."""
        return Fault(**{**data, "site": FaultSite(**data["site"])})


@dataclass(frozen=True, slots=True)
class Injection:
    """What the injector did.

    Attributes:
        level: As in the fault.
        site: The site that was struck, as text.
        time_s: When (s).
        bit: Which bit; None for a null fault.
        before: Value before (float, int or bool).
        after: Value after.
        hit: Whether the publication came and the bits were changed as planned (for a null fault: left as they were).
    """

    level: str
    site: str
    time_s: float
    bit: int | None
    before: float | int | bool | None
    after: float | int | bool | None
    hit: bool

    def to_json(self) -> dict[str, Any]:
        """Plain data; infinities and NaN as text, since JSON has none."""
        return asdict(self) | {"before": _plain(self.before), "after": _plain(self.after)}


def _plain(value: float | int | bool | None) -> float | int | bool | str | None:
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
