"""Certificate of a plan: fresh faults in recorded calls of missions that the choice has not seen.

Faults are drawn over the dynamic instructions of the protected program, so shadows, copies and comparisons can be hit.
The same calls are injected without protection, and these faults once more, instruction by instruction, with it.

Coverage is the share of silent corruptions per call that protection removes, with its interval.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cached_property
from math import hypot, inf, sqrt
from pathlib import Path
from statistics import NormalDist
from typing import Any, Literal, NamedTuple, TypedDict

from mavfi.analysis.statistics import TAIL, Paired, Rate, holm, mcnemar, wilson
from mavfi.campaign.fingerprint import processor
from mavfi.errors import BadInputError, write_text
from mavfi.extras.hardening.advise import HardeningStudy, Tell, codes_of, coverage_in_plan, times_of
from mavfi.extras.hardening.battery import SDC, Battery, InjectionPoint, counts_of
from mavfi.extras.hardening.observed import (
    GoldenCheck,
    ObservedFunction,
    check_golden,
    functions_of_all,
    merged,
    observe,
)
from mavfi.extras.hardening.plan import Coverage, FunctionKey, FunctionPlan, ProtectionPlan
from mavfi.extras.hardening.protected import Protection, check_plan
from mavfi.extras.hardening.target import FunctionTarget, affordable_faults
from mavfi.faults.levels.instruction.build import cached_build
from mavfi.faults.levels.instruction.variant import variant_of
from mavfi.faults.sampling import stream
from mavfi.flight.targets import Targets
from mavfi.ir.build import name_of
from mavfi.ir.module import Module
from mavfi.states import INJECTABLE

_NORMAL = NormalDist()
NO_RATE = Rate(0, None, None, None)
"""That of no injection, or of no prediction."""


def coverage(before: Rate, after: Rate, growth: float) -> Rate:
    """1 - growth x rate after / rate before, with MOVER's interval for a ratio (Donner and Zou 2012).

    Args:
        before: Rate of silent corruption per injection in plain code.
        after: The same in protected code, over all of its instructions.
        growth: Dynamic instructions of protected code / plain code: if each instruction is equally likely to be hit,
            added instructions are hit, too.  Without it each one would dilute the rate and seem to protect.

    Returns:
        Negative if the protection does harm; all None without injections or corruptions in plain code.
    """
    if not before.rate or after.rate is None:
        return Rate(after.n, None, None, None)
    low, high = ratio_bounds(after, before)
    return Rate(after.n, 1 - growth * after.rate / before.rate, 1 - growth * high, 1 - growth * low)


def ratio_bounds(above: Rate, below: Rate) -> tuple[float, float]:
    """Interval of the ratio of two independent rates, from their own intervals."""
    p, low_p, high_p = bounds_of(above)
    q, low_q, high_q = bounds_of(below)
    # MOVER for a ratio (Donner and Zou 2012): roots of a quadratic equation for each bound
    lower = (p * q) ** 2 - low_p * high_q * (2 * p - low_p) * (2 * q - high_q)
    upper = (p * q) ** 2 - high_p * low_q * (2 * p - high_p) * (2 * q - low_q)
    lower_denominator = high_q * (2 * q - high_q)
    upper_denominator = low_q * (2 * q - low_q)
    low = 0.0
    high = inf
    if lower_denominator > 0:
        low = max((p * q - sqrt(max(lower, 0.0))) / lower_denominator, 0.0)
    if upper_denominator > 0:
        high = (p * q + sqrt(max(upper, 0.0))) / upper_denominator
    return low, high


def difference(measured: Rate, predicted: Rate) -> tuple[float, float]:
    """Interval of measured - predicted coverage (MOVER for a difference); infinite if one is not known."""
    if measured.rate is None or predicted.rate is None:
        return -inf, inf
    p, low_p, high_p = bounds_of(measured)
    q, low_q, high_q = bounds_of(predicted)
    gap = p - q
    return gap - hypot(p - low_p, high_q - q), gap + hypot(high_p - p, q - low_q)


def p_value_below(measured: Rate, predicted: Rate) -> float | None:
    """Two-sided p of equal coverages: below 0.05 where the interval of `difference` is below 0; None if not known.

    A normal approximation on the side of its upper bound; 1 if the measured coverage is not lower.
    """
    if measured.rate is None or predicted.rate is None:
        return None
    gap = measured.rate - predicted.rate
    if gap >= 0:
        return 1.0
    half = difference(measured, predicted)[1] - gap
    if half > 0:
        return 2 * _NORMAL.cdf(_NORMAL.inv_cdf(1 - TAIL) * gap / half)
    return 0.0


class Bounds(NamedTuple):
    """A known rate with its 95 % interval."""

    rate: float
    low: float
    high: float


def bounds_of(rate: Rate) -> Bounds:
    """The rate and its interval; it must be known, as with any injection."""
    assert rate.rate is not None and rate.low is not None and rate.high is not None
    return Bounds(rate.rate, rate.low, rate.high)


# ---- the certificate of a function ----------------------------------------------------------------------------------


class Verdict(StrEnum):
    """How a measured coverage relates to its prediction, at 95 %; the values are stored in certificates."""

    CONFIRMED = "confirmed"
    """They agree, and the interval of their difference is narrow enough to tell."""
    REFUTED = "refuted"
    """The measured coverage is lower."""
    BETTER = "better"
    """The measured coverage is higher."""
    UNDECIDED = "undecided"
    """They may agree, but so might most other predictions: there are too few silent corruptions."""
    UNKNOWN = "unknown"
    """There is no prediction, or nothing was measured."""


_TIMED_S = 4.0
"""For how long a function is timed (s): within 1 s the time of `insert_scan`, most of a flight's, varies by 2 %."""
MAX_HALF_WIDTH = 0.2
"""Largest half-width of the interval of measured - predicted coverage with which a prediction is confirmed: a wider one
would contain 0 for almost any prediction."""


class PairedJson(TypedDict):
    """Paired injections as stored; see `mavfi.analysis.statistics.Paired`."""

    n: int
    plain_only: int
    protected_only: int
    p: float


class CertificateJson(TypedDict):
    """A certificate of a function as stored; see `Certificate`.  Rates are the fields of `Rate`."""

    kernel: str
    function: str
    signature: str
    instructions: int
    verdict: str
    growth: float
    time: float | None
    planned_time: float
    before: dict[str, int]
    after: dict[str, int]
    coverage: dict[str, Any]
    sdc_before: dict[str, Any]
    sdc_after: dict[str, Any]
    predicted: dict[str, Any] | None
    paired: PairedJson


class CertificationJson(TypedDict):
    """A certificate of a plan as stored in PLAN.certificate.json; see `Certification`."""

    plan: str
    faults: int
    missions: list[str]
    refuted: bool
    golden: dict[str, int]
    coverage: dict[str, Any]
    predicted: dict[str, Any]
    verdict: str
    cpu: str
    kernels: list[str] | Literal["all"]
    functions: list[CertificateJson]
    unprotected: list[dict[str, Any]]
    spending: list[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class FunctionResult:
    """Result of fresh faults in one function.

    Attributes:
        kernel: That calls it, as in a campaign's sampling.
        function: Module and name.
        signature: Numba types of its arguments.
        instructions: Dynamic instructions of plain code in the observed flights.
    """

    kernel: str
    function: str
    signature: str
    instructions: int

    @property
    def key(self) -> FunctionKey:
        """Function and signature, as in a plan."""
        return FunctionKey(self.function, self.signature)


@dataclass(frozen=True, slots=True)
class Certificate(FunctionResult):
    """What fresh faults show of the protection of one function.

    Attributes:
        before: Effects of injections in plain code, by number.
        after: The same in protected code.
        growth: Dynamic instructions of protected code / plain code.
        predicted: Coverage, from the plan; None = the plan has no prediction.
        paired: Silent corruption in plain (first) and protected code (second), same instruction, execution and bit.
        time: Protected / plain execution time, measured in the observed calls; None = not measured.
        planned_time: The same, from the plan.
    """

    before: dict[str, int]
    after: dict[str, int]
    growth: float
    predicted: Coverage | None
    paired: Paired
    time: float | None = None
    planned_time: float = 1.0

    @property
    def sdc_before(self) -> Rate:
        """Silent corruptions per injection in plain code."""
        return _silent(self.before)

    @property
    def sdc_after(self) -> Rate:
        """Silent corruptions per injection in protected code."""
        return _silent(self.after)

    @property
    def coverage(self) -> Rate:
        """Share of the silent corruptions per call that is removed."""
        return coverage(self.sdc_before, self.sdc_after, self.growth)

    @property
    def predicted_rate(self) -> Rate:
        """The prediction; all None without one."""
        return rate_of(self.predicted)

    @property
    def verdict(self) -> Verdict:
        """See `verdict_of`."""
        return verdict_of(self.coverage, self.predicted_rate)

    def to_json(self) -> CertificateJson:
        """Plain data."""
        paired = self.paired
        return {
            "kernel": self.kernel,
            "function": self.function,
            "signature": self.signature,
            "instructions": self.instructions,
            "verdict": self.verdict.value,
            "growth": self.growth,
            "time": self.time,
            "planned_time": self.planned_time,
            "before": self.before,
            "after": self.after,
            "coverage": asdict(self.coverage),
            "sdc_before": asdict(self.sdc_before),
            "sdc_after": asdict(self.sdc_after),
            "predicted": None if self.predicted is None else self.predicted.model_dump(),
            "paired": {
                "n": paired.n,
                "plain_only": paired.first_only,
                "protected_only": paired.second_only,
                "p": paired.p_value,
            },
        }


@dataclass(frozen=True, slots=True)
class Unprotected(FunctionResult):
    """What fresh faults show of a function that the plan leaves as it is.

    Attributes:
        effects: Effects of injections, by number.
    """

    effects: dict[str, int]

    @property
    def sdc(self) -> Rate:
        """Silent corruptions per injection."""
        return _silent(self.effects)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self) | {"sdc": asdict(self.sdc)}


def _silent(effects: Mapping[str, int]) -> Rate:
    """Silent corruptions per injection."""
    return wilson(effects.get(SDC, 0), sum(effects.values()))


def rate_of(predicted: Coverage | None) -> Rate:
    """A prediction as a rate; all None without one."""
    if predicted:
        return Rate(0, predicted.estimate, predicted.low, predicted.high)
    return NO_RATE


def verdict_of(measured: Rate, predicted: Rate) -> Verdict:
    """Whether a measured coverage agrees with its prediction."""
    if measured.rate is None or predicted.rate is None:
        return Verdict.UNKNOWN
    low, high = difference(measured, predicted)
    if high < 0:
        return Verdict.REFUTED
    if low > 0:
        return Verdict.BETTER
    if (high - low) / 2 > MAX_HALF_WIDTH:
        return Verdict.UNDECIDED
    return Verdict.CONFIRMED


@dataclass
class FunctionPair:
    """A function with and without protection, with the same calls.

    Attributes:
        seen: The plain function.
        planned: Its protection.
        plain: Injections without it.
        protected: Injections with it.
    """

    seen: ObservedFunction
    planned: FunctionPlan
    plain: Battery
    protected: Battery

    @staticmethod
    def of(seen: ObservedFunction, planned: FunctionPlan) -> "FunctionPair":
        """Build the protected variant; `BadInputError` if the plan is of other code."""
        variant = variant_of(seen.function, seen.signature, Protection(planned))
        plain = Battery(seen.entry, seen.function, seen.variant, seen.calls)
        protected = Battery(seen.entry, seen.function, variant, seen.calls)
        return FunctionPair(seen, planned, plain, protected)

    @cached_property
    def target(self) -> FunctionTarget:
        """The function."""
        return FunctionTarget((self.planned.kernel,), self.seen, addresses=self.planned.addresses)

    @property
    def growth(self) -> float:
        """Dynamic instructions of protected code / plain code, over the recorded calls."""
        return float(self.protected.counts.sum() / self.plain.counts.sum())

    def time(self) -> float:
        """Protected / plain execution time, measured on the recorded calls."""
        _, (time,) = times_of(self.target, codes_of(self.target, [self.planned.sites]), _TIMED_S)
        return time

    def counterparts(self, points: Sequence[InjectionPoint]) -> list[InjectionPoint]:
        """The same instructions, executions and bits in protected code: original instructions keep their names."""
        module = self.target.module
        names = _names(module)
        protected = {name: position for position, name in _names(Protection(self.planned)(module)).items()}
        counterparts = []
        for point in points:
            block, offset = protected[names[point.block, point.offset]]
            counterparts.append(point._replace(block=block, offset=offset))
        return counterparts


def _names(module: Module) -> dict[tuple[int, int], tuple[str, str]]:
    """Function and result of each site, by block and offset of the table of sites."""
    names = {}
    block_index = 0
    for function in module.functions:
        for block in function.blocks:
            for offset, site in enumerate(block.sites):
                names[block_index, offset] = function.name, str(site.result)
            if block.sites:  # the table has no blocks without sites
                block_index += 1
    return names


def certify(pair: FunctionPair, faults: int, *address: Any) -> Certificate:
    """Certify the protection of a function.

    Args:
        pair: The function.
        faults: Number of faults in plain code, and as many others in protected code.
        address: Of the random stream from which they are drawn.
    """
    planned = pair.planned
    random = stream(0, "certificate", planned.function, planned.signature, *map(str, address))
    # The order of the draws is part of the certificate: the stream is shared.
    points = pair.plain.draw(random, faults)
    before = pair.plain.run(points)
    same_faults_protected = pair.protected.run(pair.counterparts(points))
    after = pair.protected.run(pair.protected.draw(random, faults))
    return Certificate(
        kernel=planned.kernel,
        function=planned.function,
        signature=planned.signature,
        instructions=pair.seen.instructions,
        before=counts_of(before),
        after=counts_of(after),
        growth=pair.growth,
        predicted=planned.predicted,
        paired=mcnemar(_is_silent(before), _is_silent(same_faults_protected)),
        time=pair.time(),
        planned_time=planned.time,
    )


def _is_silent(effects: Sequence[str]) -> list[bool]:
    return [effect == SDC for effect in effects]


def observe_plain(kernel: str, seen: ObservedFunction, faults: int, *address: Any) -> Unprotected:
    """Inject at most `faults` faults in a function that is not protected, fewer in long calls."""
    battery = Battery(seen.entry, seen.function, seen.variant, seen.calls)
    random = stream(0, "certificate", *seen.key, *map(str, address))
    effects = battery.run(battery.draw(random, min(faults, affordable_faults(battery))))
    return Unprotected(kernel, *seen.key, seen.instructions, counts_of(effects))


def combined_coverage(certificates: Sequence[Certificate], others: Sequence[Unprotected] = ()) -> Rate:
    """Share of the silent corruptions of several functions that is removed: none of those in `others`.

    Each function is weighted by its silent corruptions per flight.  With `others` the bounds are the products of those
    of the coverage of protected functions and of their share of all silent corruptions.
    """
    protected = [result for result in certificates if result.sdc_before.rate is not None]
    plain = [result for result in others if result.sdc.rate is not None]
    if not protected:
        return NO_RATE

    # 1. The coverage of the protected functions alone, from their corruptions per instruction of the flight.
    total = sum(result.instructions for result in protected) + sum(result.instructions for result in plain)
    before = _weighted_sum([(result.instructions / total, result.sdc_before) for result in protected])
    after = _weighted_sum([(result.instructions * result.growth / total, result.sdc_after) for result in protected])
    of_protected = coverage(before, after, 1.0)
    if not plain or of_protected.rate is None:
        return of_protected

    # 2. Their share of all corruptions: what is left in the others is not removed.
    elsewhere = _weighted_sum([(result.instructions / total, result.sdc) for result in plain])
    assert elsewhere.rate is not None and before.rate is not None  # as with any injection
    removed = of_protected.rate * before.rate / (before.rate + elsewhere.rate)
    share_bounds = [1 / (1 + ratio) for ratio in ratio_bounds(elsewhere, before)]
    _, low, high = bounds_of(of_protected)
    products = [bound * share_bound for bound in (low, high) for share_bound in share_bounds]
    return Rate(of_protected.n, removed, min(products), max(products))


def predicted_coverage(certificates: Sequence[Certificate], others: Sequence[Unprotected] = ()) -> Rate:
    """What `combined_coverage` gives if each function is as predicted, with the same weights.

    A function without a prediction counts as not removed, for the upper bound as removed.

    Returns:
        All None if no function has a prediction.
    """
    masses = [result.instructions * (result.sdc_before.rate or 0.0) for result in certificates]
    total_mass = sum(masses) + sum(result.instructions * (result.sdc.rate or 0.0) for result in others)
    if not total_mass or all(certificate.predicted is None for certificate in certificates):
        return NO_RATE
    parts = []
    for mass, certificate in zip(masses, certificates, strict=True):
        predicted = certificate.predicted_rate
        if certificate.predicted is None:
            predicted = Rate(0, 0.0, 0.0, 1.0)
        parts.append((mass / total_mass, predicted))
    return _weighted_sum(parts)


def _weighted_sum(parts: Sequence[tuple[float, Rate]]) -> Rate:
    """Weighted sum of independent rates, with MOVER's interval."""
    bounds = [(weight, *bounds_of(rate)) for weight, rate in parts]
    value = sum(weight * rate for weight, rate, _, _ in bounds)
    below = hypot(*(weight * (rate - low) for weight, rate, low, _ in bounds))
    above = hypot(*(weight * (high - rate) for weight, rate, _, high in bounds))
    return Rate(sum(rate.n for _, rate in parts), value, value - below, value + above)


def pairs_of(seen: Sequence[ObservedFunction], plan: ProtectionPlan) -> list[FunctionPair]:
    """The observed functions that the plan protects; `BadInputError` if it is of other code."""
    protected = []
    for function in seen:
        planned = _entry_of(function, plan)
        if planned is not None:
            protected.append((function, planned))
    with ThreadPoolExecutor(2) as ahead:  # each build waits for a process of its own
        for function, planned in protected:
            ahead.submit(cached_build, function.function, function.signature, Protection(planned))
    return [FunctionPair.of(function, planned) for function, planned in protected]


def unprotected(seen: Sequence[ObservedFunction], plan: ProtectionPlan) -> list[ObservedFunction]:
    """The observed functions that are not among `pairs_of`."""
    return [function for function in seen if _entry_of(function, plan) is None]


def _entry_of(seen: ObservedFunction, plan: ProtectionPlan) -> FunctionPlan | None:
    """What the plan duplicates in a function; None = nothing."""
    planned = plan.find(name_of(seen.function), seen.signature)
    if planned is not None and planned.sites:
        return planned
    return None


# ---- the time that a plan adds --------------------------------------------------------------------------------------

TOLERANCE = 0.02
"""Share of a flight's kernel time by which a plan may exceed its budget: the time of a function that takes most of a
flight is measured within a few per cent."""
_SHARE_TIMED_S = 0.25
"""For how long a plain function is timed, for its share of a flight (s)."""


@dataclass(frozen=True, slots=True)
class Spending:
    """Time that a plan adds to the flights of a planner, as a share of their kernel time.

    Attributes:
        planner: Planner of the flights.
        measured: Share with the time ratios that the certificate measured.
        planned: Share with the time ratios of the plan, in the same flights.
        budget: Budget of the plan; None = not known.
    """

    planner: str
    measured: float
    planned: float
    budget: float | None = None

    @property
    def refuted(self) -> bool:
        """Whether more is added than the budget, or without one than planned, by more than `TOLERANCE`."""
        allowed = self.planned
        if self.budget is not None:
            allowed = self.budget
        return self.measured > allowed + TOLERANCE


def ticks_of(seen: ObservedFunction) -> float:
    """Ticks of the time stamp counter per plain call of a function."""
    target = FunctionTarget(("",), seen)
    ticks, _ = times_of(target, codes_of(target, []), _SHARE_TIMED_S)
    return ticks


def spending_of(
    planner: str,
    flown: Sequence[ObservedFunction],
    ticks: Mapping[FunctionKey, float],
    certificates: Sequence[Certificate],
    budget: float | None,
) -> Spending:
    """What a plan adds to flights.

    Args:
        planner: Planner of the flights.
        flown: All functions of their kernels.
        ticks: As of `ticks_of`, for each of these.
        certificates: Of the functions that the plan protects; those without a measured time count as planned.
        budget: Budget of the plan; None = not known.
    """
    plain_ticks = {seen.key: seen.total * ticks[seen.key] for seen in flown}
    flight_ticks = sum(plain_ticks.values())
    planned = []
    measured = []
    for certificate in certificates:
        share = plain_ticks.get(certificate.key, 0.0) / flight_ticks  # 0: these flights do not call it
        planned.append(share * (certificate.planned_time - 1))
        measured.append(share * ((certificate.time or certificate.planned_time) - 1))
    return Spending(planner, sum(measured), sum(planned), budget)


# ---- the certificate of a plan --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Certification:
    """Certificates of a plan's functions, and its golden flights.

    Attributes:
        plan: Digest of the plan.
        faults: Number per function, in plain and in protected code.
        missions: Environment and seed of the missions.
        certificates: By function.
        golden: Flights in which all calls run protected code.
        others: Functions of the study's kernels that the plan leaves as they are.
        scope: Kernels whose silent corruptions are counted; () = all of the missions.
        cpu: Class of the processor on which times were measured; "" = not known.
        spending: Time that the plan adds to flights, by planner; () = not measured.
    """

    plan: str
    faults: int
    missions: tuple[str, ...]
    certificates: tuple[Certificate, ...]
    golden: GoldenCheck
    others: tuple[Unprotected, ...] = ()
    scope: tuple[str, ...] = ()
    cpu: str = ""
    spending: tuple[Spending, ...] = ()

    @property
    def coverage(self) -> Rate:
        """Share of the silent corruptions in `scope` that is removed."""
        return combined_coverage(self.certificates, self.others)

    @property
    def predicted(self) -> Rate:
        """The same, by the predictions for its functions."""
        return predicted_coverage(self.certificates, self.others)

    @property
    def verdict(self) -> Verdict:
        """Whether both agree, see `verdict_of`."""
        return verdict_of(self.coverage, self.predicted)

    @property
    def wrong(self) -> int:
        """Number of predictions for functions that are refuted at 95 % together, with Holm's correction.

        Of ten correct ones, each judged at 95 %, one is too high by chance in every fourth or fifth certificate.
        """
        p_values = [
            p_value_below(certificate.coverage, certificate.predicted_rate) for certificate in self.certificates
        ]
        return sum(p is not None and p < 2 * TAIL for p in holm(p_values))

    @property
    def refuted(self) -> bool:
        """Whether a prediction or the budget is refuted, or a golden flight differs or raises an alarm."""
        prediction_refuted = self.verdict == Verdict.REFUTED or self.wrong > 0
        budget_refuted = any(spending.refuted for spending in self.spending)
        return prediction_refuted or budget_refuted or not self.golden.passed


def certify_plan(
    study: HardeningStudy, plan: ProtectionPlan, faults: int, tell: Tell = lambda _: None
) -> Certification:
    """Certify a plan with missions and faults that its choice has not seen.

    Args:
        study: The ledger of the plan, or another one whose next missions the plan was not made from.
        plan: The plan.
        faults: Number per function, in plain and in protected code.
        tell: Called with each piece of work.

    Raises:
        BadInputError: These missions are not known to be fresh, the plan was made for other code, or it protects
            nothing here.
    """
    check_plan(plan, "plan")
    check_fresh(study, plan)
    certificates: list[Certificate] = []
    others: list[Unprotected] = []
    golden = GoldenCheck()
    missions: list[str] = []
    ticks: dict[FunctionKey, float] = {}
    spending: list[Spending] = []
    for planner, kernels in study.by_planner().items():
        # 1. Fly fresh missions: which functions are called, and do protected flights have the same digests?
        observed: list[ObservedFunction] = []
        kernel_of: dict[str, str] = {}
        studied: set[str] = set()
        for scenario in study.fresh(planner):
            tell(f"flying {scenario.environment.name} {scenario.seed} with {planner}")
            for kernel, functions in observe(scenario, kernels).items():
                observed += functions
                for function in functions:
                    kernel_of.setdefault(function.entry, kernel)
            flown_kernels = [kernel for kernel in study.kernels if kernel in (*kernels, *INJECTABLE)]
            studied |= functions_of_all(flown_kernels, Targets(scenario)).keys()
            golden = golden.plus(check_golden(scenario, plan, kernels))
            missions.append(f"{scenario.environment.name}-{scenario.seed}-{planner}")
        flown = merged(observed)

        # 2. Inject faults in the studied functions; those of several planners are certified with the first one.
        done = {result.key for result in (*certificates, *others)}
        fresh = [function for function in flown if function.entry in studied and function.key not in done]
        for pair in pairs_of(fresh, plan):
            tell(f"injecting {3 * faults} faults in {pair.planned.function}")
            certificates.append(certify(pair, faults, plan.digest))
        for function in unprotected(fresh, plan):
            tell(f"injecting faults in {name_of(function.function)}, which is not duplicated")
            others.append(observe_plain(kernel_of[function.entry], function, faults, plan.digest))

        # 3. Time all functions of the flights: what does the plan add to them?
        tell(f"timing the functions of flights with {planner}")
        for function in flown:
            if function.key not in ticks:
                ticks[function.key] = ticks_of(function)
        spending.append(spending_of(planner, flown, ticks, certificates, plan.budget))

    if not certificates:
        raise BadInputError("the plan protects no function of these missions; allowed: one with sites")
    scope: tuple[str, ...] = ()
    if not study.complete:
        scope = tuple(study.kernels)
    return Certification(
        plan=plan.digest,
        faults=faults,
        missions=tuple(missions),
        certificates=tuple(certificates),
        golden=golden,
        others=tuple(others),
        scope=scope,
        cpu=processor(),
        spending=tuple(spending),
    )


def check_fresh(study: HardeningStudy, plan: ProtectionPlan) -> None:
    """Raise a BadInputError if the choice of a plan may have seen the missions with which it is to be certified."""
    if plan.ledger == study.digest:
        return
    if not plan.studied:
        raise BadInputError(
            f"{study.directory}: ledger {study.digest[:12]}, the plan was made from {plan.ledger[:12] or 'none'}: its "
            "seeds are not known to be fresh; allowed: the ledger of the plan"
        )
    for world in study.worlds:
        for seed in study.next_seeds:
            if plan.has_studied(world, seed):
                raise BadInputError(
                    f"{study.directory}: mission {world} {seed}, the next after its own: the plan was made from it; "
                    "allowed: a ledger whose next missions are fresh"
                )


def with_certified(plan: ProtectionPlan, other: ProtectionPlan) -> ProtectionPlan:
    """The plan with the certified coverage that another one states for the same protected code."""
    certified = {_code_of(planned): planned.certified for planned in other.functions}
    return _stating(plan, lambda planned: certified.get(_code_of(planned)))


def certified_plan(plan: ProtectionPlan, certification: Certification) -> ProtectionPlan:
    """The plan with the coverage that its certificate states."""
    measured = {certificate.key: coverage_in_plan(certificate.coverage) for certificate in certification.certificates}
    return _stating(plan, lambda planned: measured.get(planned.key, planned.certified))


def _code_of(planned: FunctionPlan) -> tuple[str, str, str, bytes]:
    """What identifies the protected code of a function."""
    return planned.function, planned.signature, planned.kind, Protection(planned).key


def _stating(plan: ProtectionPlan, certified: Callable[[FunctionPlan], Coverage | None]) -> ProtectionPlan:
    """The plan with the certified coverage of each function."""
    functions = tuple(planned.model_copy(update={"certified": certified(planned)}) for planned in plan.functions)
    return plan.model_copy(update={"functions": functions})


def save_certification(certification: Certification, plan_path: Path) -> Path:
    """Write the certificate next to the plan; returns its path, e.g. plan.certificate.json.

    Raises:
        BadInputError: The file cannot be written.
    """
    path = plan_path.with_suffix(".certificate.json")
    write_text(path, json.dumps(certification_json(certification), indent=1) + "\n")
    return path


def certification_json(certification: Certification) -> CertificationJson:
    """A certificate as plain data."""
    return {
        "plan": certification.plan,
        "faults": certification.faults,
        "missions": list(certification.missions),
        "refuted": certification.refuted,
        "golden": certification.golden._asdict(),
        "coverage": asdict(certification.coverage),
        "predicted": asdict(certification.predicted),
        "verdict": certification.verdict.value,
        "cpu": certification.cpu,
        "kernels": list(certification.scope) or "all",
        "functions": [certificate.to_json() for certificate in certification.certificates],
        "unprotected": [other.to_json() for other in certification.others],
        "spending": [asdict(spending) for spending in certification.spending],
    }
