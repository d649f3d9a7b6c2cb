"""Instruction-level faults: one exact, replayable dynamic instruction of a Numba kernel, once."""

from mavfi.faults.fault import InstructionFault
from mavfi.faults.levels.instruction.api import InjectedCall, count, draw, histogram, inject, resolve, run_forked
from mavfi.faults.levels.instruction.plan import budget_for, choose, injection_of
from mavfi.faults.levels.instruction.table import InjectionSite
from mavfi.faults.levels.instruction.variant import MismatchError, Profiling, Resolving
from mavfi.ir.forked import ChildEnd, ForkPoint, run_in_child
from mavfi.ir.module import BuildError, NotInstrumentableError

__all__ = [
    "BuildError",
    "ChildEnd",
    "ForkPoint",
    "InjectedCall",
    "InstructionFault",
    "MismatchError",
    "Profiling",
    "NotInstrumentableError",
    "Resolving",
    "InjectionSite",
    "budget_for",
    "choose",
    "count",
    "draw",
    "histogram",
    "inject",
    "injection_of",
    "resolve",
    "run_forked",
    "run_in_child",
]
