"""Protected kernels in flights: the rewriter of missions with the key `protection`.

A plan is refused if it was made for other code, also where no protected code runs.  Names are checked before the
flight.  IR is compared after it, when the types are known for which a function was called; the digests are cached, and
a plan is compared once per process.

Protected code gives the bits of plain code, so kernels run plain in every call but an injected one, which executes the
instrumented variant of the protected code.  Its time is charged to the platform, see `mavfi.flight.compose`.  A
detected difference is handled as by a node that keeps its inputs: arguments and memory are those before the call, the
step is computed again by plain code, its result is published one latency later, and an alarm is recorded.

A fault drawn in plain code is injected into the same execution of the same instruction of protected code, so that arms
with and without protection are paired.  Faults in what the protection adds are drawn in missions that are protected
themselves.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mavfi.config import parse
from mavfi.errors import BadInputError
from mavfi.extras.hardening.duplicate import MESSAGE, protect
from mavfi.extras.hardening.plan import FunctionPlan, ProtectionPlan, check_code, load_plan, signature_text
from mavfi.ir.build import name_of
from mavfi.ir.injection.variant import Variant
from mavfi.ir.module import Module
from mavfi.ir.sources import cached_shape, shape_of
from mavfi.levels.instruction.api import run_apart
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.instruction.plan import budget_for
from mavfi.pipeline.functions import PLAIN
from mavfi.record import AlarmRecord
from mavfi.rewriting import KEY, Rewriting
from mavfi.states import INJECTABLE, State

SOURCE = KEY
"""Source of the alarms."""
_compared: set[tuple[FunctionPlan, Any]] = set()
"""Plans of functions that were compared with the code and fit it, with the signature."""


class ProtectionRewriter:
    """Rewrites functions by plans of protection; see `mavfi.rewriting.Rewriter`."""

    def load(self, name: str) -> ProtectionPlan:
        """Read a plan: a shipped one by name, or a file."""
        plan = load_plan(name)
        self.check(plan, name)
        return plan.bare

    def read(self, data: Mapping[str, Any], *, stored: bool) -> ProtectionPlan:
        """The plan in a scenario's data."""
        return parse(ProtectionPlan, dict(data), KEY, stored=stored)

    def check(self, plan: ProtectionPlan, name: str) -> None:
        """Check a plan without its code; messages contain its name.

        Raises:
            BadInputError: It was made by another compiler, or names an unknown kernel or function.
        """
        plan.check_versions()
        for planned in plan.functions:
            is_of_mavfi = planned.function.startswith("mavfi.")
            if planned.kernel not in INJECTABLE and not is_of_mavfi:
                continue  # of a plug-in, whose code is compared after the flight
            if planned.kernel not in INJECTABLE:
                allowed = ", ".join(INJECTABLE)
                raise BadInputError(f"protection {name}: kernel {planned.kernel!r}: not known; allowed: {allowed}")
            functions = [name_of(getattr(PLAIN, entry)) for entry in INJECTABLE[planned.kernel]]
            if planned.function not in functions:
                raise BadInputError(
                    f"protection {name}: function {planned.function!r}: not of kernel {planned.kernel}; allowed: "
                    + ", ".join(functions)
                )

    def check_flown(self, plan: ProtectionPlan) -> None:
        """Compare a plan with the code of the functions that this process has called.

        Raises:
            BadInputError: A function has other IR than planned, or lacks a planned site.
        """
        left = [called for called in _called(plan) if (called.plan, called.signature) not in _compared]
        if not left:
            return
        with ThreadPoolExecutor(2) as pool:  # without an entry in the cache each waits for a process of its own
            shapes = list(pool.map(lambda called: cached_shape(called.function, called.signature), left))
        for called, shape in zip(left, shapes, strict=True):
            check_code(called.plan, *shape)
            _compared.add((called.plan, called.signature))

    def time_of(self, plan: ProtectionPlan, kernel: str) -> float:
        """See `ProtectionPlan.time_of`."""
        return plan.time_of(kernel)

    def rewriting(self, plan: ProtectionPlan) -> Rewriting:
        """See `protection_of`."""
        return partial(protection_of, plan)

    def pair(
        self, fault: InstructionFault, plain: Variant, rewritten: Variant, args: tuple[Any, ...]
    ) -> InstructionFault:
        """The fault in protected code that corresponds to one in plain code, for a call with these arguments."""
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
        plain_sites = [site for sites in rewritten.table.blocks for site in sites if not site.role]
        site = plain_sites[number_in_text]

        # 3. In the protected call, find the execution of the instruction's block with the same number.
        earlier_executions = int(np.count_nonzero(trace[:step] == block))
        protected_trace = _trace(rewritten, args)
        protected_step = np.flatnonzero(protected_trace == site.block)[earlier_executions]
        index = int(_start_indices(rewritten, protected_trace)[protected_step]) + site.offset
        budget = budget_for(int(rewritten.sizes[protected_trace].sum()))
        return replace(fault, index=index, ir_sha256=rewritten.ir_sha256, budget=budget)

    def is_detection(self, error: Exception) -> bool:
        """Whether an exception of a protected call reports a difference between a value and its shadow."""
        return isinstance(error, SystemError) and MESSAGE in str(error)

    def alarm(self, stage: str, states: Sequence[State], now: int) -> AlarmRecord:
        """The alarm of a step, with the first of the states that its recomputation gave."""
        state_name = ""
        if states:
            state_name = states[0].spec.name
        return AlarmRecord(now / 1e6, SOURCE, state_name, stage, outcome="repaired")


REWRITER = ProtectionRewriter()


# ---- plans and the code ---------------------------------------------------------------------------------------------
class _CalledFunction(NamedTuple):
    """A planned function that this process has called, with the Numba types of its arguments."""

    plan: FunctionPlan
    function: Any
    signature: tuple[Any, ...]


def _called(plan: ProtectionPlan) -> Iterator[_CalledFunction]:
    """Planned functions that this process has called."""
    functions = {}
    for entries in INJECTABLE.values():
        for entry in entries:
            function = getattr(PLAIN, entry)
            functions[name_of(function)] = function
    for planned in plan.functions:
        # None in a stored mission of other code: its digest is compared
        function = functions.get(planned.function) or _loaded(planned.function)
        for signature in list(getattr(function, "overloads", ())):
            if signature_text(signature) == planned.signature:
                yield _CalledFunction(planned, function, signature)


def _loaded(name: str) -> Any:  # noqa: ANN401 - a function of a plug-in
    """The function of a module that has been imported, by the name of both; None = there is none."""
    module, _, function = name.rpartition(".")
    return getattr(sys.modules.get(module), function, None)


def protection_of(plan: ProtectionPlan, function: str, signature: tuple[Any, ...]) -> "Protection | None":
    """Protection of a function (module and name) for the Numba types of its arguments; None = its code is plain."""
    planned = plan.find(function, signature)
    if planned is not None and planned.sites:
        return Protection(planned)
    return None


@dataclass(frozen=True, slots=True)
class Protection:
    """The rewriter of a planned function's module; see `mavfi.ir.build.Rewrite`."""

    plan: FunctionPlan

    @property
    def key(self) -> bytes:
        """What determines the protected code; measured times and coverage do not."""
        return repr((self.plan.ir_sha256, self.plan.addresses, self.plan.libm, self.plan.sites)).encode()

    def __call__(self, module: Module) -> Module:
        """The protected module; a BadInputError if the plan was made for other code."""
        check_code(self.plan, *shape_of(module))
        return protect(module, self.plan.sites, addresses=self.plan.addresses)


# ---- calls of functions ---------------------------------------------------------------------------------------------
def _trace(variant: Variant, args: tuple[Any, ...]) -> np.ndarray:
    """Executed blocks of a call, in order. Shape (n,)."""
    executions = run_apart(lambda: variant.tally(*args)[1])
    trace: np.ndarray = run_apart(lambda: variant.profile(*args, room=int(executions.sum())).trace)
    return trace


def _start_indices(variant: Variant, trace: np.ndarray) -> np.ndarray:
    """Dynamic index at which each executed block starts. Shape (n,)."""
    sizes = variant.sizes[trace]
    starts: np.ndarray = np.cumsum(sizes) - sizes
    return starts
