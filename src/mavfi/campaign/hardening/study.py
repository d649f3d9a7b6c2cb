"""From a ledger to a plan, and from a plan to its certificate."""

import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.config import Campaign
from mavfi.campaign.hardening.advise import TIMED_S, Advice, Step, allocate, curves_of, prepare_all
from mavfi.campaign.hardening.certify import (
    REFUTED,
    Certificate,
    Unprotected,
    certify,
    foreseen,
    observe_plain,
    pairs_of,
    together,
    unprotected,
    verdict_of,
)
from mavfi.campaign.hardening.golden import GoldenCheck, check_golden
from mavfi.campaign.hardening.learned import Learn, injections_in
from mavfi.campaign.hardening.machine import MachineLevel, check_kernel, machine_levels
from mavfi.campaign.hardening.observed import Seen, entries_of, observe
from mavfi.campaign.hardening.target import Target, targets_of
from mavfi.campaign.mission import host_of
from mavfi.campaign.overheads import processor
from mavfi.campaign.run import stored_campaign
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError, writing
from mavfi.hardening.plan import Coverage, FunctionPlan, Plan
from mavfi.hardening.protection import Protection
from mavfi.hosts.loop.protection import check_plan
from mavfi.ir.build import name_of
from mavfi.mission import Scenario
from mavfi.states import INJECTABLE, PLANNERS

Tell = Callable[[str], None]
FRESH = 2
"""Missions, per environment of the campaign, with which a plan is certified."""


@dataclass(frozen=True)
class Study:
    """A campaign of instruction faults, as input of the choice.

    Attributes:
        directory: Of the ledger.
        campaign: Its campaign.
        digest: Of its runs.
        kernels: Kernels to protect.
    """

    directory: Path
    campaign: Campaign
    digest: str
    kernels: tuple[str, ...]

    @staticmethod
    def open(directory: Path, kernels: Sequence[str] = ()) -> "Study":
        """Open a ledger; no `kernels` = all in which it has faults.

        Raises:
            BadInputError: It is not a ledger of instruction faults, or has none in a kernel.
        """
        with Store.open(directory) as store:
            campaign, digest = stored_campaign(store), store.digest()
        known = tuple(getattr(campaign.sampling, "kernels", ()))  # detectors are not protected
        known = tuple(kernel for kernel in known if kernel in INJECTABLE)
        if not known:
            raise BadInputError(f"{directory}: no kernels are sampled; allowed: a campaign of level instruction")
        for kernel in kernels:
            if kernel not in known:
                raise BadInputError(f"--kernels: {kernel!r}: allowed: {', '.join(known)}")
        return Study(directory, campaign, digest, tuple(kernels) or known)

    @cached_property
    def runs(self) -> Runs:
        """The ledger's runs."""
        return Runs.read(self.directory)

    def by_planner(self) -> dict[str, tuple[str, ...]]:
        """All kernels of the missions that are flown, by planner; that of the campaign's mission comes first."""
        own = self.campaign.spec(self.campaign.environments[0], self.campaign.first_seed).planner
        planners = dict.fromkeys([own, *(kernel for kernel in self.kernels if kernel in PLANNERS)])
        common = tuple(kernel for kernel in INJECTABLE if kernel not in PLANNERS)
        return {planner: (*common, planner) for planner in planners if planner in PLANNERS}

    @property
    def selected(self) -> tuple[str, ...]:
        """Its kernels, if they are not all of the ledger's; otherwise ()."""
        sampled = (kernel for kernel in getattr(self.campaign.sampling, "kernels", ()) if kernel in INJECTABLE)
        return () if set(sampled) == set(self.kernels) else self.kernels

    @property
    def complete(self) -> bool:
        """Whether its kernels are all of the missions that are flown."""
        return all(kernel in self.kernels for kernels in self.by_planner().values() for kernel in kernels)

    def scenario(self, environment: str, seed: int, planner: str) -> Scenario:
        """A mission of the campaign."""
        scenario: Scenario = host_of(self.campaign).resolve(self.campaign.spec(environment, seed, {"planner": planner}))
        return scenario

    @property
    def worlds(self) -> list[str]:
        """Names of the environments of its campaign, whose own names may be paths or parts."""
        own, seed = host_of(self.campaign), self.campaign.first_seed
        specs = (self.campaign.spec(environment, seed) for environment in self.campaign.environments)
        return list(dict.fromkeys(own.resolve(spec).environment.name for spec in specs))

    @property
    def studied(self) -> dict[str, tuple[int, int]]:
        """First and last seed of its missions, by environment."""
        seeds = self.campaign.seeds
        return dict.fromkeys(self.worlds, (seeds.start, seeds.stop - 1))

    @property
    def next_seeds(self) -> range:
        """The seeds after its own."""
        first = self.campaign.seeds.stop
        return range(first, first + FRESH)

    def fresh(self, planner: str) -> list[Scenario]:
        """Missions that the ledger does not contain."""
        return [
            self.scenario(environment, seed, planner)
            for environment in self.campaign.environments
            for seed in self.next_seeds
        ]


def advise(
    study: Study, budget: float, tell: Tell = lambda _: None, *, addresses: bool = False,
    learn: Learn = injections_in, workers: int = 1, seconds: float = TIMED_S,
) -> list[Advice]:  # fmt: skip
    """Advice by planner of the missions, that of the campaign's planner first.

    The budget applies to each flight.  Functions that several planners share are chosen in the first one.  `addresses`
    is that of `Target`, `learn` and `workers` are those of `prepare_all`, `seconds` is that of `curves_of`.

    Raises:
        BadInputError: A mission cannot be flown.
    """
    environment, seed = study.campaign.environments[0], study.campaign.first_seed
    flights: list[tuple[list[Target], list[Target]]] = []  # of each planner: those of earlier ones, and new ones
    known: dict[tuple[str, str], Target] = {}
    for planner, kernels in study.by_planner().items():
        tell(f"flying the golden mission {environment} {seed} with {planner}")
        seen = observe(study.scenario(environment, seed, planner), kernels)
        targets = targets_of(seen, addresses=addresses)
        shared = [known[target.key] for target in targets if target.key in known]
        flights.append((shared, [target for target in targets if target.key not in known]))
        known |= {target.key: target for target in flights[-1][1]}
    every = [target for _, new in flights for target in new]
    own = prepare_all(every, study.kernels, tell, learn, workers)
    ready = {target.key: one for target, one in zip(every, own, strict=True)}
    found: list[Advice] = []
    for shared, new in flights:
        steps = {curve.target.key: (curve, step) for advice in found for curve, step in advice.steps}
        before = [steps[target.key] for target in shared]
        other_ticks = sum(curve.ticks for curve, _ in before)
        curves = curves_of(new, [ready[target.key] for target in new], other_ticks, tell, seconds)
        whole = other_ticks + sum(curve.ticks for curve in curves)
        spent = sum(curve.ticks * (step.time - 1) for curve, step in before) / whole
        found.append(Advice(budget, curves, allocate(curves, budget - spent), spent))
    return found


def plan_of(study: Study, advices: Sequence[Advice]) -> Plan:
    """The plan of an advice; functions that were considered and are not protected have the kind none."""
    ticks: dict[str, float] = defaultdict(float)
    for advice in advices:
        for curve in advice.curves:
            ticks[curve.target.kernels[0]] += curve.ticks
    functions = [
        planned_of(curve.target, step, round(curve.ticks / ticks[curve.target.kernels[0]], 4))
        for advice in advices
        for curve, step in advice.steps
        if len(curve.steps) > 1  # of the kernels to protect
    ]
    return Plan(cpu=processor(), ledger=study.digest, studied=study.studied, functions=tuple(functions))


def planned_of(target: Target, step: Step, share: float | None = None) -> FunctionPlan:
    """The entry of a function in a plan; `share` of the time of its kernel."""
    sites = target.sites(step.choice)
    predicted = _coverage(step.coverage) if sites else None
    return FunctionPlan(
        kernel=target.kernels[0], function=target.name, signature=target.seen.signature_text,
        ir_sha256=target.seen.variant.ir_sha256, kind="duplicate" if sites else "none",
        addresses=target.addresses, libm=target.libm, sites=tuple(sites),
        lines=target.lines(sites), time=round(step.time, 3), share=share, predicted=predicted,
    )  # fmt: skip


def _coverage(found: Rate) -> Coverage | None:
    if found.rate is None or found.low is None or found.high is None:
        return None
    return Coverage(estimate=found.rate, low=found.low, high=found.high)


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
        machine: Functions in which faults were injected at machine level, too.
        cpu: Class of the processor on which times were measured; "" = not known.
    """

    plan: str
    faults: int
    missions: tuple[str, ...]
    certificates: tuple[Certificate, ...]
    golden: GoldenCheck
    others: tuple[Unprotected, ...] = ()
    scope: tuple[str, ...] = ()
    machine: tuple[MachineLevel, ...] = ()
    cpu: str = ""

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
    def refuted(self) -> bool:
        """Whether a prediction is refuted, or a golden flight differs or raises an alarm."""
        verdicts = [self.verdict, *(one.verdict for one in self.certificates)]
        return not self.golden.passed or REFUTED in verdicts


def certify_plan(
    study: Study, plan: Plan, faults: int, tell: Tell = lambda _: None, machine: str | None = None
) -> Certification:
    """Certify a plan with missions and faults that its choice has not seen.

    Args:
        study: The ledger of the plan, or another one whose next missions the plan was not made from.
        plan: The plan.
        faults: Number per function, in plain and in protected code.
        tell: Called with each piece of work.
        machine: A kernel in which as many faults are injected at machine level, too.

    Raises:
        BadInputError: These missions are not known to be fresh, the plan was made for other code, or it protects
            nothing here.
    """
    if machine is not None:
        check_kernel(plan, machine, study.kernels)
    check_plan(plan, "plan")
    check_fresh(study, plan)
    certificates: list[Certificate] = []
    others: list[Unprotected] = []
    levels: list[MachineLevel] = []
    golden = GoldenCheck()
    missions: list[str] = []
    for planner, kernels in study.by_planner().items():
        flown: list[Seen] = []
        for scenario in study.fresh(planner):
            tell(f"flying {scenario.environment.name} {scenario.seed} with {planner}")
            flown += [seen for own in observe(scenario, kernels).values() for seen in own]
            golden = golden.plus(check_golden(scenario, plan, kernels))
            missions.append(f"{scenario.environment.name}-{scenario.seed}-{planner}")
        done = {(one.function, one.signature) for one in (*certificates, *others)}
        known = [one for one in merged(flown) if one.entry in entries_of(study.kernels)]
        fresh = [one for one in known if (name_of(one.function), one.signature_text) not in done]
        pairs = pairs_of(fresh, plan)
        if machine in kernels and not levels:  # kernels that several planners have are in the first flights
            levels += machine_levels(pairs, machine, faults, tell, plan.digest)
        for pair in pairs:
            tell(f"injecting {3 * faults} faults in {pair.planned.function}")
            certificates.append(certify(pair, faults, plan.digest))
        for one in unprotected(fresh, plan):
            tell(f"injecting faults in {name_of(one.function)}, which is not duplicated")
            kernel = next(kernel for kernel in kernels if one.entry in INJECTABLE[kernel])
            others.append(observe_plain(kernel, one, faults, plan.digest))
    if not certificates:
        raise BadInputError("the plan protects no function of these missions; allowed: one with sites")
    scope = () if study.complete else study.kernels
    return Certification(
        plan.digest, faults, tuple(missions), tuple(certificates), golden, tuple(others), scope, tuple(levels),
        processor(),
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
    known = {(one.function, one.signature, Protection(one).key): one.certified for one in other.functions}
    functions = tuple(
        one.model_copy(update={"certified": known.get((one.function, one.signature, Protection(one).key))})
        for one in plan.functions
    )
    return plan.model_copy(update={"functions": functions})


def certified_plan(plan: Plan, certification: Certification) -> Plan:
    """The plan with the coverage that its certificate states."""
    measured = {(one.function, one.signature): _coverage(one.coverage) for one in certification.certificates}
    functions = tuple(
        one.model_copy(update={"certified": measured.get((one.function, one.signature), one.certified)})
        for one in plan.functions
    )
    return plan.model_copy(update={"functions": functions})


def save_certification(certification: Certification, plan_path: Path) -> Path:
    """Write the certificate next to the plan; returns its path, e.g. plan.certificate.json.

    Raises:
        BadInputError: The file cannot be written.
    """
    path = plan_path.with_suffix(".certificate.json")
    with writing(path):
        path.write_text(json.dumps(certification_json(certification), indent=1) + "\n", encoding="utf-8")
    return path


def certification_json(certification: Certification) -> dict[str, Any]:
    """A certificate as plain data."""
    return {
        "plan": certification.plan, "faults": certification.faults, "missions": list(certification.missions),
        "refuted": certification.refuted, "golden": certification.golden.to_json(),
        "coverage": asdict(certification.coverage), "predicted": asdict(certification.predicted),
        "verdict": certification.verdict, "cpu": certification.cpu, "kernels": list(certification.scope) or "all",
        "functions": [one.to_json() for one in certification.certificates],
        "unprotected": [one.to_json() for one in certification.others],
        "machine": [one.to_json() for one in certification.machine],
    }  # fmt: skip


def certification_of(found: Mapping[str, Any]) -> Certification:
    """Inverse of `certification_json`; ones that were written without a processor have none."""
    machine = [{one.name: row[one.name] for one in fields(MachineLevel)} for row in found["machine"]]
    others = [{one.name: row[one.name] for one in fields(Unprotected)} for row in found["unprotected"]]
    return Certification(
        found["plan"], found["faults"], tuple(found["missions"]), tuple(map(Certificate.from_json, found["functions"])),
        GoldenCheck(**found["golden"]), tuple(Unprotected(**row) for row in others),
        () if found["kernels"] == "all" else tuple(found["kernels"]), tuple(MachineLevel(**row) for row in machine),
        found.get("cpu", ""),
    )  # fmt: skip
