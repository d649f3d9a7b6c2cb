"""Time that a plan adds to flights, with times that were measured in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mavfi.extras.hardening.advise import times_of
from mavfi.extras.hardening.certify import Certificate
from mavfi.extras.hardening.measure import Timed
from mavfi.extras.hardening.observed import Seen
from mavfi.extras.hardening.target import Target
from mavfi.ir.build import name_of

TOLERANCE = 0.02
"""Share of a flight's kernel time by which a plan may exceed its budget: the time of a function that takes most of a
flight is measured within a few per cent."""
_SECONDS = 0.25
"""For how long a plain function is timed, for its share of a flight (s)."""
Key = tuple[str, str]
"""Function and signature, as in a plan."""


@dataclass(frozen=True, slots=True)
class Spending:
    """Time that a plan adds to the flights of a planner, as a share of their kernel time.

    Attributes:
        planner: Of the flights.
        measured: With the time ratios that the certificate measured.
        planned: With those of the plan, in the same flights.
        budget: That of the plan; None = not known.
    """

    planner: str
    measured: float
    planned: float
    budget: float | None = None

    @property
    def refuted(self) -> bool:
        """Whether more is added than the budget, or without one than planned, by more than `TOLERANCE`."""
        return self.measured > (self.planned if self.budget is None else self.budget) + TOLERANCE


def key_of(seen: Seen) -> Key:
    """Function and signature, as in a plan."""
    return name_of(seen.function), seen.signature_text


def ticks_of(seen: Seen) -> float:
    """Ticks of the time stamp counter per plain call of a function."""
    target = Target(("",), seen)
    ticks, _ = times_of(target, [Timed.code_of(target.source, target.module)], _SECONDS)
    return ticks


def spending_of(
    planner: str, flown: Sequence[Seen], ticks: Mapping[Key, float], certificates: Sequence[Certificate],
    budget: float | None,
) -> Spending:  # fmt: skip
    """What a plan adds to flights.

    Args:
        planner: Of the flights.
        flown: All functions of their kernels.
        ticks: As of `ticks_of`, for each of these.
        certificates: Of the functions that the plan protects; those without a measured time count as planned.
        budget: That of the plan.
    """
    spent = {key_of(seen): seen.total * ticks[key_of(seen)] for seen in flown}
    whole = sum(spent.values())
    own = [(spent.get((one.function, one.signature), 0.0) / whole, one) for one in certificates]
    planned = sum(share * (one.planned_time - 1) for share, one in own)
    measured = sum(share * ((one.time or one.planned_time) - 1) for share, one in own)
    return Spending(planner, measured, planned, budget)
