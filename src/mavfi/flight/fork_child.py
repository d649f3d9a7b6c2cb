"""A process forked at an injected call: it makes the call with the fault, completes the flight, and reports."""

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from mavfi.faults.fault import CallFault
from mavfi.flight.instruction_cases import ChildReport, FaultCase, Output, Published
from mavfi.ir.forked import ForkPoint
from mavfi.ir.injection.arena import arena, copy_result
from mavfi.ir.injection.table import DATA
from mavfi.ir.injection.variant import Variant, changed_nothing
from mavfi.pipeline.memory import copied, same
from mavfi.record import FlightLog
from mavfi.rewriting import rewriter

MAP_FUNCTIONS = frozenset({"insert_scan", "collect", "update_voxels", "apply_updates"})
"""Functions that write maps."""


@dataclass(slots=True)
class ForkedChild:
    """The task of this process.

    Attributes:
        point: The fork.
        case: The fault.
        step_fails: Whether it is the second child of a fault, and the step in progress has no result: at the end of it
            the node of the kernel dies, or repeats it.
        call_same: Whether result and arguments of the injected call are bit-identical to the golden ones.
        planned: Whether the injected call could write its own memory only.
        comparable: Whether, moreover, all differences from the golden flight are in results and memory of kernels, so
            that the flights are the same from an instant at which these are.
        output: Output of the injected step.
    """

    point: ForkPoint
    case: FaultCase
    step_fails: bool
    call_same: bool = False
    planned: bool = True
    comparable: bool = True
    output: Output | None = None

    def call(
        self,
        variant: Variant,
        fault: CallFault,
        function: Callable[..., Any],
        args: tuple[Any, ...],
        *,
        is_protected: bool,
        calls_may_shift: bool,
    ) -> Any:  # noqa: ANN401
        """The result of the call with the fault; ends this process if the remainder of the flight is the golden one."""
        # The error-free call, on copies of the arguments.
        placed = arena().place(args)  # preserves strides, which a copy may not: they select the compiled variant
        if placed is None:
            copies = tuple(copied(argument) for argument in args)
        else:
            copies = placed.args
        golden = copy_result((function(*copies), copies))  # the injected call reuses the arena
        before = copy_result(args)

        # The call with the fault.
        try:
            result = variant.inject(fault.index, *fault.masks, fault.budget, *args)
        except SystemError as error:
            if not (is_protected and rewriter().is_detection(error)):
                raise
            self.end(ChildReport(None, None, call_same=False, detected=True))
        self.call_same = same((result, args), golden)

        # The flight need not be completed if the fault missed, or changed nothing.
        report = variant.report()
        self.planned = report is not None and report.planned
        self.comparable = self.planned and _is_contained(fault.entry, before, golden[1], args)
        if calls_may_shift and changed_nothing(report):
            self.end(ChildReport(None, None, call_same=True, missed=True))
        if self.call_same and report is not None and (report.planned or report.site.value_class in DATA):
            self.end(ChildReport(None, None, call_same=True))
        return result

    def report(
        self, log: FlightLog, publications: list[Published] | None, watched: Mapping[str, FlightLog] | None = None
    ) -> NoReturn:
        """End this process with the log of its flight, and those with detectors, by arm, as far as they are known."""
        self.end(ChildReport(log, self.output, self.call_same, published=publications, watched=watched or {}))

    def end(self, report: ChildReport) -> NoReturn:
        """End this process with a report."""
        self.point.finish(pickle.dumps(report))


def _is_contained(entry: str, before: Any, golden: Any, injected: Any) -> bool:  # noqa: ANN401
    """Whether a call changed no argument that checkpoints do not compare, other than as without the fault.

    They compare the memory of kernels.  Inputs are not memory, so they must be as before; of maps they compare the
    cells, but not their stamps and counters.
    """
    if isinstance(golden, tuple):
        return all(_is_contained(entry, *parts) for parts in zip(before, golden, injected, strict=True))
    return same(golden, injected) or (entry not in MAP_FUNCTIONS and not same(before, golden))
