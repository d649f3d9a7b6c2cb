"""Stratified draws: every value class of every source line is struck, and weights lead back to the uniform draw.

A uniform draw of some hundred faults hardly ever strikes a line that runs rarely.  Here the dynamic instructions are
divided into strata by (value class, source line).  Half of the faults follow the strata's shares, half are spread
evenly over the strata; so every stratum is struck, and hardly any weight is above 2 (a defensive mixture: Hesterberg,
Technometrics 37, 1995).  Within a stratum dynamic instructions are uniform, then bits.

The estimand is that of `api.draw`: the rate for one dynamic instruction, uniform, then one of its bits, uniform.  It is
the sum over strata of share x rate within, and so is its estimator (Cochran, Sampling Techniques, 1977, chapter 5).
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.instruction.api import apart, budget_for
from mavfi.faults.instruction.build import name_of
from mavfi.faults.instruction.fault import InstructionFault, Model, plan
from mavfi.faults.instruction.selection import parse_selection
from mavfi.faults.instruction.table import Site
from mavfi.faults.instruction.variant import Passes, Variant, variant_for

_EVEN = 0.5
"""Share of the faults that is spread evenly over strata."""
_Z2 = 1.959963984540054**2


@dataclass(frozen=True, slots=True, order=True)
class StratumKey:
    """What the instructions of a stratum have in common.

    Attributes:
        value_class: "address", "control", "floating_point" or "integer"; "" = all that are too rare for their own.
        file: Source file, relative to the folder from which it was imported; the innermost of inlined calls.
        line: Source line; 0 = not known.
    """

    value_class: str
    file: str
    line: int


REST = StratumKey("", "", 0)
"""Strata that are too many for the wanted number of faults, taken together."""


@dataclass(frozen=True, slots=True)
class Stratum:
    """A stratum and its faults.

    Attributes:
        key: What its instructions have in common.
        instructions: Dynamic instructions in it.
        share: Of all dynamic instructions that were drawn from.
        faults: Drawn from it; at least one.
    """

    key: StratumKey
    instructions: int
    share: float
    faults: tuple[InstructionFault, ...]

    def weight(self, n: int) -> float:
        """Weight of each of its faults among n: the mean of weight x outcome over all n faults is unbiased."""
        return self.share * n / len(self.faults)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A rate and its 95 % interval."""

    n: int
    rate: float
    low: float
    high: float


def key_of(site: Site) -> StratumKey:
    """The stratum of a static instruction."""
    return StratumKey(site.value_class, site.file, site.line)


def densities(sizes: Mapping[StratumKey, int]) -> dict[StratumKey, float]:
    """Which share of the faults goes to which stratum.

    Args:
        sizes: Dynamic instructions of each.
    """
    whole = sum(sizes.values())
    return {key: (1 - _EVEN) * size / whole + _EVEN / len(sizes) for key, size in sizes.items()}


def allocate(sizes: Mapping[StratumKey, int], n: int) -> dict[StratumKey, int]:
    """Number of faults in each stratum: one at least, else in the shares of `densities`.

    Args:
        sizes: Dynamic instructions of each stratum; no more strata than faults.
        n: Of all faults.

    Returns:
        Numbers whose sum is n.
    """
    wanted = densities(sizes)
    keys = sorted(sizes)
    numbers = np.ones(len(keys), np.int64)
    ideal = np.array([wanted[key] for key in keys])
    for _ in range(n - len(keys)):  # Webster's method: to whom it is owed most
        numbers[int(np.argmax(ideal / (numbers + 0.5)))] += 1
    return dict(zip(keys, numbers.tolist(), strict=True))


def pooled(sizes: Mapping[StratumKey, int], n: int) -> dict[StratumKey, StratumKey]:
    """The stratum in which each one is struck: its own, or `REST` for the smallest where there are more than n.

    Args:
        sizes: Dynamic instructions of each stratum.
        n: Of all faults.
    """
    order = sorted(sizes, key=lambda key: (-sizes[key], key))
    kept = set(order if len(order) <= n else order[: n - 1])
    return {key: key if key in kept else REST for key in order}


def draw_stratified(
    kernel: Any, n: int, *args: Any, which: str = "all", model: Model = "one_bit", seed: int = 0, bits: int = 2
) -> list[Stratum]:
    """Draw faults for one call, in strata by value class and source line.

    Where there are more strata than faults, the smallest are taken together.

    Args:
        kernel: A compiled function.
        n: How many faults, over all strata.
        *args: Its arguments; they stay as they are.
        which: Class of instructions, see `mavfi.faults.instruction.selection`; shares are those within the class.
        model: "one_bit", "bits", "random" or "zero".
        seed: Of the draw.
        bits: Number of bits for the model "bits".

    Returns:
        Strata with their faults; `estimate` puts outcomes together again.

    Raises:
        BadInputError: n is below 1, or the call executes no instruction of that class.
    """
    if n < 1:
        raise BadInputError(f"number of faults: {n}; allowed: 1 or more")
    variant = variant_for(kernel, args)
    times = np.frombuffer(apart(lambda: variant.profile(*args)[1].tobytes()), np.int64)
    members = _members(variant, times, which)
    if not members:
        raise BadInputError(f"instructions {which!r}: {name_of(kernel)} executes none; allowed: a class that it does")
    homes = pooled({key: sum(int(times[site.block]) for site in sites) for key, sites in members.items()}, n)
    joined: dict[StratumKey, list[Site]] = {}
    for key, sites in members.items():
        joined.setdefault(homes[key], []).extend(sites)
    sizes = {key: sum(int(times[site.block]) for site in sites) for key, sites in joined.items()}
    random = np.random.default_rng(seed)
    drawn = {
        key: [uniform(random, joined[key], times) for _ in range(number)] for key, number in allocate(sizes, n).items()
    }
    passes = Passes(len(times), [(site.block, number) for own in drawn.values() for site, number in own])
    passes.starts[:] = np.frombuffer(apart(lambda: _located(variant, passes, args)), np.int64)
    budget = budget_for(int(times @ np.array(variant.table.sizes(), np.int64)))
    whole = sum(sizes.values())

    def fault(site: Site, number: int) -> InstructionFault:
        index = passes.start(site.block, number) + site.offset
        planned = plan(random, name_of(kernel), variant.ir_sha256, site, index, model, bits)
        return replace(planned, which=which, budget=budget)

    return [
        Stratum(key, sizes[key], sizes[key] / whole, tuple(fault(site, number) for site, number in own))
        for key, own in drawn.items()
    ]


def uniform(random: np.random.Generator, sites: Sequence[Site], times: np.ndarray) -> tuple[Site, int]:
    """A dynamic instruction, uniform over the executions of some static ones.

    Args:
        random: Stream.
        sites: The static instructions.
        times: How often each block was executed. Shape (blocks,).

    Returns:
        The static instruction, and which pass through its block, from 0.
    """
    ends = np.cumsum([times[site.block] for site in sites])
    position = int(random.integers(int(ends[-1])))
    place = int(np.searchsorted(ends, position, side="right"))
    return sites[place], position - (int(ends[place - 1]) if place else 0)


def estimate(outcomes: Iterable[tuple[float, Sequence[bool]]]) -> Estimate:
    """The kernel's rate from outcomes by stratum.

    The interval is MOVER's (Zou and Donner, Statistics in Medicine 27, 2008): the distances to Wilson's bounds within
    the strata, times the shares, added as standard errors are.  A stratum without a failure keeps its doubt, so with
    few faults per stratum it is wide.

    Args:
        outcomes: Share of each stratum, and for each of its faults whether it counts.

    Raises:
        BadInputError: Shares do not add up to 1, or a stratum has no faults: its rate is not known.
    """
    parts = [(share, list(counts)) for share, counts in outcomes]
    whole = sum(share for share, _ in parts)
    if not abs(whole - 1.0) < 1e-9:
        raise BadInputError(f"shares of strata: their sum is {whole:g}; allowed: 1")
    if not all(counts for _, counts in parts):
        raise BadInputError("strata: one has no outcomes; allowed: one or more in each")
    rate = below = above = 0.0
    for share, counts in parts:
        own = sum(counts) / len(counts)
        low, high = _wilson(own, len(counts))
        rate += share * own
        below += (share * (own - low)) ** 2
        above += (share * (high - own)) ** 2
    n = sum(len(counts) for _, counts in parts)
    return Estimate(n, rate, max(0.0, rate - sqrt(below)), min(1.0, rate + sqrt(above)))


def sizes_of(sites: Iterable[tuple[Site, int]]) -> dict[StratumKey, int]:
    """Dynamic instructions of each stratum.

    Args:
        sites: Static instructions, and how often each is executed.
    """
    found: Counter[StratumKey] = Counter()
    for site, times in sites:
        found[key_of(site)] += times
    return {key: size for key, size in found.items() if size}


def _members(variant: Variant, times: np.ndarray, which: str) -> dict[StratumKey, list[Site]]:
    """The executed static instructions of a class, by stratum."""
    selection = parse_selection(which)
    found: dict[StratumKey, list[Site]] = {}
    for block, number in zip(variant.table.blocks, times, strict=True):
        for site in block if number else ():
            if site in selection:
                found.setdefault(key_of(site), []).append(site)
    return found


def _located(variant: Variant, passes: Passes, args: tuple[Any, ...]) -> bytes:
    variant.locate(passes, *args)
    return passes.starts.tobytes()


def _wilson(rate: float, n: int) -> tuple[float, float]:
    """Wilson's score interval."""
    centre = (n * rate + _Z2 / 2) / (n + _Z2)
    half = sqrt(_Z2 * (n * rate * (1 - rate) + _Z2 / 4)) / (n + _Z2)
    return (0.0 if rate <= 0 else max(0.0, centre - half)), (1.0 if rate >= 1 else min(1.0, centre + half))
