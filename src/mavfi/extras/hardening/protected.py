"""Protected kernels in flights.

Protected code gives the bits of plain code, so kernels run plain in every call but an injected one, which executes the
instrumented variant of the protected code.  Its time is charged to the platform, see `flight.compose`.  A detected
difference is handled as by a node that keeps its inputs: arguments and memory are those before the call, the step is
computed again by plain code, its result is published one latency later, and an alarm is recorded.

A fault drawn in plain code is injected into the same execution of the same instruction of protected code, so that arms
with and without protection are paired.  Faults in what the protection adds are drawn in missions that are protected
themselves.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from mavfi.extras.hardening.duplicate import MESSAGE
from mavfi.extras.hardening.protection import protection_of
from mavfi.faults.fault import InstructionFault
from mavfi.faults.levels.instruction import budget_for
from mavfi.faults.levels.instruction.api import apart
from mavfi.faults.levels.instruction.variant import Variant
from mavfi.ir.build import Rewriting
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel
from mavfi.record import AlarmRecord
from mavfi.states import State

SOURCE = "protection"
"""Source of the alarms."""


def rewriting_of(scenario: Scenario) -> Rewriting | None:
    """Transformation of a mission's kernels; None = none is protected."""
    return None if scenario.protection is None else partial(protection_of, scenario.protection)


def paired(fault: InstructionFault, plain: Variant, protected: Variant, args: tuple[Any, ...]) -> InstructionFault:
    """The fault in protected code that corresponds to one in plain code, for a call with these arguments.

    Raises:
        IndexError: The call ends before the instruction.
    """
    # 1. In the plain call, find the execution of a block that contains the fault's dynamic index.
    trace = _trace(plain, args)
    starts = _start_indices(plain, trace)
    step = int(np.searchsorted(starts, fault.index, side="right")) - 1
    block = int(trace[step])
    offset = int(fault.index - starts[step])
    if offset >= plain.sizes[block]:
        raise IndexError(fault.index)

    # 2. Protected code has all plain instructions in the same order in its text, between those that it adds.
    number_in_text = int(plain.sizes[:block].sum()) + offset
    plain_sites = [site for sites in protected.table.blocks for site in sites if not site.role]
    site = plain_sites[number_in_text]

    # 3. In the protected call, find the execution of the instruction's block with the same number.
    earlier_executions = int(np.count_nonzero(trace[:step] == block))
    protected_trace = _trace(protected, args)
    protected_step = np.flatnonzero(protected_trace == site.block)[earlier_executions]
    index = int(_start_indices(protected, protected_trace)[protected_step]) + site.offset
    budget = budget_for(int(protected.sizes[protected_trace].sum()))
    return replace(fault, index=index, ir_sha256=protected.ir_sha256, budget=budget)


def _trace(variant: Variant, args: tuple[Any, ...]) -> np.ndarray:
    """Executed blocks of a call, in order. Shape (n,)."""
    executions = apart(lambda: variant.tally(*args)[1])
    trace: np.ndarray = apart(lambda: variant.profile(*args, room=int(executions.sum()))[2])
    return trace


def _start_indices(variant: Variant, trace: np.ndarray) -> np.ndarray:
    """Dynamic index at which each executed block starts. Shape (n,)."""
    sizes = variant.sizes[trace]
    starts: np.ndarray = np.cumsum(sizes) - sizes
    return starts


def is_detection(error: Exception) -> bool:
    """Whether an exception of a protected call reports a difference between a value and its shadow."""
    return isinstance(error, SystemError) and MESSAGE in str(error)


def alarm_of(kernel: Kernel, states: Sequence[State], now: int) -> AlarmRecord:
    """The alarm of a step, detected at an instant (us), with the states that its recomputation gave."""
    published = states[0].spec.name if states else ""
    return AlarmRecord(now / 1e6, SOURCE, published, kernel.stage.value, outcome="repaired")
