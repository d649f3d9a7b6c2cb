"""From a ledger to a plan."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.campaign.config import Campaign
from mavfi.campaign.fingerprint import processor
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.mission import host_of
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.extras.hardening.advise import (
    TIMED_S,
    Advice,
    Choices,
    Step,
    Tell,
    choices_of,
    curves_of,
    prepare_all,
    settle,
)
from mavfi.extras.hardening.observed import observe
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, Plan
from mavfi.extras.hardening.target import Learn, Target, injections_in, targets_of
from mavfi.mission import Scenario
from mavfi.states import INJECTABLE, PLANNERS

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
        known = _sampled(campaign)
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
        return () if set(_sampled(self.campaign)) == set(self.kernels) else self.kernels

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


def _sampled(campaign: Campaign) -> tuple[str, ...]:
    """Its kernels; detectors, of which it may sample instructions, too, are not protected."""
    return tuple(kernel for kernel in getattr(campaign.sampling, "kernels", ()) if kernel in INJECTABLE)


def advise(
    study: Study, budget: float, tell: Tell = lambda _: None, *, addresses: bool = False,
    learn: Learn = injections_in, workers: int = 1, seconds: float = TIMED_S, choices: Choices = choices_of,
) -> list[Advice]:  # fmt: skip
    """Advice by planner of the missions, that of the campaign's planner first.

    The budget applies to each flight.  Functions that several planners share are chosen in the first one.  `addresses`
    is that of `Target`; `learn`, `workers` and `choices` are those of `prepare_all`, `seconds` is that of `curves_of`.

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
    made = prepare_all(every, study.kernels, tell, learn, workers, choices)
    ready = {target.key: one for target, one in zip(every, made, strict=True)}
    found: list[Advice] = []
    for shared, new in flights:
        steps = {curve.target.key: (curve, step) for advice in found for curve, step in advice.steps}
        before = [steps[target.key] for target in shared]
        other_ticks = sum(curve.ticks for curve, _ in before)
        own = [ready[target.key] for target in new]
        curves = curves_of(new, own, other_ticks, tell, seconds)
        whole = other_ticks + sum(curve.ticks for curve in curves)
        spent = sum(curve.ticks * (step.time - 1) for curve, step in before) / whole
        found.append(Advice(budget, *settle(curves, own, budget - spent, seconds), spent))
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
    return Plan(
        cpu=processor(),
        ledger=study.digest,
        studied=study.studied,
        budget=advices[0].budget,
        functions=tuple(functions),
    )


def planned_of(target: Target, step: Step, share: float | None = None) -> FunctionPlan:
    """The entry of a function in a plan; `share` of the time of its kernel."""
    sites = target.sites(step.choice)
    predicted = stated(step.coverage) if sites else None
    return FunctionPlan(
        kernel=target.kernels[0], function=target.name, signature=target.seen.signature_text,
        ir_sha256=target.seen.variant.ir_sha256, kind="duplicate" if sites else "none",
        addresses=target.addresses, sites=tuple(sites),
        lines=target.lines(sites), time=round(step.time, 3), share=share, predicted=predicted,
    )  # fmt: skip


def stated(found: Rate) -> Coverage | None:
    """A rate as a plan states it; None if it is not known."""
    if found.rate is None or found.low is None or found.high is None:
        return None
    return Coverage(estimate=found.rate, low=found.low, high=found.high)
