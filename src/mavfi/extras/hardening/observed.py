"""Golden flights with other functions: counted, with some arguments kept, or with the protected code of a plan."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from mavfi.extras.hardening.battery import CallRecording
from mavfi.extras.hardening.compiled import Compiled, compiled
from mavfi.extras.hardening.plan import FunctionKey, ProtectionPlan, signature_text
from mavfi.extras.hardening.protected import protection_of
from mavfi.faults.levels.instruction.variant import Variant, signature_of, variant_for
from mavfi.flight.fly import fly
from mavfi.flight.targets import Targets
from mavfi.ir.build import name_of
from mavfi.ir.sources import cached_source
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE

_RECORDED_CALLS = 12
"""About how many calls per signature are recorded; at most twice as many."""


class FlightPart(NamedTuple):
    """What one golden flight showed of a function.

    Attributes:
        mission: Environment and seed.
        executions: Executions of each block with sites. Shape (blocks,).
        total: Number of calls.
        calls: Arguments of some calls, in order.
    """

    mission: str
    executions: np.ndarray
    total: int
    calls: Sequence[tuple[Any, ...]]


@dataclass(slots=True)
class ObservedFunction:
    """What golden flights showed of a function compiled for one signature.

    Attributes:
        function: The compiled function.
        entry: Name under which its calls are counted, see `mavfi.flight.targets`.
        signature: Numba types of the arguments.
        variant: Its instrumented variant.
        parts: By flight, of those that call it.
    """

    function: Any
    entry: str
    signature: tuple[Any, ...]
    variant: Variant
    parts: list[FlightPart]

    @property
    def executions(self) -> np.ndarray:
        """Executions of each block with sites. Shape (blocks,)."""
        executions: np.ndarray = np.sum([part.executions for part in self.parts], axis=0)
        return executions

    @property
    def total(self) -> int:
        """Number of calls."""
        return sum(part.total for part in self.parts)

    @property
    def calls(self) -> list[tuple[Any, ...]]:
        """Arguments of some calls, in order."""
        return [arguments for part in self.parts for arguments in part.calls]

    @property
    def missions(self) -> list[str]:
        """Mission of each of `calls`."""
        return [part.mission for part in self.parts for _ in part.calls]

    @property
    def unseen_share(self) -> float:
        """Share of the instructions of a further mission in blocks that none of these executed, as expected.

        Estimated by the share in blocks that one mission alone executed (Good 1953).
        """
        by_part = np.array([part.executions for part in self.parts])
        alone = (by_part > 0).sum(axis=0) == 1
        return self.variant.written(np.where(alone, self.executions, 0)) / max(self.instructions, 1)

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


@dataclass(slots=True)
class _Tally:
    """Counts of the calls of one signature so far: executions of each block, and recorded arguments."""

    variant: Variant
    executions: np.ndarray
    recording: CallRecording


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
        self._calls_by_signature: dict[tuple[Any, ...], _Tally] = {}

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        signature = signature_of(args)
        if signature not in self._calls_by_signature:
            variant = variant_for(self._function, args)
            blocks = np.zeros(len(variant.table.blocks), np.int64)
            self._calls_by_signature[signature] = _Tally(variant, blocks, CallRecording(_RECORDED_CALLS))
            self._ahead.submit(cached_source, self._function, signature)
        tally = self._calls_by_signature[signature]
        tally.recording.note(args)
        result, times = tally.variant.tally(*args)
        tally.executions += times
        return result

    def seen(self, mission: str) -> list[ObservedFunction]:
        """What the flight of a mission showed of the function, by signature, in order of the first call."""
        observed = []
        for signature, tally in self._calls_by_signature.items():
            recording = tally.recording
            part = FlightPart(mission, tally.executions, recording.total, [*recording.arguments.values()])
            observed.append(ObservedFunction(self._function, self._entry, signature, tally.variant, [part]))
        return observed


def functions_of(kernel: str, targets: Targets) -> dict[str, Any]:
    """Functions of a kernel, by the names under which calls are counted; of a plug-in, those of this mission's."""
    if kernel in INJECTABLE:
        return {name: getattr(PLAIN, name) for name in INJECTABLE[kernel]}
    target = targets.find(kernel)
    return {counter: target.functions[name] for counter, name in target.counters.items()}


def functions_of_all(kernels: Sequence[str], targets: Targets) -> dict[str, Any]:
    """Functions of several kernels, see `functions_of`."""
    return {name: function for kernel in kernels for name, function in functions_of(kernel, targets).items()}


def observe(scenario: Scenario, kernels: Sequence[str]) -> dict[str, list[ObservedFunction]]:
    """Fly a golden mission; returns the executed functions by kernel.

    Raises:
        BadInputError: The mission cannot be flown.
        NotInstrumentableError: A kernel cannot be instrumented exactly.
    """
    targets = Targets(scenario)
    functions = functions_of_all(kernels, targets)
    with ThreadPoolExecutor(1) as ahead, np.errstate(all="ignore"):
        observers = {name: ObservedCalls(name, function, ahead) for name, function in functions.items()}
        with targets.instrumented(observers) as table:
            fly(scenario, functions=table)
    mission = f"{scenario.environment.name}-{scenario.seed}"
    return {
        kernel: [seen for name in functions_of(kernel, targets) for seen in observers[name].seen(mission)]
        for kernel in kernels
    }


def merged(seen: Sequence[ObservedFunction]) -> list[ObservedFunction]:
    """Join what several flights showed of the same function and signature."""
    joined: dict[tuple[str, Any], ObservedFunction] = {}
    for observed in seen:
        key = observed.entry, observed.signature
        if key in joined:
            joined[key].parts += observed.parts
        else:
            joined[key] = replace(observed, parts=[*observed.parts])
    return list(joined.values())


def observe_all(
    scenarios: Sequence[Scenario], kernels: Sequence[str], tell: Callable[[str], None]
) -> dict[str, list[ObservedFunction]]:
    """Fly golden missions; returns the executed functions by kernel, with about as many recorded calls as of two.

    Args:
        scenarios: The missions.
        kernels: Kernels whose functions are observed.
        tell: Called with a line of text for each mission.
    """
    stride = max(len(scenarios) // 2, 1)
    seen: dict[str, list[ObservedFunction]] = {kernel: [] for kernel in kernels}
    for number, scenario in enumerate(scenarios):
        tell(f"flying the golden mission {scenario.environment.name} {scenario.seed}")
        for kernel, functions in observe(scenario, kernels).items():
            seen[kernel] += [_thinned(function, number % stride, stride) for function in functions]
    return {kernel: merged(functions) for kernel, functions in seen.items()}


def _thinned(seen: ObservedFunction, start: int, stride: int) -> ObservedFunction:
    """Every `stride`th recorded call, at least one.

    The starts of several missions differ: the first call of a mission, which is always recorded, would count too often.
    """
    (part,) = seen.parts
    first = min(start, len(part.calls) - 1)
    return replace(seen, parts=[part._replace(calls=part.calls[first::stride])])


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
    targets = Targets(scenario)
    functions = {
        name: ProtectedFunction(function, plan) for name, function in functions_of_all(kernels, targets).items()
    }
    with np.errstate(all="ignore"), targets.instrumented(functions) as table:
        plain = fly(scenario).log.digest()
        protected = fly(scenario, functions=table).log.digest()
    calls = sum(function.calls for function in functions.values())
    alarms = sum(function.alarms for function in functions.values())
    return GoldenCheck(1, int(plain == protected), calls, alarms)
