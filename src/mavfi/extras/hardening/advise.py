"""Advice: how much of the silent corruption each share of time removes, and a plan within a budget.

A golden flight gives executions and calls; faults in these calls give rates by instruction.  For each function a series
of choices is built and timed; the budget is spent on the steps that remove most corruptions per flight for their time.
Coverage is predicted by cross-validation: each part of the faults judges choices that were made from the other parts.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import numpy as np

from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate, clustered_rate, weighted_rate
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import processor
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.mission import host_of
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.extras.hardening.choose import NOTHING, Choice
from mavfi.extras.hardening.compiled import Timed, compare
from mavfi.extras.hardening.duplicate import protect
from mavfi.extras.hardening.observed import observe
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, Plan, Site
from mavfi.extras.hardening.target import Injected, Judged, Learn, Target, injections_in, targets_of
from mavfi.ir.build import environment_of
from mavfi.mission import Scenario
from mavfi.states import INJECTABLE, PLANNERS

FRACTIONS = tuple(place / 20 for place in range(1, 21))
"""Steps of a curve: shares of the cost of duplicating everything."""
_UNITS = 10_000
"""Number of units into which a budget is divided."""
TIMED_S = 1.0
"""For how long a function and its variants are timed at most (s): `mavfi harden` has a minute."""
_MUCH = 0.02
"""Share of a flight's kernel time from which on the error of a time matters to a budget."""
_ATTEMPTS = 4
"""How often a choice is made of which some steps are timed again, at most."""
_ROUNDS = 400
"""Number of rounds per second of that time that are enough: short functions have thousands."""


Ladder = list[tuple[float, Choice, Judged]]
"""Fraction, choice and prediction of each step of a function, from nothing to everything."""


@dataclass(frozen=True, slots=True)
class Step:
    """A choice for one function.

    Attributes:
        fraction: Of the instructions that duplicating everything adds; 0 = unprotected.
        choice: What is duplicated.
        time: Measured time / that of plain code.
        judged: Prediction, by injection.
    """

    fraction: float
    choice: Choice
    time: float
    judged: Judged

    @property
    def coverage(self) -> Rate:
        """Predicted share of silent corruptions that it removes."""
        return coverage_of(self.judged)


@dataclass(frozen=True, slots=True)
class Curve:
    """Choices for one function, from nothing to everything.

    Attributes:
        target: The function.
        ticks: Ticks of the time stamp counter in all calls of a golden flight.
        share: Share of the flight's kernel time.
        steps: By cost.
    """

    target: Target
    ticks: float
    share: float
    steps: tuple[Step, ...]

    def extra(self, step: Step) -> float:
        """Time that a step adds, as a share of the flight's kernel time."""
        return self.share * (step.time - 1)

    def removed(self, step: Step) -> float:
        """Silent corruptions that a step removes, per flight in which every dynamic instruction is injected once."""
        return self.target.sdc_mass * (step.coverage.rate or 0.0)


@dataclass(frozen=True, slots=True)
class Advice:
    """What to protect within a budget.

    Attributes:
        budget: Share of a flight's kernel time.
        curves: All functions.
        chosen: Index of the step for each of them.
        shared: Time that functions chosen for another planner add to the same flight, as a share of its kernel time.
    """

    budget: float
    curves: tuple[Curve, ...]
    chosen: tuple[int, ...]
    shared: float = 0.0

    @property
    def steps(self) -> list[tuple[Curve, Step]]:
        """The chosen step of each function."""
        return [(curve, curve.steps[place]) for curve, place in zip(self.curves, self.chosen, strict=True)]

    @property
    def spent(self) -> float:
        """Time that the plan adds, as a share of the flight's kernel time."""
        return self.shared + sum(curve.extra(step) for curve, step in self.steps)

    @property
    def coverage(self) -> Rate:
        """Predicted share of all silent corruptions that is removed."""
        return coverage_of_steps(self.steps)


def coverage_of(judged: Judged) -> Rate:
    """Share of silent corruptions that are removed, with an interval clustered by call."""
    return clustered_rate([hit for _, hit in judged], [one.world for one, _ in judged])


def coverage_of_steps(steps: Sequence[tuple[Curve, Step]]) -> Rate:
    """Predicted coverage of a step of each of several functions, weighted by their expected silent corruptions."""
    rows = [
        (hit, curve.target.sdc_mass, curve.target.name, f"{curve.target.name} {one.world}")
        for curve, step in steps
        if curve.target.sdc_mass > 0
        for one, hit in step.judged
    ]
    if rows:
        return weighted_rate(*zip(*rows, strict=True))
    return Rate(0, None, None, None)


def every_choice(target: Target, fractions: Sequence[float] = FRACTIONS) -> Ladder:
    """Nothing, and the best choices that add at most these fractions of the instructions of full duplication."""
    return [(fraction, target.chooser.share(fraction), target.judged(fraction)) for fraction in (0.0, *fractions)]


def choices_of(target: Target) -> Ladder:
    """Those of all choices that are predicted to remove more than each cheaper one, and full duplication.

    The others would be built and timed in vain.
    """
    ladder: Ladder = []
    most = -1
    for step in every_choice(target):
        fraction, _, judged = step
        removed = sum(hit for _, hit in judged)
        if removed > most or fraction == FRACTIONS[-1]:
            ladder.append(step)
        most = max(most, removed)
    return ladder


class Prepared(NamedTuple):
    """What can be said of a function before its time is measured.

    Attributes:
        injections: In its recorded calls.
        choices: Its steps.
        codes: As of `codes_of`, for all of them.
    """

    injections: list[Injected]
    choices: Ladder
    codes: list[bytes]


Tell = Callable[[str], None]
"""Receives a line of text when a piece of work begins."""
Choices = Callable[[Target], Ladder]
"""Makes the steps of a function, as `choices_of`."""


def codes_of(target: Target, duplicated: Sequence[Collection[Site]]) -> list[bytes]:
    """Machine code of a function to be timed: plain, then with each set of sites duplicated."""
    source = target.source
    plain = target.module
    variants = (protect(plain, sites, addresses=target.addresses) for sites in duplicated)
    return [Timed.code_of(source, module) for module in (plain, *variants)]


def times_of(target: Target, codes: Sequence[bytes], seconds: float = TIMED_S) -> tuple[float, list[float]]:
    """Ticks of a plain call, and the time of a call of each further code, as a multiple of it; at most `seconds`."""
    environment = environment_of(target.seen.function, target.seen.signature)
    base, *others = (Timed(target.source, code, environment).ticks for code in codes)
    clocks = {str(place): clock for place, clock in enumerate(others)}
    end = monotonic() + seconds
    timing = compare(base, clocks, target.seen.calls, lambda rounds: rounds >= _ROUNDS * seconds or monotonic() > end)
    return timing.ticks, [max(timing.ratios[name], 1.0) for name in clocks]


def prepare_all(
    targets: Sequence[Target], wanted: Collection[str], tell: Tell, learn: Learn, workers: int, choices: Choices
) -> list[Prepared]:
    """Inject, choose and build for the functions of some flights; the functions keep their injections.

    Args:
        targets: The functions; those of kernels that are not `wanted` are built as they are.
        wanted: Kernels to protect.
        tell: Called with the name of each function.
        learn: Injects faults in a function without injections.
        workers: Number of processes.
        choices: Makes the steps of a function.
    """

    def at(place: int) -> Prepared:
        target = targets[place]
        if set(wanted).isdisjoint(target.kernels):  # only the time of its plain code is of interest
            return Prepared([], [(0.0, NOTHING, [])], codes_of(target, []))
        target.injections = target.injections or learn(target.seen)
        ladder = choices(target)
        codes = codes_of(target, [target.sites(choice) for _, choice, _ in ladder[1:]])
        return Prepared(target.injections, ladder, codes)

    longest = sorted(range(len(targets)), key=lambda place: -sum(targets[place].seen.variant.table.sizes()))
    ready: dict[int, Prepared] = {}
    for place, own in map_each(LocalExecutor(workers), at, longest):
        ready[place] = own
        targets[place].injections = own.injections
        tell(f"injected faults in {targets[place].name} and made its choices ({len(ready)} of {len(targets)})")
    return [ready[place] for place in range(len(targets))]


def curves_of(
    targets: Sequence[Target], ready: Sequence[Prepared], other_ticks: float, tell: Tell, seconds: float
) -> tuple[Curve, ...]:
    """Time the steps of the functions of a flight.

    Args:
        targets: The functions.
        ready: As of `prepare_all`.
        other_ticks: Ticks of all other functions in the flight.
        tell: Called with the name of each function.
        seconds: For how long each is timed at most (s).
    """
    rows = []
    for target, own in zip(targets, ready, strict=True):
        tell(f"timing {target.name}")
        ticks, times = times_of(target, own.codes, seconds)
        steps = [
            Step(fraction, choice, time, judged)
            for (fraction, choice, judged), time in zip(own.choices, (1.0, *times), strict=True)
        ]
        rows.append((target, ticks * target.seen.total, tuple(steps)))
    whole = other_ticks + sum(ticks for _, ticks, _ in rows)
    return tuple(Curve(target, ticks, ticks / whole, steps) for target, ticks, steps in rows)


def allocate(curves: Sequence[Curve], budget: float) -> tuple[int, ...]:
    """Steps of all functions that together remove most within a share of the flight's kernel time.

    A multiple-choice knapsack problem, solved by dynamic programming over units of the budget (Kellerer, Pferschy
    and Pisinger, Knapsack Problems, 2004, chapter 11); the time of a step is rounded up to whole units.
    """
    best = np.zeros(_UNITS + 1)  # most that is removed within so many units
    taken: list[np.ndarray] = []
    for curve in curves:
        gains = np.full((len(curve.steps), _UNITS + 1), -np.inf)
        for number, step in enumerate(curve.steps):
            units = _units(curve.extra(step), budget)
            if units <= _UNITS:
                gains[number, units:] = best[: _UNITS + 1 - units] + curve.removed(step)
        taken.append(gains.argmax(axis=0))  # of equal ones the first, which adds fewest instructions
        best = gains.max(axis=0)
    left = _UNITS
    chosen = []
    for curve, steps in zip(reversed(curves), reversed(taken), strict=True):
        chosen.append(int(steps[left]))
        left -= _units(curve.extra(curve.steps[chosen[-1]]), budget)
    return tuple(reversed(chosen))


def settle(
    curves: Sequence[Curve], ready: Sequence[Prepared], budget: float, seconds: float = TIMED_S
) -> tuple[tuple[Curve, ...], tuple[int, ...]]:
    """Steps as of `allocate`; those of functions that take much of the flight's time are timed again once chosen.

    Of steps whose times are measured with an error, those are chosen whose error is favourable: together they would
    exceed the budget.  The second measurement does not depend on the choice.

    Returns:
        The curves, with the new times, and the index of the chosen step for each of them.
    """
    own = list(curves)
    known = set[tuple[int, int]]()
    for _ in range(_ATTEMPTS):
        chosen = set(enumerate(allocate(own, budget)))
        again = {(n, place) for n, place in chosen - known if place and own[n].share >= _MUCH}
        if not again:
            break
        known |= again
        for n, place in again:
            codes = ready[n].codes
            _, (time,) = times_of(own[n].target, [codes[0], codes[place]], seconds)
            steps = list(own[n].steps)
            steps[place] = replace(steps[place], time=time)
            own[n] = replace(own[n], steps=tuple(steps))
    return tuple(own), allocate(own, budget)


def _units(time: float, budget: float) -> int:
    """Units of the budget that a time takes; more than there are if it takes too many."""
    if time <= 0.0:
        return 0
    if budget > 0.0:
        return math.ceil(min(time / budget, 2.0) * _UNITS - 1e-9)
    return _UNITS + 1


# ---- from a ledger to a plan ----------------------------------------------------------------------------------------

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
            campaign = stored_campaign(store)
            digest = store.digest()
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
        if set(_sampled(self.campaign)) == set(self.kernels):
            return ()
        return self.kernels

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
        own = host_of(self.campaign)
        seed = self.campaign.first_seed
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
    study: Study,
    budget: float,
    tell: Tell = lambda _: None,
    *,
    addresses: bool = False,
    learn: Learn = injections_in,
    workers: int = 1,
    seconds: float = TIMED_S,
    choices: Choices = choices_of,
) -> list[Advice]:
    """Advice by planner of the missions, that of the campaign's planner first.

    The budget applies to each flight.  Functions that several planners share are chosen in the first one.  `addresses`
    is that of `Target`; `learn`, `workers` and `choices` are those of `prepare_all`, `seconds` is that of `curves_of`.

    Raises:
        BadInputError: A mission cannot be flown.
    """
    environment = study.campaign.environments[0]
    seed = study.campaign.first_seed
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
        kernel=target.kernels[0],
        function=target.name,
        signature=target.seen.signature_text,
        ir_sha256=target.seen.variant.ir_sha256,
        kind="duplicate" if sites else "none",
        addresses=target.addresses,
        sites=tuple(sites),
        lines=target.lines(sites),
        time=round(step.time, 3),
        share=share,
        predicted=predicted,
    )


def stated(found: Rate) -> Coverage | None:
    """A rate as a plan states it; None if it is not known."""
    if found.rate is None or found.low is None or found.high is None:
        return None
    return Coverage(estimate=found.rate, low=found.low, high=found.high)
