"""What golden flights show of the functions that they call: executions of each block, and arguments of some calls."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavfi.extras.hardening.compiled import copied
from mavfi.extras.hardening.plan import FunctionKey, signature_text
from mavfi.flight.fly import fly
from mavfi.flight.targets import Targets
from mavfi.ir.build import name_of
from mavfi.ir.injection.variant import Variant, signature_of, variant_for
from mavfi.ir.sources import cached_source
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE

_MAX_CALLS = 24
"""Largest number of recorded calls of a function."""
_MAX_RECORDED_BYTES = 1 << 27
"""Largest memory of the recorded arguments of a function, which holds at least one call."""


@dataclass(slots=True)
class CallRecording:
    """Arguments of some calls of a function, evenly spread over all of them.

    Attributes:
        total: Number of calls so far.
        arguments: Arguments before the call, by its number.
    """

    total: int = 0
    arguments: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    _stride: int = 1

    def note(self, args: tuple[Any, ...]) -> None:
        """Count a call that is about to be made, and record its arguments if it is its turn."""
        call = self.total
        self.total += 1
        if call % self._stride:
            return
        self.arguments[call] = copied(args)
        # When there are too many, every other one goes, and later ones are recorded half as often.
        while len(self.arguments) > 1 and self._is_full(_size_of(args)):
            self._stride *= 2
            self.arguments = {n: recorded for n, recorded in self.arguments.items() if n % self._stride == 0}

    def _is_full(self, bytes_per_call: int) -> bool:
        calls = len(self.arguments)
        return calls * bytes_per_call > _MAX_RECORDED_BYTES or calls > _MAX_CALLS


def _size_of(value: Any) -> int:
    """Bytes of the arrays in a value."""
    if isinstance(value, tuple):
        return sum(map(_size_of, value))
    if isinstance(value, np.ndarray):
        return value.nbytes
    return 0


@dataclass(slots=True)
class ObservedFunction:
    """What golden flights showed of a function compiled for one signature.

    Attributes:
        kernels: Kernels that call it, as in a campaign's sampling.
        function: The compiled function.
        signature: Numba types of the arguments.
        variant: Its instrumented variant.
        executions: Executions of each block with sites. Shape (blocks,).
        recording: Number of calls, and arguments of some of them.
    """

    kernels: tuple[str, ...]
    function: Any
    signature: tuple[Any, ...]
    variant: Variant
    executions: np.ndarray
    recording: CallRecording = field(default_factory=CallRecording)

    @property
    def key(self) -> FunctionKey:
        """Name and signature, as in a plan."""
        return FunctionKey(name_of(self.function), signature_text(self.signature))

    @property
    def calls(self) -> list[tuple[Any, ...]]:
        """Arguments of some calls, in order."""
        return [*self.recording.arguments.values()]


class _CountedFunction:
    """Replaces a function in flights: counts its blocks and records arguments, by signature.

    Args:
        kernels: Kernels that call it.
        function: Compiled by `kernel_jit`.
        ahead: Fetches the IR, which takes seconds for the first time, during the flight.
    """

    def __init__(self, kernels: tuple[str, ...], function: Any, ahead: Executor) -> None:
        self._kernels = kernels
        self._function = function
        self._ahead = ahead
        self.observed: dict[tuple[Any, ...], ObservedFunction] = {}

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        signature = signature_of(args)
        if signature not in self.observed:
            variant = variant_for(self._function, args)
            blocks = np.zeros(len(variant.table.blocks), np.int64)
            self.observed[signature] = ObservedFunction(self._kernels, self._function, signature, variant, blocks)
            self._ahead.submit(cached_source, self._function, signature)
        observed = self.observed[signature]
        observed.recording.note(args)
        result, executions = observed.variant.tally(*args)
        observed.executions += executions
        return result


def functions_of(kernels: Sequence[str], targets: Targets) -> dict[str, Any]:
    """Functions of kernels, by the names under which calls are counted; of a plug-in, those of this mission's."""
    functions = {}
    for kernel in kernels:
        if kernel in INJECTABLE:
            functions.update({name: getattr(PLAIN, name) for name in INJECTABLE[kernel]})
        else:
            target = targets.find(kernel)
            functions.update({counter: target.functions[name] for counter, name in target.counters.items()})
    return functions


def observe(
    scenarios: Sequence[Scenario], kernels: Sequence[str], tell: Callable[[str], None] = lambda _: None
) -> list[ObservedFunction]:
    """Fly golden missions; returns the functions of the kernels that they call, in order of kernels and first call.

    Args:
        scenarios: The missions, with the same kernels.
        kernels: Kernels whose functions are observed.
        tell: Called with a line of text for each mission.

    Raises:
        BadInputError: A mission cannot be flown.
        NotInstrumentableError: A kernel cannot be instrumented exactly.
    """
    counted: dict[str, _CountedFunction] = {}
    with ThreadPoolExecutor(1) as ahead, np.errstate(all="ignore"):
        for scenario in scenarios:
            tell(f"flying the golden mission {scenario.environment.name} {scenario.seed}")
            targets = Targets(scenario)
            for name, function in functions_of(kernels, targets).items():
                if name not in counted:
                    callers = tuple(kernel for kernel in kernels if name in functions_of([kernel], targets))
                    counted[name] = _CountedFunction(callers, function, ahead)
            with targets.instrumented(counted) as table:
                fly(scenario, functions=table)
    return [observed for function in counted.values() for observed in function.observed.values()]
