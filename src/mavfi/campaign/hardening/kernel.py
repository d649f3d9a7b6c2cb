"""Protection of any function compiled by `kernel_jit`, from calls of one's own: no mission, no ledger.

calls = [(values, out) for ...]
found = harden(function, calls[:20], budget=0.2)
certificate = certify_function(function, calls[20:], found.planned)
protected = found.code(calls[0])
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.campaign.hardening.advise import Step, prepare, timed_steps
from mavfi.campaign.hardening.certify import Certificate, Pair, certify
from mavfi.campaign.hardening.golden import protected_code
from mavfi.campaign.hardening.learned import injections_in
from mavfi.campaign.hardening.observed import Seen
from mavfi.campaign.hardening.study import planned_of
from mavfi.campaign.hardening.target import Target
from mavfi.campaign.overheads import processor
from mavfi.errors import BadInputError
from mavfi.faults.instruction.variant import signature_of, variant_for
from mavfi.hardening.compiled import Compiled
from mavfi.hardening.plan import FunctionPlan, Plan
from mavfi.hardening.recorded import copied
from mavfi.ir.build import name_of

Calls = Sequence[tuple[Any, ...]]
"""Arguments, all of the same types."""


@dataclass(frozen=True, slots=True)
class Hardened:
    """A protected function.

    Attributes:
        function: The plain one.
        planned: Its protection.
        steps: What each share of time buys, from nothing to everything.
    """

    function: Any
    planned: FunctionPlan
    steps: tuple[Step, ...]

    @property
    def plan(self) -> Plan:
        """A plan with this function only, see `mavfi.hardening.plan.save_plan`."""
        return Plan(cpu=processor(), functions=(self.planned,))

    def code(self, args: tuple[Any, ...]) -> Compiled:
        """Protected machine code for the types of these arguments; a detection is a SystemError.

        Raises:
            BadInputError: Nothing is protected, or the arguments have other types than those of the plan.
        """
        if not self.planned.sites:
            raise BadInputError(f"{self.planned.function}: nothing is protected: no step is within the budget")
        found = protected_code(self.function, signature_of(args), self.plan)
        if found is None:
            raise BadInputError(f"{self.planned.function}: not protected; allowed: {self.planned.signature}")
        return found


def harden(
    function: Any, calls: Calls, budget: float, faults: int = 1000, seed: int = 0, *, addresses: bool = False,
    libm: bool = False,
) -> Hardened:  # fmt: skip
    """Choose what to duplicate in a function, from faults injected into some calls.

    Args:
        function: Compiled by `kernel_jit`.
        calls: Arguments; they are not modified.
        budget: Largest increase of its time, e.g. 0.2.
        faults: Number of faults.
        seed: Seed of their draw.
        addresses: Whether addresses are compared before loads, too: fewer crashes, more time.
        libm: Whether calls of mathematical functions (sin, exp, ...) can be duplicated, too.

    Raises:
        BadInputError: There are no calls, their arguments have different types, or the budget is below 0 or no number.
        RefusedError: The function cannot be instrumented exactly.
    """
    if not isinstance(budget, (int, float)) or not 0 <= budget < math.inf:
        raise BadInputError(f"budget: {budget!r}: allowed: a number from 0 on, e.g. 0.2 for 20 % more time")
    seen = see(function, calls)
    target = Target((seen.entry,), seen, injections_in(seen, faults, seed), addresses=addresses, libm=libm)
    _, steps = timed_steps(target, prepare(target))
    affordable = [step for step in steps if step.time <= 1 + budget]
    best = max(affordable, key=lambda step: (step.choice.benefit, -step.time))
    return Hardened(function, planned_of(target, best), steps)


def certify_function(function: Any, calls: Calls, planned: FunctionPlan, faults: int = 400) -> Certificate:
    """Test the protection of a function with fresh faults, in calls that its choice has not seen.

    Raises the errors of `harden`; a plan of other code is a BadInputError.
    """
    return certify(Pair.of(see(function, calls), planned), faults)


def see(function: Any, calls: Calls) -> Seen:
    """What calls show of a function; raises the errors of `harden`."""
    signatures = {signature_of(args) for args in calls}
    if len(signatures) != 1:
        raise BadInputError(
            f"{name_of(function)}: calls of {len(signatures)} types; allowed: calls of one, at least one"
        )
    variant = variant_for(function, calls[0])
    executions = sum(variant.tally(*copied(args))[1] for args in calls)
    return Seen(
        function, function.py_func.__name__, signatures.pop(), variant, np.asarray(executions), len(calls), list(calls)
    )
