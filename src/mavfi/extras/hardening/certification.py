"""From a plan to its certificate: fresh missions, fresh faults, and what they say of the plan as a whole.

The time that the plan adds to these flights is computed from times that were measured in them.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.analysis.statistics import TAIL, Rate, holm
from mavfi.campaign.fingerprint import processor
from mavfi.errors import BadInputError, write_text
from mavfi.extras.hardening.advise import Tell, codes_of, times_of
from mavfi.extras.hardening.certify import (
    REFUTED,
    Certificate,
    Unprotected,
    certify,
    foreseen,
    observe_plain,
    p_value_below,
    pairs_of,
    together,
    unprotected,
    verdict_of,
)
from mavfi.extras.hardening.observed import GoldenCheck, Seen, check_golden, entries_of, observe
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, Plan
from mavfi.extras.hardening.protected import Protection, check_plan
from mavfi.extras.hardening.study import Study, stated
from mavfi.extras.hardening.target import Target
from mavfi.ir.build import name_of
from mavfi.states import INJECTABLE

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
    planner: str, flown: Sequence[Seen], ticks: Mapping[Key, float], certificates: Sequence[Certificate],
    budget: float | None,
) -> Spending:  # fmt: skip
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
        plan.digest, faults, tuple(missions), tuple(certificates), golden, tuple(others), scope, processor(),
        tuple(spending),
    )  # fmt: skip


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
        "plan": certification.plan, "faults": certification.faults, "missions": list(certification.missions),
        "refuted": certification.refuted, "golden": certification.golden._asdict(),
        "coverage": asdict(certification.coverage), "predicted": asdict(certification.predicted),
        "verdict": certification.verdict, "cpu": certification.cpu, "kernels": list(certification.scope) or "all",
        "functions": [one.to_json() for one in certification.certificates],
        "unprotected": [one.to_json() for one in certification.others],
        "spending": [asdict(one) for one in certification.spending],
    }  # fmt: skip
