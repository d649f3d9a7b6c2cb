"""Certificate of a plan: fresh faults in recorded calls of missions that the choice has not seen.

Faults are drawn over the dynamic instructions of the protected program, so shadows, copies and comparisons can be hit.
The same calls are injected without protection, and these faults once more, instruction by instruction, with it.

Coverage is the share of silent corruptions per call that protection removes, with its interval.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, astuple, dataclass
from functools import cached_property
from math import hypot, inf, sqrt
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from mavfi.analysis.statistics import TAIL, Paired, Rate, holm, mcnemar, wilson
from mavfi.campaign.fingerprint import processor
from mavfi.errors import BadInputError, write_text
from mavfi.extras.hardening.advise import Study, Tell, codes_of, stated, times_of
from mavfi.extras.hardening.battery import SDC, Battery, Place, counts_of
from mavfi.extras.hardening.observed import GoldenCheck, Seen, check_golden, entries_of, observe
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, Plan
from mavfi.extras.hardening.protected import Protection, check_plan
from mavfi.extras.hardening.target import Target, affordable
from mavfi.faults.levels.instruction.build import cached_build
from mavfi.faults.levels.instruction.variant import variant_of
from mavfi.faults.sampling import stream
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
    lower = (p * q) ** 2 - low_p * high_q * (2 * p - low_p) * (2 * q - high_q)
    upper = (p * q) ** 2 - high_p * low_q * (2 * p - high_p) * (2 * q - low_q)
    bottom = high_q * (2 * q - high_q)
    top = low_q * (2 * q - low_q)
    low = (p * q - sqrt(max(lower, 0.0))) / bottom if bottom > 0 else 0.0
    return max(low, 0.0), (p * q + sqrt(max(upper, 0.0))) / top if top > 0 else inf


def difference(measured: Rate, predicted: Rate) -> tuple[float, float]:
    """Interval of measured - predicted coverage (MOVER for a difference); infinite if one is not known."""
    if measured.rate is None or predicted.rate is None:
        return -inf, inf
    one, low, high = bounds_of(measured)
    other, other_low, other_high = bounds_of(predicted)
    gap = one - other
    return gap - hypot(one - low, other_high - other), gap + hypot(high - one, other - other_low)


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


def bounds_of(found: Rate) -> tuple[float, float, float]:
    """Rate, and its bounds."""
    assert found.rate is not None and found.low is not None and found.high is not None  # as with any injection
    return found.rate, found.low, found.high


# ---- the certificate of a function ----------------------------------------------------------------------------------

CONFIRMED = "confirmed"
REFUTED = "refuted"
BETTER = "better"
UNDECIDED = "undecided"
UNKNOWN = "unknown"
_TIMED_S = 4.0
"""For how long a function is timed (s): within 1 s the time of `insert_scan`, most of a flight's, varies by 2 %."""
RESOLVED = 0.2
"""Largest half-width of the interval of measured - predicted coverage with which a prediction is confirmed: a wider one
would contain 0 for almost any prediction."""


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
    def verdict(self) -> str:
        """See `verdict_of`."""
        return verdict_of(self.coverage, self.predicted_rate)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        same = (
            "kernel",
            "function",
            "signature",
            "instructions",
            "verdict",
            "growth",
            "time",
            "planned_time",
            "before",
            "after",
        )
        rates = ("coverage", "sdc_before", "sdc_after")
        paired = zip(("n", "plain_only", "protected_only", "p"), astuple(self.paired), strict=True)
        return {
            **{key: getattr(self, key) for key in same},
            **{key: asdict(getattr(self, key)) for key in rates},
            "predicted": None if self.predicted is None else self.predicted.model_dump(),
            "paired": dict(paired),
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


def verdict_of(measured: Rate, predicted: Rate) -> str:
    """Whether a measured coverage agrees with its prediction, is lower, or higher, at 95 %; or too few SDCs to tell."""
    if measured.rate is None or predicted.rate is None:
        return UNKNOWN
    low, high = difference(measured, predicted)
    if low <= 0 <= high:
        if (high - low) / 2 <= RESOLVED:
            return CONFIRMED
        return UNDECIDED
    if high < 0:
        return REFUTED
    return BETTER


@dataclass
class Pair:
    """A function with and without protection, with the same calls.

    Attributes:
        seen: The plain function.
        planned: Its protection.
        plain: Injections without it.
        guarded: Injections with it.
    """

    seen: Seen
    planned: FunctionPlan
    plain: Battery
    guarded: Battery

    @staticmethod
    def of(seen: Seen, planned: FunctionPlan) -> "Pair":
        """Build the protected variant; `BadInputError` if the plan is of other code."""
        guarded = variant_of(seen.function, seen.signature, Protection(planned))
        batteries = (Battery(seen.entry, seen.function, variant, seen.calls) for variant in (seen.variant, guarded))
        return Pair(seen, planned, *batteries)

    @cached_property
    def target(self) -> Target:
        """The function."""
        return Target((self.planned.kernel,), self.seen, addresses=self.planned.addresses)

    @property
    def growth(self) -> float:
        """Dynamic instructions of protected code / plain code, over the recorded calls."""
        return float(self.guarded.counts.sum() / self.plain.counts.sum())

    def time(self) -> float:
        """Protected / plain execution time, measured on the recorded calls."""
        _, (time,) = times_of(self.target, codes_of(self.target, [self.planned.sites]), _TIMED_S)
        return time

    def counterparts(self, places: Sequence[Place]) -> list[Place]:
        """The same instructions, executions and bits in protected code: original instructions keep their names."""
        module = self.target.module
        names = _names(module)
        protected = {name: position for position, name in _names(Protection(self.planned)(module)).items()}
        found = []
        for place in places:
            block, offset = protected[names[place.block, place.offset]]
            found.append(place._replace(block=block, offset=offset))
        return found


def _names(module: Module) -> dict[tuple[int, int], tuple[str, str]]:
    """Function and result of each site, by block and offset of the table of sites."""
    blocks = [(function.name, block) for function in module.functions for block in function.blocks if block.sites]
    return {
        (number, offset): (name, str(site.result))
        for number, (name, block) in enumerate(blocks)
        for offset, site in enumerate(block.sites)
    }


def certify(pair: Pair, faults: int, *address: Any) -> Certificate:
    """Inject `faults` faults in plain and as many in protected code, and those of plain code in protected code, too."""
    random = stream(0, "certificate", pair.planned.function, pair.planned.signature, *map(str, address))
    places = pair.plain.draw(random, faults)
    before = pair.plain.run(places)
    again = pair.guarded.run(pair.counterparts(places))
    after = pair.guarded.run(pair.guarded.draw(random, faults))
    planned = pair.planned
    seen = pair.seen
    return Certificate(
        planned.kernel,
        planned.function,
        planned.signature,
        seen.instructions,
        counts_of(before),
        counts_of(after),
        pair.growth,
        planned.predicted,
        mcnemar([one == SDC for one in before], [one == SDC for one in again]),
        pair.time(),
        planned.time,
    )


def observe_plain(kernel: str, seen: Seen, faults: int, *address: Any) -> Unprotected:
    """Inject at most `faults` faults in a function that is not protected, fewer in long calls."""
    battery = Battery(seen.entry, seen.function, seen.variant, seen.calls)
    random = stream(0, "certificate", *seen.key, *map(str, address))
    effects = battery.run(battery.draw(random, min(faults, affordable(battery))))
    return Unprotected(kernel, *seen.key, seen.instructions, counts_of(effects))


def together(certificates: Sequence[Certificate], others: Sequence[Unprotected] = ()) -> Rate:
    """Share of the silent corruptions of several functions that is removed: none of those in `others`.

    Each function is weighted by its silent corruptions per flight.  With `others` the bounds are the products of those
    of the coverage of protected functions and of their share of all silent corruptions.
    """
    known = [one for one in certificates if one.sdc_before.rate is not None]
    rest = [one for one in others if one.sdc.rate is not None]
    if not known:
        return NO_RATE
    whole = sum(one.instructions for one in known) + sum(one.instructions for one in rest)
    before = _sum([(one.instructions / whole, one.sdc_before) for one in known])
    after = _sum([(one.instructions * one.growth / whole, one.sdc_after) for one in known])
    found = coverage(before, after, 1.0)
    if not rest or found.rate is None:
        return found
    left = _sum([(one.instructions / whole, one.sdc) for one in rest])
    assert left.rate is not None and before.rate is not None  # as with any injection
    shares = [1 / (1 + ratio) for ratio in ratio_bounds(left, before)]  # of the protected functions: highest, lowest
    _, low, high = bounds_of(found)
    products = [bound * share for bound in (low, high) for share in shares]
    return Rate(found.n, found.rate * before.rate / (before.rate + left.rate), min(products), max(products))


def foreseen(certificates: Sequence[Certificate], others: Sequence[Unprotected] = ()) -> Rate:
    """What `together` finds if each function is as predicted, with the same weights; all None without a prediction."""
    masses = [one.instructions * (one.sdc_before.rate or 0.0) for one in certificates]
    whole = sum(masses) + sum(one.instructions * (one.sdc.rate or 0.0) for one in others)
    predicted = [one.predicted_rate for one in certificates]
    if not whole or any(one.rate is None for one in predicted):
        return NO_RATE
    return _sum([(mass / whole, one) for mass, one in zip(masses, predicted, strict=True)])


def _sum(parts: Sequence[tuple[float, Rate]]) -> Rate:
    """Weighted sum of independent rates, with MOVER's interval."""
    bounds = [(weight, *bounds_of(rate)) for weight, rate in parts]
    value = sum(weight * rate for weight, rate, _, _ in bounds)
    below = hypot(*(weight * (rate - low) for weight, rate, low, _ in bounds))
    above = hypot(*(weight * (high - rate) for weight, rate, _, high in bounds))
    return Rate(sum(rate.n for _, rate in parts), value, value - below, value + above)


def pairs_of(seen: Sequence[Seen], plan: Plan) -> list[Pair]:
    """The observed functions that the plan protects; `BadInputError` if it is of other code."""
    found = [(one, planned) for one in seen if (planned := _planned(one, plan)) is not None]
    with ThreadPoolExecutor(2) as ahead:  # each build waits for a process of its own
        for one, planned in found:
            ahead.submit(cached_build, one.function, one.signature, Protection(planned))
    return [Pair.of(one, planned) for one, planned in found]


def unprotected(seen: Sequence[Seen], plan: Plan) -> list[Seen]:
    """The observed functions that are not among `pairs_of`."""
    return [one for one in seen if _planned(one, plan) is None]


def _planned(seen: Seen, plan: Plan) -> FunctionPlan | None:
    """What the plan duplicates in a function; None = nothing."""
    planned = plan.find(name_of(seen.function), seen.signature)
    if planned is not None and planned.sites:
        return planned
    return None


# ---- the certificate of a plan --------------------------------------------------------------------------------------

TOLERANCE = 0.02
"""Share of a flight's kernel time by which a plan may exceed its budget: the time of a function that takes most of a
flight is measured within a few per cent."""
_SECONDS = 0.25
"""For how long a plain function is timed, for its share of a flight (s)."""
Key = tuple[str, str]
"""Function and signature, as in a plan."""


@dataclass(frozen=True, slots=True)
class Spending:
    """Time that a plan adds to the flights of a planner, as a share of their kernel time.

    Attributes:
        planner: Of the flights.
        measured: With the time ratios that the certificate measured.
        planned: With those of the plan, in the same flights.
        budget: That of the plan; None = not known.
    """

    planner: str
    measured: float
    planned: float
    budget: float | None = None

    @property
    def refuted(self) -> bool:
        """Whether more is added than the budget, or without one than planned, by more than `TOLERANCE`."""
        return self.measured > (self.planned if self.budget is None else self.budget) + TOLERANCE


def ticks_of(seen: Seen) -> float:
    """Ticks of the time stamp counter per plain call of a function."""
    target = Target(("",), seen)
    ticks, _ = times_of(target, codes_of(target, []), _SECONDS)
    return ticks


def spending_of(
    planner: str,
    flown: Sequence[Seen],
    ticks: Mapping[Key, float],
    certificates: Sequence[Certificate],
    budget: float | None,
) -> Spending:
    """What a plan adds to flights.

    Args:
        planner: Of the flights.
        flown: All functions of their kernels.
        ticks: As of `ticks_of`, for each of these.
        certificates: Of the functions that the plan protects; those without a measured time count as planned.
        budget: That of the plan.
    """
    spent = {seen.key: seen.total * ticks[seen.key] for seen in flown}
    whole = sum(spent.values())
    own = [(spent.get((one.function, one.signature), 0.0) / whole, one) for one in certificates]
    planned = sum(share * (one.planned_time - 1) for share, one in own)
    measured = sum(share * ((one.time or one.planned_time) - 1) for share, one in own)
    return Spending(planner, measured, planned, budget)


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
        return together(self.certificates, self.others)

    @property
    def predicted(self) -> Rate:
        """The same, by the predictions for its functions."""
        return foreseen(self.certificates, self.others)

    @property
    def verdict(self) -> str:
        """Whether both agree, see `verdict_of`."""
        return verdict_of(self.coverage, self.predicted)

    @property
    def wrong(self) -> int:
        """Number of predictions for functions that are refuted at 95 % together, with Holm's correction.

        Of ten correct ones, each judged at 95 %, one is too high by chance in every fourth or fifth certificate.
        """
        found = holm([p_value_below(one.coverage, one.predicted_rate) for one in self.certificates])
        return sum(p is not None and p < 2 * TAIL for p in found)

    @property
    def refuted(self) -> bool:
        """Whether a prediction or the budget is refuted, or a golden flight differs or raises an alarm."""
        false = self.verdict == REFUTED or self.wrong > 0
        return not self.golden.passed or false or any(one.refuted for one in self.spending)


def certify_plan(study: Study, plan: Plan, faults: int, tell: Tell = lambda _: None) -> Certification:
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
    ticks: dict[Key, float] = {}
    spending: list[Spending] = []
    for planner, kernels in study.by_planner().items():
        flown: list[Seen] = []
        for scenario in study.fresh(planner):
            tell(f"flying {scenario.environment.name} {scenario.seed} with {planner}")
            flown += [seen for own in observe(scenario, kernels).values() for seen in own]
            golden = golden.plus(check_golden(scenario, plan, kernels))
            missions.append(f"{scenario.environment.name}-{scenario.seed}-{planner}")
        done = {(one.function, one.signature) for one in (*certificates, *others)}
        every = merged(flown)
        known = [one for one in every if one.entry in entries_of(study.kernels)]
        fresh = [one for one in known if one.key not in done]
        pairs = pairs_of(fresh, plan)
        for pair in pairs:
            tell(f"injecting {3 * faults} faults in {pair.planned.function}")
            certificates.append(certify(pair, faults, plan.digest))
        for one in unprotected(fresh, plan):
            tell(f"injecting faults in {name_of(one.function)}, which is not duplicated")
            kernel = next(kernel for kernel in kernels if one.entry in INJECTABLE[kernel])
            others.append(observe_plain(kernel, one, faults, plan.digest))
        tell(f"timing the functions of flights with {planner}")
        ticks |= {one.key: ticks_of(one) for one in every if one.key not in ticks}
        spending.append(spending_of(planner, every, ticks, certificates, plan.budget))
    if not certificates:
        raise BadInputError("the plan protects no function of these missions; allowed: one with sites")
    scope = () if study.complete else study.kernels
    return Certification(
        plan.digest,
        faults,
        tuple(missions),
        tuple(certificates),
        golden,
        tuple(others),
        scope,
        processor(),
        tuple(spending),
    )


def check_fresh(study: Study, plan: Plan) -> None:
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


def merged(seen: Sequence[Seen]) -> list[Seen]:
    """Join what several flights showed of the same function and signature."""
    found: dict[tuple[str, Any], Seen] = {}
    for one in seen:
        key = one.entry, one.signature
        if key not in found:
            found[key] = Seen(one.function, one.entry, one.signature, one.variant, np.zeros_like(one.executions))
        own = found[key]
        own.executions = own.executions + one.executions
        own.total += one.total
        own.calls = [*own.calls, *one.calls]
    return list(found.values())


def with_certified(plan: Plan, other: Plan) -> Plan:
    """The plan with the certified coverage that another one states for the same protected code."""
    known = {_code_of(one): one.certified for one in other.functions}
    return _stating(plan, lambda one: known.get(_code_of(one)))


def certified_plan(plan: Plan, certification: Certification) -> Plan:
    """The plan with the coverage that its certificate states."""
    measured = {(one.function, one.signature): stated(one.coverage) for one in certification.certificates}
    return _stating(plan, lambda one: measured.get((one.function, one.signature), one.certified))


def _code_of(planned: FunctionPlan) -> tuple[str, str, str, bytes]:
    return planned.function, planned.signature, planned.kind, Protection(planned).key


def _stating(plan: Plan, certified: Callable[[FunctionPlan], Coverage | None]) -> Plan:
    functions = tuple(one.model_copy(update={"certified": certified(one)}) for one in plan.functions)
    return plan.model_copy(update={"functions": functions})


def save_certification(certification: Certification, plan_path: Path) -> Path:
    """Write the certificate next to the plan; returns its path, e.g. plan.certificate.json.

    Raises:
        BadInputError: The file cannot be written.
    """
    path = plan_path.with_suffix(".certificate.json")
    write_text(path, json.dumps(certification_json(certification), indent=1) + "\n")
    return path


def certification_json(certification: Certification) -> dict[str, Any]:
    """A certificate as plain data."""
    return {
        "plan": certification.plan,
        "faults": certification.faults,
        "missions": list(certification.missions),
        "refuted": certification.refuted,
        "golden": certification.golden._asdict(),
        "coverage": asdict(certification.coverage),
        "predicted": asdict(certification.predicted),
        "verdict": certification.verdict,
        "cpu": certification.cpu,
        "kernels": list(certification.scope) or "all",
        "functions": [one.to_json() for one in certification.certificates],
        "unprotected": [one.to_json() for one in certification.others],
        "spending": [asdict(one) for one in certification.spending],
    }
