"""Golden flights in which every call of a planned function runs its protected code."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mavfi.extras.hardening.compiled import Compiled, compiled
from mavfi.extras.hardening.observed import entries_of
from mavfi.extras.hardening.plan import Plan
from mavfi.extras.hardening.protected import protection_of
from mavfi.faults.levels.instruction.variant import signature_of
from mavfi.flight.fly import fly
from mavfi.ir.build import name_of
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN


@dataclass(frozen=True, slots=True)
class GoldenCheck:
    """Flights without a fault, plain and protected.

    Attributes:
        flights: Number of pairs.
        same: Pairs with equal digests.
        calls: Calls of protected code.
        alarms: Of these, detections: all false.
    """

    flights: int = 0
    same: int = 0
    calls: int = 0
    alarms: int = 0

    @property
    def passed(self) -> bool:
        """Whether protection changes nothing without a fault."""
        return self.same == self.flights and self.alarms == 0

    def plus(self, other: "GoldenCheck") -> "GoldenCheck":
        """Both checks as one: the sums of all counts."""
        return GoldenCheck(
            self.flights + other.flights, self.same + other.same, self.calls + other.calls, self.alarms + other.alarms
        )

    def to_json(self) -> dict[str, int]:
        """Plain data."""
        return asdict(self)


class Guarded:
    """A function of which planned signatures run protected code; after a detection the plain one runs.

    Attributes:
        calls: Calls of protected code.
        alarms: Detections.
    """

    def __init__(self, function: Any, plan: Plan) -> None:
        self._function, self._plan = function, plan
        self._compiled: dict[tuple[Any, ...], Callable[..., Any] | None] = {}
        self.calls = self.alarms = 0

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        signature = signature_of(args)
        if signature not in self._compiled:
            self._compiled[signature] = protected_code(self._function, signature, self._plan)
        compiled = self._compiled[signature]
        if compiled is None:
            return self._function(*args)
        self.calls += 1
        try:
            return compiled(*args)
        except SystemError:
            self.alarms += 1
            return self._function(*args)


def protected_code(function: Any, signature: tuple[Any, ...], plan: Plan) -> Compiled | None:
    """Protected machine code of a function; None if the plan does not name it.

    Raises:
        BadInputError: The plan was made for other code.
    """
    protection = protection_of(plan, name_of(function), signature)
    return None if protection is None else compiled(function, signature, protection)[0]


def check_golden(scenario: Scenario, plan: Plan, kernels: Sequence[str]) -> GoldenCheck:
    """Fly a mission plain and with protected functions, and compare."""
    names = entries_of(kernels)
    made = {name: Guarded(getattr(PLAIN, name), plan) for name in names}
    with np.errstate(all="ignore"):
        plain = fly(scenario).log.digest()
        own = fly(scenario, functions=PLAIN.instrumented(names, lambda name, _: made[name])).log.digest()
    calls, alarms = (sum(getattr(one, count) for one in made.values()) for count in ("calls", "alarms"))
    return GoldenCheck(1, int(plain == own), calls, alarms)
