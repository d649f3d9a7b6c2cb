"""Injection into a single kernel: count and resolve its instructions, draw faults, and inject them.

Kernels are functions compiled by `mavfi.numerics.jit.kernel_jit`; no other part of mavfi is needed.
"""

import hashlib
import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from mavfi.errors import BadInputError
from mavfi.ir.build import name_of
from mavfi.ir.forked import run_in_child
from mavfi.ir.injection.table import InjectionSite, parse_selection
from mavfi.ir.injection.variant import variant_for
from mavfi.ir.module import BuildError
from mavfi.levels.instruction.fault import InstructionFault, Model
from mavfi.levels.instruction.plan import budget_for, plan
from mavfi.record import Injection

_MAX_ROUNDS = 40
_MIN_BATCH = 256
"""Rounds of drawing for a class of instructions, and least number of draws in each."""


@dataclass(frozen=True, slots=True)
class InjectedCall:
    """The effect of a fault on one call.

    Attributes:
        how: "masked": result and arguments are bit-identical to the fault-free call; "sdc": they differ; "crash": a
            signal; "hang": the instruction budget was exhausted; "exception"; "not_activated": the instruction was
            not reached.
        injection: Record of the injection.
        detail: Name of the signal, or text of the exception.
    """

    how: Literal["masked", "sdc", "crash", "hang", "exception", "not_activated"]
    injection: Injection
    detail: str = ""


def count(kernel: Any, *args: Any) -> int:
    """Number of values that a compiled function writes: its injectable dynamic instructions.

    Modifies the arguments as a call does.

    Raises:
        NotInstrumentableError: The function cannot be instrumented exactly.
    """
    return variant_for(kernel, args).count(*args)[1]


def histogram(kernel: Any, *args: Any) -> list[tuple[InjectionSite, int]]:
    """All static instructions of a compiled function and their execution counts; modifies arguments as a call does."""
    variant = variant_for(kernel, args)
    return variant.table.executions(variant.tally(*args)[1])


def resolve(kernel: Any, indices: Sequence[int], *args: Any) -> list[InjectionSite | None]:
    """Static instructions at the given dynamic indices (from 0, in any order) of a call, which modifies the arguments.

    None for an index beyond the last.
    """
    return variant_for(kernel, args).resolve(indices, *args)[1]


def draw(
    kernel: Any, n: int, *args: Any, which: str = "all", model: Model = "one_bit", seed: int = 0, bits: int = 2
) -> list[InstructionFault]:
    """Draw faults for one call: uniform over its dynamic instructions of a class, then over bits.

    Args:
        kernel: A compiled function.
        n: Number of faults.
        *args: Arguments of the call; they are not modified.
        which: Class of instructions, see `mavfi.ir.injection.table`.
        model: One of `fault.MODELS`, see `mavfi.levels.instruction.plan`.
        seed: Seed of the draw.
        bits: Number of bits for the model "bits".

    Raises:
        BadInputError: No instruction of that class was found in some thousand draws.
    """
    variant = variant_for(kernel, args)
    selection = parse_selection(which)
    # How many instructions there are.
    random = np.random.default_rng(seed)
    total = int(run_apart(partial(count, kernel, *args)))
    if total == 0:
        raise BadInputError(f"{name_of(kernel)}: it writes no value that could be injected")
    # Indices are drawn from all instructions; those outside the class are dropped.
    faults: list[InstructionFault] = []
    for _ in range(_MAX_ROUNDS):
        indices = random.integers(total, size=max(_MIN_BATCH, n)).tolist()
        sites: list[InjectionSite] = run_apart(partial(resolve, kernel, indices, *args))
        for index, site in zip(indices, sites, strict=True):
            if site in selection and len(faults) < n:
                fault = plan(
                    random,
                    name_of(kernel),
                    variant.ir_sha256,
                    site,
                    index,
                    model,
                    bits,
                    which=which,
                    budget=budget_for(total),
                    seed=seed,
                )
                faults.append(fault)
        if len(faults) == n:
            return faults
    tries = _MAX_ROUNDS * max(_MIN_BATCH, n)
    raise BadInputError(
        f"instructions {which!r}: {len(faults)} found in {tries} tries; "
        f"allowed: a class that {name_of(kernel)} executes"
    )


def inject(kernel: Any, fault: InstructionFault, *args: Any) -> tuple[Any, Injection]:
    """Call a compiled function with a fault in this process; returns the result and the injection.

    Modifies the arguments as the faulty call does. A wild write, a crash or a hang (exit status 77) ends the process:
    use `run_forked` for addresses and control.

    Raises:
        MismatchError: The fault belongs to other machine code.
    """
    variant = variant_for(kernel, args)
    fault.check(variant, kernel)
    budget = fault.budget or budget_for(int(run_apart(partial(count, kernel, *args))))
    result = variant.inject(fault.index, *fault.masks, budget, *args)
    return result, fault.injection(variant.report())


def run_forked(kernel: Any, fault: InstructionFault, *args: Any, timeout: float = 60.0) -> InjectedCall:
    """Call a kernel with a fault in a forked child, and compare with the fault-free call; arguments are not modified.

    The wall-clock limit `timeout` (s) covers hangs outside budgeted instructions.

    Raises:
        MismatchError: The fault belongs to other machine code.
    """
    variant = variant_for(kernel, args)
    fault.check(variant, kernel)
    variant.claim_report()

    def golden_run() -> tuple[bytes, int]:
        result, total = variant.count(*args)
        return digest((result, args)), total

    golden, total = run_apart(golden_run)
    armed = replace(fault, budget=fault.budget or budget_for(total))

    def injected_run() -> bytes:
        result = variant.inject(armed.index, *armed.masks, armed.budget, *args)
        return digest((result, args))

    end = run_in_child(injected_run, timeout)
    report = variant.report()
    injection = armed.injection(report)
    if report is None:
        return InjectedCall("not_activated", injection, end.detail)
    if end.how == "done" and end.payload == golden:
        return InjectedCall("masked", injection)
    if end.how == "done":
        return InjectedCall("sdc", injection)
    return InjectedCall(end.how, injection, end.detail)


def digest(value: Any) -> bytes:
    """Digest of numbers and arrays, bit for bit, including nested tuples and lists."""
    total = hashlib.sha256()
    for part in _bytes(value):
        total.update(part)
    return total.digest()


def _bytes(value: Any) -> Iterator[bytes]:
    """Type and bits of a value, part by part."""
    if isinstance(value, np.ndarray | np.generic):
        yield f"{value.dtype}{value.shape}".encode()
        yield value.tobytes()
    elif isinstance(value, tuple | list):
        yield f"{type(value).__name__}{len(value)}".encode()
        for part in value:
            yield from _bytes(part)
    else:
        if isinstance(value, float):
            number = np.float64(value).tobytes()
        else:
            number = repr(value).encode()
        yield type(value).__name__.encode() + number


def run_apart(work: Callable[[], Any]) -> Any:
    """Result of a fault-free run in a forked child, which leaves the arguments unmodified; failure is a BuildError."""
    end = run_in_child(lambda: pickle.dumps(work()))
    if end.how != "done":
        raise BuildError(f"a run without a fault ended with {end.how} ({end.detail})")
    return pickle.loads(end.payload)
