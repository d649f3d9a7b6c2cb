"""Draws of dynamic instructions: uniform over calls, or stratified, with weights that restore the uniform draw.

A uniform draw of some hundred faults rarely reaches a source line that is rarely executed.  Therefore the dynamic
instructions are also divided into strata by (value class, source line).  Half of the faults follow the strata's shares,
half are spread evenly over the strata; thus every stratum is injected, and hardly any weight exceeds 2 (a defensive
mixture: Hesterberg, Technometrics 37, 1995).  Within a stratum dynamic instructions are uniform, then bits.

The estimand is that of the uniform draw: the rate for a uniform dynamic instruction, then a uniform bit of it.  It is
the sum over strata of share x rate within the stratum, and so is its estimator (Cochran, Sampling Techniques, 1977,
chapter 5).  One call has many faults, so each stratum has some (`draw_stratified`).  A mission has few faults and many
strata: each fault falls into a stratum with a known probability, and share / probability is its weight (`pick`); over
all missions the weighted mean is that of the uniform draw (Hansen and Hurwitz, Annals of Mathematical Statistics 14,
1943).
"""

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.fault import InstructionFault, Model
from mavfi.faults.instruction.api import apart
from mavfi.faults.instruction.instrumented import Profiling
from mavfi.faults.instruction.plan import budget_for, plan
from mavfi.faults.instruction.selection import Selection, parse_selection
from mavfi.faults.instruction.table import Site
from mavfi.faults.instruction.variant import Passes, variant_for
from mavfi.ir.build import name_of

_EVEN = 0.5
"""Share of the faults spread evenly over strata."""
_Z2 = 1.959963984540054**2


@dataclass(frozen=True, slots=True, order=True)
class StratumKey:
    """Value class of a stratum's instructions, and source line as in `Site`."""

    value_class: str
    file: str
    line: int


REST = StratumKey("", "", 0)
"""The smallest strata, pooled if there are more strata than faults."""


@dataclass(frozen=True, slots=True)
class Stratum:
    """A stratum: number of dynamic instructions, their share of all, and the faults drawn from it, at least one."""

    key: StratumKey
    instructions: int
    share: float
    faults: tuple[InstructionFault, ...]

    def weight(self, n: int) -> float:
        """Weight of each of its faults among n: the mean of weight x outcome over all n faults is unbiased."""
        return self.share * n / len(self.faults)


@dataclass(frozen=True, slots=True)
class Member:
    """A static instruction of a stratum: counted function, digest of its IR, site, and execution count."""

    function: str
    digest: str
    site: Site
    times: int


@dataclass(frozen=True, slots=True)
class Pick:
    """A dynamic instruction: the static one, and the execution number of its block, from 0.

    Its weight is the share / the probability of its stratum.
    """

    member: Member
    number: int
    weight: float = 1.0


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


def choose(random: np.random.Generator, counts: Sequence[int], n: int) -> list[tuple[int, int]]:
    """Draw dynamic instructions of a whole flight, uniformly; returns call and index in the call, in draw order.

    `counts` has the number of instructions of each call; those of several functions may be concatenated.
    """
    ends = np.cumsum(counts).tolist()
    drawn = random.integers(ends[-1], size=n).tolist()
    calls = [bisect_right(ends, position) for position in drawn]
    return [
        (call, position - (ends[call - 1] if call else 0)) for call, position in zip(calls, drawn, strict=True)
    ]  # fmt: skip


def members_of(executed: Iterable[Member], selection: Selection) -> dict[StratumKey, list[Member]]:
    """Executed static instructions of a class, by stratum."""
    found: dict[StratumKey, list[Member]] = {}
    for member in executed:
        if member.times and member.site in selection:
            found.setdefault(key_of(member.site), []).append(member)
    return found


def sizes_of(strata: Mapping[StratumKey, Sequence[Member]]) -> dict[StratumKey, int]:
    """Number of dynamic instructions of each stratum."""
    return {key: sum(member.times for member in own) for key, own in strata.items()}


def pick(
    random: np.random.Generator, counted: Mapping[str, Profiling], selection: Selection, number: int
) -> list[Pick]:  # fmt: skip
    """Draw dynamic instructions of one kernel in one mission, by stratum; empty if no selected one is executed.

    Strata are drawn systematically, which spreads the faults of one mission over strata.  `counted` has the counts of
    the golden run by function; shares refer to the selection.
    """
    executed = (Member(name, *one) for name, function in counted.items() for one in function.executed())
    strata = members_of(executed, selection)
    sizes = sizes_of(strata)
    if not sizes:
        return []
    probability, whole = densities(sizes), sum(sizes.values())
    keys = sorted(sizes)
    ends = np.cumsum([probability[key] for key in keys])
    positions = random.permutation((np.arange(number) + random.random()) / number) * ends[-1]
    places = np.minimum(np.searchsorted(ends, positions, side="right"), len(keys) - 1)
    chosen = [keys[place] for place in places.tolist()]
    return [uniform(random, strata[key], sizes[key] / whole / probability[key]) for key in chosen]


def uniform(random: np.random.Generator, members: Sequence[Member], weight: float = 1.0) -> Pick:
    """A dynamic instruction, uniform over all executions of the given static ones."""
    ends = np.cumsum([member.times for member in members])
    position = int(random.integers(int(ends[-1])))
    place = int(np.searchsorted(ends, position, side="right"))
    return Pick(members[place], position - int(ends[place]) + members[place].times, weight)


def densities(sizes: Mapping[StratumKey, int]) -> dict[StratumKey, float]:
    """Share of the faults for each stratum, from the numbers of dynamic instructions."""
    whole = sum(sizes.values())
    return {key: (1 - _EVEN) * size / whole + _EVEN / len(sizes) for key, size in sizes.items()}


def allocate(sizes: Mapping[StratumKey, int], n: int) -> dict[StratumKey, int]:
    """Number of faults in each stratum: at least one, otherwise in the shares of `densities`; their sum is n.

    `sizes` has the number of dynamic instructions of each stratum; there are at most n strata.
    """
    wanted = densities(sizes)
    keys = sorted(sizes)
    numbers = np.ones(len(keys), np.int64)
    ideal = np.array([wanted[key] for key in keys])
    for _ in range(n - len(keys)):  # Webster's method: next to the stratum with the largest claim
        numbers[int(np.argmax(ideal / (numbers + 0.5)))] += 1
    return dict(zip(keys, numbers.tolist(), strict=True))


def pooled(sizes: Mapping[StratumKey, int], n: int) -> dict[StratumKey, StratumKey]:
    """The stratum from which each one is drawn: itself, or `REST` for the smallest if there are more than n."""
    order = sorted(sizes, key=lambda key: (-sizes[key], key))
    kept = set(order if len(order) <= n else order[: n - 1])
    return {key: key if key in kept else REST for key in order}


def draw_stratified(
    kernel: Any, n: int, *args: Any, which: str = "all", model: Model = "one_bit", seed: int = 0, bits: int = 2
) -> list[Stratum]:
    """Draw faults for one call, in strata by value class and source line.

    Arguments as for `api.draw`; n is the number of faults over all strata; shares refer to the class.  If there are
    more strata than faults, the smallest are pooled.

    Returns:
        Strata with their faults; `estimate` combines their outcomes.

    Raises:
        BadInputError: n is below 1, or the call executes no instruction of that class.
    """
    if n < 1:
        raise BadInputError(f"number of faults: {n}; allowed: 1 or more")
    variant = variant_for(kernel, args)
    times = np.frombuffer(apart(lambda: variant.tally(*args)[1].tobytes()), np.int64)
    executed = (Member("", variant.ir_sha256, *one) for one in variant.table.executions(times))
    members = members_of(executed, parse_selection(which))
    if not members:
        raise BadInputError(f"instructions {which!r}: {name_of(kernel)} executes none; allowed: a class that it does")
    homes = pooled(sizes_of(members), n)
    joined: dict[StratumKey, list[Member]] = {}
    for key, own in members.items():
        joined.setdefault(homes[key], []).extend(own)
    sizes = sizes_of(joined)
    random = np.random.default_rng(seed)
    picks = {key: [uniform(random, joined[key]) for _ in range(number)] for key, number in allocate(sizes, n).items()}
    passes = Passes(len(times), [(one.member.site.block, one.number) for own in picks.values() for one in own])

    def located() -> bytes:
        variant.locate(passes, *args)
        return passes.starts.tobytes()

    passes.starts[:] = np.frombuffer(apart(located), np.int64)
    budget = budget_for(variant.written(times))
    whole = sum(sizes.values())

    def fault(chosen: Pick) -> InstructionFault:
        site = chosen.member.site
        index = passes.start(site.block, chosen.number) + site.offset
        return plan(
            random, name_of(kernel), variant.ir_sha256, site, index, model, bits, which=which, budget=budget, seed=seed
        )

    return [
        Stratum(key, sizes[key], sizes[key] / whole, tuple(fault(chosen) for chosen in own))
        for key, own in picks.items()
    ]


def estimate(outcomes: Iterable[tuple[float, Sequence[bool]]]) -> Estimate:
    """The kernel's rate, from the share of each stratum and a flag for each of its faults.

    The interval is MOVER's (Zou and Donner, Statistics in Medicine 27, 2008): the distances to Wilson's bounds within
    the strata, times the shares, are combined like standard errors.  A stratum without a failure keeps its uncertainty,
    so with few faults per stratum the interval is wide.

    Raises:
        BadInputError: Shares do not add up to 1, or a stratum has no faults, so that its rate is unknown.
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


def _wilson(rate: float, n: int) -> tuple[float, float]:
    """Wilson's score interval."""
    centre = (n * rate + _Z2 / 2) / (n + _Z2)
    half = sqrt(_Z2 * (n * rate * (1 - rate) + _Z2 / 4)) / (n + _Z2)
    return (0.0 if rate <= 0 else max(0.0, centre - half)), (1.0 if rate >= 1 else min(1.0, centre + half))
