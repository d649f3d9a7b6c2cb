"""LLVM IR of compiled kernels: reader, printer, translation into machine code, and its cache on disk."""

from mavfi.ir.build import name_of
from mavfi.ir.forked import Ended, ForkPoint, run_in_child
from mavfi.ir.module import Block, Function, Instruction, Module
from mavfi.ir.parser import parse_module
from mavfi.ir.refusal import BuildError, RefusedError

__all__ = [
    "Block", "BuildError", "Ended", "ForkPoint", "Function", "Instruction", "Module", "RefusedError", "name_of",
    "parse_module", "run_in_child",
]  # fmt: skip
