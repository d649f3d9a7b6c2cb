"""The second plan of a golden flight, by numbers of calls: where the authors' injector of registers fires."""

from collections.abc import Collection, Mapping

from mavfi.flight.loop import Listener
from mavfi.ir.injection.variant import Profiling
from mavfi.pipeline.kernel import Kernel
from mavfi.states import PLANNERS, STATES, State

_PLANNER = STATES["planning.path"].writer
"""Name of the planner's kernel."""


class SecondPlan(Listener):
    """Notes in a golden flight which calls follow the beginning of the planner's second step.

    Args:
        counters: The functions whose calls are counted, by name.
        of_plug_in: Names of those that a planner calls which is a plug-in.
    """

    def __init__(self, counters: Mapping[str, Profiling], of_plug_in: Collection[str] = ()) -> None:
        self._counters = counters
        self._of_planner = {*of_plug_in, *(entry for entries in PLANNERS.values() for entry in entries)}
        self._plans = 0
        self._first_calls: dict[str, int] = {}

    def after_step(self, kernel: Kernel, states: list[State], now: int) -> None:
        """Note how often the functions have been called by the beginning of the planner's second step.

        Its functions have by then been called as often as at the end of the first one; all others as at the end of the
        second one, since nothing else is called during a step.
        """
        del now
        if kernel.name != _PLANNER or not states:
            return
        self._plans += 1
        for entry, counter in self._counters.items():
            noted_after = 2  # steps of the planner
            if entry in self._of_planner:
                noted_after = 1
            if self._plans == noted_after:
                self._first_calls[entry] = len(counter.counts)

    def first_calls(self) -> dict[str, int]:
        """Index of the first such call of each function; after its last one if there was no second plan."""
        if self._plans < 2:
            return {entry: len(counter.counts) for entry, counter in self._counters.items()}
        return self._first_calls
