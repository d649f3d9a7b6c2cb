"""Golden flights with other functions: counted, with some arguments kept, or with the protected code of a plan."""

from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from mavfi.extras.hardening.battery import CallRecording
from mavfi.extras.hardening.compiled import Compiled, compiled
from mavfi.extras.hardening.plan import FunctionKey, ProtectionPlan, signature_text
from mavfi.extras.hardening.protected import protection_of
from mavfi.faults.levels.instruction.variant import Variant, signature_of, variant_for
from mavfi.flight.fly import fly
from mavfi.ir.build import name_of
from mavfi.ir.sources import cached_source
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE

_RECORDED_CALLS = 12
"""About how many calls per signature are recorded; at most twice as many."""


@dataclass(slots=True)
class ObservedFunction:
    """What golden flights showed of a function compiled for one signature.

    Attributes:
        function: The compiled function.
        entry: Its name, a field of `KernelFunctions`.
        signature: Numba types of the arguments.
        variant: Its instrumented variant.
        executions: Executions of each block with sites. Shape (blocks,).
        calls: Arguments of some calls, in order.
        total: Number of calls.
    """

    function: Any
    entry: str
    signature: tuple[Any, ...]
    variant: Variant
    executions: np.ndarray
    total: int = 0
    calls: list[tuple[Any, ...]] = field(default_factory=list)

    @property
    def instructions(self) -> int:
        """Dynamic instructions of all calls."""
        return self.variant.written(self.executions)

    @property
    def key(self) -> FunctionKey:
        """Function and signature, as in a plan."""
        return FunctionKey(name_of(self.function), self.signature_text)

    @property
    def signature_text(self) -> str:
        """The signature as in a plan."""
        return signature_text(self.signature)


class ObservedCalls:
    """Replaces a function in a flight: counts its blocks and records arguments, by signature.

    Args:
        entry: Name of the function.
        function: Compiled by `kernel_jit`.
        ahead: Fetches the IR, which takes seconds for the first time, during the flight.
    """

    def __init__(self, entry: str, function: Any, ahead: Executor) -> None:
        self._entry = entry
        self._function = function
        self._ahead = ahead
        self._calls_by_signature: dict[tuple[Any, ...], tuple[ObservedFunction, CallRecording]] = {}

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        signature = signature_of(args)
        if signature not in self._calls_by_signature:
            variant = variant_for(self._function, args)
            blocks = np.zeros(len(variant.table.blocks), np.int64)
            seen = ObservedFunction(self._function, self._entry, signature, variant, blocks)
            self._calls_by_signature[signature] = seen, CallRecording(_RECORDED_CALLS)
            self._ahead.submit(cached_source, self._function, signature)
        seen, recording = self._calls_by_signature[signature]
        recording.note(args)
        result, times = seen.variant.tally(*args)
        seen.executions += times
        return result

    def seen(self) -> list[ObservedFunction]:
        """What the flight showed of the function, by signature, in order of the first call."""
        for seen, recording in self._calls_by_signature.values():
            seen.total = recording.total
            seen.calls = [*recording.arguments.values()]
        return [seen for seen, _ in self._calls_by_signature.values()]


def entries_of(kernels: Sequence[str]) -> tuple[str, ...]:
    """Functions of some kernels, fields of `KernelFunctions`."""
    return tuple(dict.fromkeys(name for kernel in kernels for name in INJECTABLE[kernel]))


def observe(scenario: Scenario, kernels: Sequence[str]) -> dict[str, list[ObservedFunction]]:
    """Fly a golden mission; returns the executed functions by kernel.

    Raises:
        BadInputError: The mission cannot be flown.
        NotInstrumentableError: A kernel cannot be instrumented exactly.
    """
    names = entries_of(kernels)
    with ThreadPoolExecutor(1) as ahead, np.errstate(all="ignore"):
        observers = {name: ObservedCalls(name, getattr(PLAIN, name), ahead) for name in names}
        fly(scenario, functions=PLAIN.instrumented(names, lambda name, _: observers[name]))
    return {kernel: [seen for name in INJECTABLE[kernel] for seen in observers[name].seen()] for kernel in kernels}


class GoldenCheck(NamedTuple):
    """Flights without a fault, plain and protected.

    Attributes:
        flights: Number of pairs.
        same: Pairs with equal digests.
        calls: Calls of protected code.
        alarms: Of these, detections: all false.
    """

    flights: int = 0
    same: int = 0
    calls: int = 0
    alarms: int = 0

    @property
    def passed(self) -> bool:
        """Whether protection changes nothing without a fault."""
        return self.same == self.flights and self.alarms == 0

    def plus(self, other: "GoldenCheck") -> "GoldenCheck":
        """Both checks as one: the sums of all counts."""
        return GoldenCheck(*map(sum, zip(self, other, strict=True)))


class ProtectedFunction:
    """A function of which planned signatures run protected code; after a detection the plain one runs.

    Attributes:
        calls: Calls of protected code.
        alarms: Detections.
    """

    def __init__(self, function: Any, plan: ProtectionPlan) -> None:
        self._function = function
        self._plan = plan
        self._protected: dict[tuple[Any, ...], Compiled | None] = {}
        self.calls = 0
        self.alarms = 0

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        signature = signature_of(args)
        if signature not in self._protected:
            self._protected[signature] = self._compiled(signature)
        protected = self._protected[signature]
        if protected is None:
            return self._function(*args)
        self.calls += 1
        try:
            return protected(*args)
        except SystemError:
            self.alarms += 1
            return self._function(*args)

    def _compiled(self, signature: tuple[Any, ...]) -> Compiled | None:
        """Protected code for a signature; None = it is not planned."""
        protection = protection_of(self._plan, name_of(self._function), signature)
        if protection is None:
            return None
        code, _ = compiled(self._function, signature, protection)
        return code


def check_golden(scenario: Scenario, plan: ProtectionPlan, kernels: Sequence[str]) -> GoldenCheck:
    """Fly a mission plain and with protected functions, and compare."""
    names = entries_of(kernels)
    functions = {name: ProtectedFunction(getattr(PLAIN, name), plan) for name in names}
    with np.errstate(all="ignore"):
        plain = fly(scenario).log.digest()
        protected = fly(scenario, functions=PLAIN.instrumented(names, lambda name, _: functions[name])).log.digest()
    calls = sum(function.calls for function in functions.values())
    alarms = sum(function.alarms for function in functions.values())
    return GoldenCheck(1, int(plain == protected), calls, alarms)
