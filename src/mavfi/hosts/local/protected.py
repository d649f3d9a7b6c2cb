"""Protected kernels in flights.

Protected code gives the bits of plain code, so kernels run plain in every call but an injected one, which executes the
instrumented variant of the protected code.  Its time is charged to the platform, see `hosts.loop.compose`.  A detected
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

from mavfi.faults.fault import InstructionFault
from mavfi.faults.instruction import budget_for
from mavfi.faults.instruction.api import apart
from mavfi.faults.instruction.variant import Passes, Variant
from mavfi.flight_log import AlarmRecord
from mavfi.hardening.protection import protection_of
from mavfi.hardening.wrapper import MESSAGE
from mavfi.ir.build import Rewriting
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel
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
    site_counts = plain.sizes
    block_executions = apart(lambda: plain.tally(*args)[1])
    trace = apart(lambda: plain.profile(*args, room=int(block_executions.sum()))[2])  # executed blocks, in order
    end_indices = np.cumsum(site_counts[trace])  # dynamic index after each executed block
    step = int(np.searchsorted(end_indices, fault.index, side="right"))
    if step == len(trace):
        raise IndexError(fault.index)
    block = int(trace[step])
    start_index = int(end_indices[step] - site_counts[block])

    # 2. Identify it by block, offset of the instruction in the block, and number of earlier executions of the block.
    offset = fault.index - start_index
    earlier_executions = int(np.count_nonzero(trace[:step] == block))

    # 3. Protected code has all plain instructions in the same order in its text, between those that it adds.
    number_in_text = int(site_counts[:block].sum()) + offset
    plain_sites = [site for sites in protected.table.blocks for site in sites if not site.role]
    site = plain_sites[number_in_text]

    # 4. Dynamic index of the same execution of that instruction in the protected call.
    def block_start() -> int:
        passes = Passes(len(protected.table.blocks), [(site.block, earlier_executions)])
        protected.locate(passes, *args)
        return passes.start(site.block, earlier_executions)

    total = apart(lambda: protected.count(*args)[1])
    index = apart(block_start) + site.offset
    return replace(fault, index=index, ir_sha256=protected.ir_sha256, budget=budget_for(total))


def is_detection(error: Exception) -> bool:
    """Whether an exception of a protected call reports a difference between a value and its shadow."""
    return isinstance(error, SystemError) and MESSAGE in str(error)


def alarm_of(kernel: Kernel, states: Sequence[State], now: int) -> AlarmRecord:
    """The alarm of a step, detected at an instant (us), with the states that its recomputation gave."""
    published = states[0].spec.name if states else ""
    return AlarmRecord(now / 1e6, SOURCE, published, kernel.stage.value, outcome="repaired")
