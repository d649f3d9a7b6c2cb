"""Rewriting of compiled functions, e.g. their protection: a key of missions that an extra owns.

The extra registers a `Rewriter` as the entry point `protection` of the group `mavfi.rewriters`.  Its plan is part of
the scenario; flights only ask the rewriter what the plan means for the compiled functions that they call.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from mavfi.config import Config
from mavfi.errors import BadInputError
from mavfi.plugins import extensions

KEY = "protection"
"""The key of missions, and the name of the entry point."""

Rewriting = Callable[[str, tuple[Any, ...]], Any]
"""Maps a function (module and name) and the Numba types of its arguments to its `mavfi.ir.build.Rewrite`, or None."""
Fault = TypeVar("Fault")


class Rewriter(Protocol):
    """What flights need to know about rewritten functions; a plan is data that says which functions are rewritten."""

    def load(self, name: str) -> Config:
        """The plan that a mission names, without what flights do not depend on; a BadInputError if there is none."""

    def read(self, data: Mapping[str, Any], *, stored: bool) -> Config:
        """The plan in a scenario's data; a BadInputError if it is invalid."""

    def check(self, plan: Any, name: str) -> None:
        """Raise a BadInputError with the plan's name if it cannot be for this code."""

    def check_flown(self, plan: Any) -> None:
        """Raise a BadInputError if the functions that this process has called are not those of the plan."""

    def time_of(self, plan: Any, kernel: str) -> float:
        """Execution time of a kernel, rewritten / as compiled."""

    def rewriting(self, plan: Any) -> Rewriting:
        """How the plan rewrites functions."""

    def pair(self, fault: Fault, plain: Any, rewritten: Any, args: tuple[Any, ...]) -> Fault:
        """The fault in a rewritten call that corresponds to one in the plain call; an IndexError if there is none.

        Args:
            fault: An instruction fault.
            plain: Variant of the function as compiled, see `mavfi.ir.injection.variant`.
            rewritten: Its rewritten variant.
            args: Arguments of the call.
        """

    def is_detection(self, error: Exception) -> bool:
        """Whether an exception of a rewritten call reports that it has detected a fault."""

    def alarm(self, stage: str, states: Sequence[Any], now: int) -> Any:
        """The `AlarmRecord` of a step that was recomputed after a detection, at an instant (us)."""


def rewriter() -> Rewriter:
    """The installed rewriter; a BadInputError if there is none."""
    installed: Rewriter | None = extensions("mavfi.rewriters").get(KEY)
    if installed is None:
        raise BadInputError(f"{KEY}: no extra that rewrites functions is installed; allowed: none")
    return installed


def rewriting_of(plan: Config | None) -> Rewriting | None:
    """How the plan of a scenario rewrites functions; None = they are as compiled."""
    if plan is None:
        return None
    return rewriter().rewriting(plan)


def check_flown(plan: Config | None) -> None:
    """Raise a BadInputError if the plan of a flown scenario was made for other code."""
    if plan is not None:
        rewriter().check_flown(plan)
