"""Instruction faults at machine level and at IR level on small kernels; writes instruction-level.md.

    N=400 python -m benchmarks.machine_level

N: faults per kernel and level (400; three times as many in the shortest call).  Arguments are those of a call in a
golden flight, for the point cloud reduced to the first rays and for the collision check to the next points, as
single-stepping is slow.  At machine level the plain code of the call is single-stepped, and one bit of one destination
register is flipped; at IR level the same call is injected as in campaigns.  The call is also stepped and injected in
code in which all instructions are duplicated, with addresses compared.  All are classified by the same criterion:
result and arguments, bit for bit.
"""

import copy
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import date
from math import hypot
from pathlib import Path
from typing import Any

import capstone
import llvmlite
import numba
import numpy as np

from benchmarks.single_step import SteppedCall
from mavfi.analysis.statistics import Rate, wilson
from mavfi.campaign.fingerprint import processor
from mavfi.errors import BadInputError
from mavfi.extras.hardening.compiled import code_of, copied
from mavfi.extras.hardening.duplicate import MESSAGE, candidates, protect
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.ir.build import environment_of, load_code
from mavfi.ir.injection.variant import signature_of
from mavfi.ir.module import Module
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source
from mavfi.levels.instruction import count, draw, run_forked
from mavfi.levels.instruction.api import digest
from mavfi.mission import MissionSpec
from mavfi.outcomes import Effect
from mavfi.pipeline.functions import PLAIN
from tools.markers import between

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "instruction-level.md"
DETECTED = Effect.DETECTED.label
ENVIRONMENT, AUTOPILOT, SEED = "sparse", "published", 10_000
KERNELS = {"pid": "track", "point_cloud": "back_project", "collision_check": "time_to_collision"}
MORE = {"pid": 3}
"""Times more faults: of 400, 2 % may be 4 %, and its call is the shortest."""
RAYS, POINTS = 24, 3
"""Rays of a point cloud and way-points of a collision check to which long calls are reduced."""
OUTCOMES = ("masked", "sdc", "crash", "hang", "exception", DETECTED)
PROTECTED = "machine, protected"
LEVELS = ("machine", "IR", PROTECTED)


class Recorder:
    """Wraps a function, counts its calls, and stores a copy of the arguments of one call."""

    def __init__(self, function: Any, wanted: int = -1) -> None:
        self._function = function
        self._wanted = wanted
        self.calls = 0
        self.args: tuple[Any, ...] = ()

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        if self.calls == self._wanted:
            self.args = copy.deepcopy(args)
        self.calls += 1
        return self._function(*args)


@dataclass(frozen=True, slots=True)
class Study:
    """One kernel at both levels, and its protected code at machine level.

    Attributes:
        kernel: Name of the kernel.
        function: Name of the called function.
        outcomes: Number of runs by outcome, for each level.
        ir_values: Number of values that the call writes at IR level.
        own: Number of executed instructions in the call's own code.
        injectable: Number of those with an injectable destination.
        out_of_reach: Number of those whose destination cannot be injected.
        protected: Number of executed instructions with an injectable destination in protected code.
    """

    kernel: str
    function: str
    outcomes: dict[str, Counter[str]]
    ir_values: int
    own: int
    injectable: int
    out_of_reach: int
    protected: int


def reduced(entry: str, args: tuple[Any, ...]) -> tuple[Any, ...]:
    """A copy of a call's arguments with fewer rays of the point cloud, or fewer points of the path."""
    fewer = args
    if entry == "back_project":
        ranges, directions, rotation, origin, max_range, points = args
        fewer = (ranges[:RAYS], directions[:RAYS], rotation, origin, max_range, points[:RAYS])
    elif entry == "time_to_collision":
        counter, grid, position, points, first, *rest = args
        fewer = (counter, grid, position, points[first : first + POINTS], 0, *rest)
    same: tuple[Any, ...] = copied(fewer)
    return same


def inject_all(call: SteppedCall, random: np.random.Generator, n: int, tell: Callable[[str], None]) -> Counter[str]:
    """Outcomes of n faults at machine level."""
    outcomes: Counter[str] = Counter()
    for fault in call.draw(random, n):
        outcome = call.inject(fault)
        assert outcome.activated  # a missed injection must not count as masked
        outcomes[DETECTED if MESSAGE in outcome.detail else outcome.how] += 1
        tell(f"{outcomes.total()} of {n}")
    return outcomes


def recorded() -> dict[str, tuple[Any, ...]]:
    """Arguments of the middle call in a golden flight, by function; fewer rays of the point cloud, fewer points."""
    scenario = resolve(MissionSpec(environment=ENVIRONMENT, seed=SEED, autopilot=AUTOPILOT))
    counters = {name: Recorder(getattr(PLAIN, name)) for name in KERNELS.values()}
    fly(scenario, functions=replace(PLAIN, **counters))
    keepers = {name: Recorder(getattr(PLAIN, name), counter.calls // 2) for name, counter in counters.items()}
    fly(scenario, functions=replace(PLAIN, **keepers))
    return {name: reduced(name, keeper.args) for name, keeper in keepers.items()}


def entry_of(kernel: Any, args: tuple[Any, ...]) -> int:
    """Address of a kernel's plain machine code, without Numba's wrapper."""
    signature = signature_of(args)
    kernel.compile(signature)
    compiled = kernel.overloads[signature]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def duplicated(module: Module) -> Module:
    """A module with all instructions duplicated and addresses compared."""
    return protect(module, candidates(module), addresses=True)


def protected(kernel: Any, args: tuple[Any, ...]) -> tuple[Callable[..., Any], int]:
    """Code of a kernel as `duplicated`, and its address without Numba's wrapper."""
    signature = signature_of(args)
    source = cached_source(kernel, signature)
    module = duplicated(parse_module(source.text, source.kernel))
    environment = environment_of(kernel, signature)
    code = load_code(code_of(module), source.wrapper, source.environment, environment)
    called = next(text for text in module.others if source.wrapper in text.split("\n", 1)[0])
    name = next(function.name for function in module.functions if f"{function.name} (" in called)
    engine, _ = code
    address = engine.get_function_address(name[1:].strip('"'))
    return lambda *own_args: code[1](None, own_args, None), int(address)  # the code lives as long as its engine


def study(name: str, function: str, args: tuple[Any, ...], n: int, tell: Callable[[str], None]) -> Study:
    """Inject one call n times at each level."""
    kernel = getattr(PLAIN, function)
    call = SteppedCall(lambda: digest((kernel(*args), args)), entry_of(kernel, args))
    machine = inject_all(call, np.random.default_rng(SEED), n, lambda text: tell(f"{name}, machine level: {text}"))
    code, entry = protected(kernel, args)
    guarded = SteppedCall(lambda: digest((code(*args), args)), entry)
    after = inject_all(guarded, np.random.default_rng(SEED), n, lambda text: tell(f"{name}, {PROTECTED}: {text}"))
    ir: Counter[str] = Counter()
    for fault in draw(kernel, n, *args, seed=SEED):
        injected = run_forked(kernel, fault, *args)
        assert injected.injection.activated
        ir[injected.how] += 1
        tell(f"{name}, IR level: {ir.total()} of {n}")
    values = count(kernel, *copy.deepcopy(args))
    outcomes = {"machine": machine, "IR": ir, PROTECTED: after}
    return Study(name, function, outcomes, values, call.own, len(call.sites), call.out_of_reach, len(guarded.sites))


def rate_text(rate: Rate) -> str:
    """Rate and interval in per cent."""
    assert rate.rate is not None and rate.low is not None and rate.high is not None  # n > 0
    return f"{100 * rate.rate:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


def difference(first: Rate, second: Rate) -> tuple[float, float, float]:
    """Difference of two independent rates and its interval, from their score intervals (Newcombe 1998, method 10)."""
    assert first.rate is not None and first.low is not None and first.high is not None
    assert second.rate is not None and second.low is not None and second.high is not None
    apart = first.rate - second.rate
    below = hypot(first.rate - first.low, second.high - second.rate)
    above = hypot(first.high - first.rate, second.rate - second.low)
    return apart, apart - below, apart + above


def rows(studies: list[Study]) -> Iterator[str]:
    """Rows of the table: both levels of each kernel, protected code, and differences from plain machine code."""
    for made in studies:
        rates = {
            level: [wilson(made.outcomes[level][how], made.outcomes[level].total()) for how in OUTCOMES]
            for level in LEVELS
        }
        for level in LEVELS:
            cells = " | ".join(map(rate_text, rates[level]))
            yield f"| {made.kernel} | {level} | {made.outcomes[level].total()} | {cells} |"
        for level in LEVELS[1:]:
            apart = [difference(*pair) for pair in zip(rates[level], rates["machine"], strict=True)]
            cells = " | ".join(f"{100 * a:+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]" for a, low, high in apart)
            yield f"| {made.kernel} | {level.rpartition(' ')[2]} − machine | | {cells} |"


def table(studies: list[Study]) -> str:
    """The text written to the page."""
    versions = (
        f"Python {sys.version.split()[0]}, numba {numba.__version__}, llvmlite {llvmlite.__version__}, "
        f"numpy {np.__version__}, capstone {capstone.__version__}"
    )
    lines = [
        f"Measured by `make bench NAME=machine_level`: {date.today()} · {processor()} · {versions}. Arguments of the "
        f"call in the middle of a golden flight ({ENVIRONMENT}, {AUTOPILOT}, seed {SEED}), of the point cloud {RAYS} "
        f"rays, of the collision check the next {POINTS} points. Percent, with Wilson's 95 % intervals; differences in "
        "points, with Newcombe's. Protected: all instructions duplicated, addresses compared before loads; this code "
        "is for any x86-64 processor, plain code for the present one.",
        "",
        f"| kernel | level | n | {' | '.join(OUTCOMES)} |",
        f"|---|---|---|{'---|' * len(OUTCOMES)}",
        *rows(studies),
        "",
        *(
            f"- {made.kernel} (`{made.function}`): {made.ir_values} values at IR level; {made.own} machine "
            f"instructions in its own code, {made.injectable} of them with an injectable destination, "
            f"{made.out_of_reach} with one out of reach; {made.protected} injectable in protected code."
            for made in studies
        ),
    ]
    return "\n".join(lines)


def wanted_faults(text: str) -> int:
    """Parse the number of faults per kernel and level.

    Raises:
        BadInputError: It is not a positive integer.
    """
    if not (text.isdigit() and int(text) > 0):
        raise BadInputError(f"N: {text!r}: allowed: a whole number, 1 or more")
    return int(text)


def main() -> None:
    """Inject, and write the table."""
    try:
        n = wanted_faults(os.environ.get("N") or "400")
        args = recorded()
        studies = [study(name, own, args[own], n * MORE.get(name, 1), tell) for name, own in KERNELS.items()]
    except BadInputError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    block = table(studies)
    PAGE.write_text(between(PAGE.read_text(encoding="utf-8"), "machine-level", block), encoding="utf-8")
    sys.stdout.write(f"\n{block}\n")


def tell(text: str) -> None:
    """Print progress."""
    sys.stderr.write(f"\r{text}  ")


if __name__ == "__main__":
    main()
