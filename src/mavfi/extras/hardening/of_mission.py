"""Protection plans of missions: refused if made for other code, also where no protected code runs.

Names are checked before the flight.  IR is compared after it, when the types are known for which a function was called;
the digests are cached, and a plan is compared once per process.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.hardening.plan import FunctionPlan, Plan, check_code, load_plan, signature_text
from mavfi.ir.build import name_of
from mavfi.ir.sources import cached_shape
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE

_compared: set[tuple[FunctionPlan, Any]] = set()
"""Plans of functions that fit the code, with the signature."""


def find_plan(name: str) -> Plan:
    """Read the plan of a mission: a shipped one by name, or a file.

    Raises:
        BadInputError: There is none, or it is refused by `check_plan`.
    """
    plan = load_plan(name)
    check_plan(plan, name)
    return plan


def check_plan(plan: Plan, name: str) -> None:
    """Check a plan without its code; messages contain its name.

    Raises:
        BadInputError: It was made by another compiler, or names an unknown kernel or function.
    """
    plan.check_versions()
    for one in plan.functions:
        if one.kernel not in INJECTABLE:
            allowed = ", ".join(INJECTABLE)
            raise BadInputError(f"protection {name}: kernel {one.kernel!r}: not known; allowed: {allowed}")
        functions = [name_of(getattr(PLAIN, entry)) for entry in INJECTABLE[one.kernel]]
        if one.function not in functions:
            raise BadInputError(
                f"protection {name}: function {one.function!r}: not of kernel {one.kernel}; allowed: "
                + ", ".join(functions)
            )


def check_flown(plan: Plan | None) -> None:
    """Compare a plan with the code of the functions that this process has called; None = nothing to compare.

    Raises:
        BadInputError: A function has other IR than planned, or lacks a planned site.
    """
    left = [] if plan is None else [one for one in _planned(plan) if (one[0], one[2]) not in _compared]
    if not left:
        return
    with ThreadPoolExecutor(2) as pool:  # without an entry in the cache each waits for a process of its own
        shapes = list(pool.map(lambda one: cached_shape(*one[1:]), left))
    for (planned, _, signature), shape in zip(left, shapes, strict=True):
        check_code(planned, *shape)
        _compared.add((planned, signature))


def _planned(plan: Plan) -> Iterator[tuple[FunctionPlan, Any, tuple[Any, ...]]]:
    """Planned functions that have been called: plan, function, and signature."""
    functions = {name_of(getattr(PLAIN, entry)): getattr(PLAIN, entry) for own in INJECTABLE.values() for entry in own}
    for one in plan.functions:
        function = functions.get(one.function)  # None in a stored mission of other code, whose digest is compared
        for signature in list(getattr(function, "overloads", ())):
            if signature_text(signature) == one.signature:
                yield one, function, signature
