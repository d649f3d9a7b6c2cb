"""Instruction-level faults: one dynamic instruction of a Numba kernel, exactly, replayable, once."""

from mavfi.faults.instruction.api import Outcome, budget_for, count, draw, histogram, inject, resolve, run_forked
from mavfi.faults.instruction.fault import InstructionFault, Strike
from mavfi.faults.instruction.forked import Ended, ForkPoint, run_in_child
from mavfi.faults.instruction.handle import Counting, Injecting, Locating, Profiling, Resolving, choose, plan_flight
from mavfi.faults.instruction.refusal import BuildError, MismatchError, RefusedError
from mavfi.faults.instruction.stratified import Estimate, Stratum, draw_stratified, estimate
from mavfi.faults.instruction.table import Site

__all__ = [
    "BuildError", "Counting", "Ended", "Estimate", "ForkPoint", "Injecting", "InstructionFault", "Locating",
    "MismatchError", "Outcome", "Profiling", "RefusedError", "Resolving", "Site", "Stratum", "Strike", "budget_for",
    "choose", "count", "draw", "draw_stratified", "estimate", "histogram", "inject", "plan_flight", "resolve",
    "run_forked", "run_in_child",
]  # fmt: skip
