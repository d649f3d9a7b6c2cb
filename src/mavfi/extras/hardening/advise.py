"""Advice: how much of the silent corruption each share of time removes, and a plan within a budget.

Golden flights give executions and calls; faults in these calls give rates by instruction.  For each function a series
of choices is built and timed; the budget is spent on the steps that remove most corruptions per flight for their time.
Coverage is predicted by cross-validation: each mission judges choices that were made from the other missions.
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
from mavfi.analysis.statistics import Rate, correlation_of, further_worlds_half_width, rate_in_further_worlds
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import processor
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.resolve import resolve
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError, not_known
from mavfi.extras.hardening.choose import NOTHING, Choice
from mavfi.extras.hardening.compiled import Timed, compare
from mavfi.extras.hardening.duplicate import protect
from mavfi.extras.hardening.observed import observe_all
from mavfi.extras.hardening.plan import Coverage, FunctionKey, FunctionPlan, Kind, ModuleSite, ProtectionPlan
from mavfi.extras.hardening.target import (
    FunctionTarget,
    Injected,
    Injector,
    JudgedCorruptions,
    injections_in,
    targets_of,
)
from mavfi.extras.hardening.vulnerability.lines import no_instruction_faults
from mavfi.flight.targets import Targets
from mavfi.ir.build import environment_of
from mavfi.levels.instruction import campaign_targets
from mavfi.mission import Scenario
from mavfi.states import PLANNERS

FRACTIONS = tuple(twentieths / 20 for twentieths in range(1, 21))
"""Steps of a curve: shares of the cost of duplicating everything."""
_UNITS = 10_000
"""Number of units into which a budget is divided."""
TIMED_S = 1.0
"""For how long a function and its variants are timed at most (s): `mavfi harden` has a minute."""
_MAX_ROUNDS_PER_S = 400
"""Rounds per second of that time after which timing ends: short functions would have thousands."""
_MIN_RETIMED_SHARE = 0.02
"""Share of a flight's kernel time from which on the error of a function's time matters to a budget."""
FRESH = 2
"""Missions, per environment of the campaign, with which a plan is certified."""
MAX_OBSERVED = 8
"""Missions that the choice observes at most: between them coverage differs, which a prediction must know."""
_MAX_RETIMINGS = 4
"""How often steps of a choice are timed again at most."""


class LadderStep(NamedTuple):
    """A choice for one function before its time is measured.

    Attributes:
        fraction: Fraction of the instructions that duplicating everything adds; 0 = unprotected.
        choice: What is duplicated.
        judged: Prediction, by injection.
    """

    fraction: float
    choice: Choice
    judged: JudgedCorruptions


Ladder = list[LadderStep]
"""Steps of a function, from nothing to everything."""


@dataclass(frozen=True, slots=True)
class CurveStep:
    """A choice for one function.

    Attributes:
        fraction: Fraction of the instructions that duplicating everything adds; 0 = unprotected.
        choice: What is duplicated.
        time: Measured time / that of plain code.
        judged: Prediction, by injection.
        unseen_share: Share of a further mission's instructions that no choice has seen, see `ObservedFunction`.
    """

    fraction: float
    choice: Choice
    time: float
    judged: JudgedCorruptions
    unseen_share: float = 0.0

    @property
    def removed_share(self) -> float:
        """Share of the judged silent corruptions that it removes; 0 without any."""
        return sum(removed for _, removed in self.judged) / max(len(self.judged), 1)

    @property
    def coverage(self) -> Rate:
        """Predicted share of silent corruptions that it removes; not known if too few missions were seen.

        The interval is that of `FRESH` further missions.  Of their instructions `unseen_share` is expected where the
        choice duplicates nothing.
        """
        if self.fraction == 0.0:
            return Rate(len(self.judged), 0.0, 0.0, 0.0, 0)
        worlds = [injected.world for injected, _ in self.judged]
        rate = rate_in_further_worlds([removed for _, removed in self.judged], worlds, FRESH)
        if rate.low is None:
            return rate
        return replace(rate, low=rate.low * (1 - self.unseen_share))


@dataclass(frozen=True, slots=True)
class Curve:
    """Choices for one function, from nothing to everything.

    Attributes:
        target: The function.
        ticks: Ticks of the time stamp counter in all calls of a golden flight.
        share: Share of the flight's kernel time.
        steps: By cost.
    """

    target: FunctionTarget
    ticks: float
    share: float
    steps: tuple[CurveStep, ...]

    def extra(self, step: CurveStep) -> float:
        """Time that a step adds, as a share of the flight's kernel time."""
        return self.share * (step.time - 1)

    def removed(self, step: CurveStep) -> float:
        """Silent corruptions that a step removes, per flight in which every dynamic instruction is injected once."""
        return self.target.sdc_mass * step.removed_share


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
    def steps(self) -> list[tuple[Curve, CurveStep]]:
        """The chosen step of each function."""
        return [(curve, curve.steps[step]) for curve, step in zip(self.curves, self.chosen, strict=True)]

    @property
    def spent(self) -> float:
        """Time that the plan adds, as a share of the flight's kernel time."""
        return self.shared + sum(curve.extra(step) for curve, step in self.steps)

    @property
    def coverage(self) -> Rate:
        """Predicted share of all silent corruptions that is removed."""
        return coverage_of_steps(self.steps)


def coverage_of_steps(steps: Sequence[tuple[Curve, CurveStep]]) -> Rate:
    """Predicted coverage of a step of each of several functions, weighted by their expected silent corruptions.

    Functions without a prediction count as not removed, for the upper bound as removed.
    """
    counted = [(curve.target, step) for curve, step in steps if curve.target.sdc_mass > 0]
    predicted = [step.coverage for _, step in counted]
    n = sum(rate.n for rate in predicted)
    if all(rate.rate is None for rate in predicted):
        return Rate(n, None, None, None)
    masses = np.array([target.sdc_mass for target, _ in counted])
    shares = masses / masses.sum()

    # 1. The error within the functions: they share missions, so it is correlated.
    bounds = np.array([_bounds_of(rate) for rate in predicted])
    rates = bounds[:, 0]
    below = shares * (rates - bounds[:, 1])
    above = shares * (bounds[:, 2] - rates)
    missions = list(dict.fromkeys(mission for target, _ in counted for mission in target.sdc_mass_by_mission))
    errors = np.zeros((len(counted), len(missions)))
    for row, (_, step) in zip(errors, counted, strict=True):
        for injected, removed in step.judged:
            row[missions.index(injected.world)] += removed - step.removed_share
    correlation = correlation_of(errors)

    # 2. The error of the weights: they differ between missions, and are products of rates with errors.
    total = float(shares @ rates)
    leverage = shares * (rates - total)
    mass_shares = np.array(
        [
            [target.sdc_mass_by_mission.get(mission, 0.0) / target.sdc_mass for mission in missions]
            for target, _ in counted
        ]
    )
    between = further_worlds_half_width(leverage @ mass_shares, FRESH)
    within = leverage * [_relative_error(target.sdc_rate) for target, _ in counted]
    weights = between**2 + float(within @ within)

    low = total - math.sqrt(below @ correlation @ below + weights)
    high = total + math.sqrt(above @ correlation @ above + weights)
    return Rate(n, total, max(low, 0.0), min(high, 1.0))


def _bounds_of(rate: Rate) -> tuple[float, float, float]:
    """A predicted coverage and its interval; without a prediction nothing, from nothing to everything."""
    if rate.rate is None or rate.low is None or rate.high is None:
        return 0.0, 0.0, 1.0
    return rate.rate, rate.low, rate.high


def _relative_error(rate: Rate) -> float:
    """Half-width of the interval of a rate as a multiple of it."""
    if not rate.rate or rate.low is None or rate.high is None:
        return 0.0
    return (rate.high - rate.low) / 2 / rate.rate


def every_choice(target: FunctionTarget, fractions: Sequence[float] = FRACTIONS) -> Ladder:
    """Nothing, and the best choices that add at most these fractions of the instructions of full duplication."""
    return [LadderStep(f, target.chooser.share(f), target.judged(f)) for f in (0.0, *fractions)]


def choices_of(target: FunctionTarget) -> Ladder:
    """The choices that are predicted to remove more than each cheaper one, and full duplication.

    The others would be built and timed in vain.
    """
    ladder: Ladder = []
    most_removed = -1
    for step in every_choice(target):
        removed = sum(is_removed for _, is_removed in step.judged)
        if removed > most_removed or step.fraction == FRACTIONS[-1]:
            ladder.append(step)
        most_removed = max(most_removed, removed)
    return ladder


class PreparedFunction(NamedTuple):
    """A function before its time is measured.

    Attributes:
        injections: Injections in its recorded calls.
        ladder: Its steps.
        codes: Machine code of all steps, see `codes_of`.
    """

    injections: list[Injected]
    ladder: Ladder
    codes: list[bytes]


Tell = Callable[[str], None]
"""Receives a line of text when a piece of work begins."""
LadderMaker = Callable[[FunctionTarget], Ladder]
"""Makes the steps of a function, as `choices_of`."""


def codes_of(target: FunctionTarget, duplicated: Sequence[Collection[ModuleSite]]) -> list[bytes]:
    """Machine code of a function to be timed: plain, then with each set of sites duplicated."""
    source = target.source
    plain = target.module
    variants = (protect(plain, sites, addresses=target.addresses) for sites in duplicated)
    return [Timed.code_of(source, module) for module in (plain, *variants)]


def times_of(target: FunctionTarget, codes: Sequence[bytes], seconds: float = TIMED_S) -> tuple[float, list[float]]:
    """Time a function for at most some seconds.

    Args:
        target: The function.
        codes: Machine code of its plain and its protected variants, see `codes_of`.
        seconds: For how long (s).

    Returns:
        Ticks of a plain call, and the time of a call of each protected variant as a multiple of it, at least 1.
    """
    environment = environment_of(target.seen.function, target.seen.signature)
    plain, *protected = (Timed(target.source, code, environment).ticks for code in codes)
    clocks = {str(number): clock for number, clock in enumerate(protected)}
    end = monotonic() + seconds

    def is_enough(rounds: int) -> bool:
        return rounds >= _MAX_ROUNDS_PER_S * seconds or monotonic() > end

    timing = compare(plain, clocks, target.seen.calls, is_enough)
    return timing.ticks, [max(timing.ratios[name], 1.0) for name in clocks]


def prepare_all(
    targets: Sequence[FunctionTarget],
    wanted: Collection[str],
    tell: Tell,
    inject: Injector,
    workers: int,
    choices: LadderMaker,
) -> list[PreparedFunction]:
    """Inject, choose and build for the functions of some flights; the functions keep their injections.

    Args:
        targets: The functions; those of kernels that are not `wanted` are built as they are.
        wanted: Kernels to protect.
        tell: Called with the name of each function.
        inject: Injects faults in a function without injections.
        workers: Number of processes.
        choices: Makes the steps of a function.
    """

    def prepare(number: int) -> PreparedFunction:
        target = targets[number]
        if set(wanted).isdisjoint(target.kernels):  # only the time of its plain code is of interest
            return PreparedFunction([], [LadderStep(0.0, NOTHING, [])], codes_of(target, []))
        target.injections = target.injections or inject(target.seen)
        ladder = choices(target)
        codes = codes_of(target, [target.sites(step.choice) for step in ladder[1:]])
        return PreparedFunction(target.injections, ladder, codes)

    # The largest functions first: none of them is left for a single worker at the end.
    longest_first = sorted(range(len(targets)), key=lambda number: -sum(targets[number].seen.variant.table.sizes()))
    prepared: dict[int, PreparedFunction] = {}
    for number, result in map_each(LocalExecutor(workers), prepare, longest_first):
        prepared[number] = result
        targets[number].injections = result.injections  # they were made in another process
        tell(f"injected faults in {targets[number].name} and made its choices ({len(prepared)} of {len(targets)})")
    return [prepared[number] for number in range(len(targets))]


def curves_of(
    targets: Sequence[FunctionTarget],
    prepared: Sequence[PreparedFunction],
    other_ticks: float,
    tell: Tell,
    seconds: float,
) -> tuple[Curve, ...]:
    """Time the steps of the functions of some flights.

    Args:
        targets: The functions.
        prepared: The same functions, see `prepare_all`.
        other_ticks: Ticks of all other functions in the flights.
        tell: Called with the name of each function.
        seconds: For how long each is timed at most (s).
    """
    rows = []
    for target, function in zip(targets, prepared, strict=True):
        tell(f"timing {target.name}")
        ticks, times = times_of(target, function.codes, seconds)
        unseen_share = target.seen.unseen_share
        steps = [
            CurveStep(step.fraction, step.choice, time, step.judged, unseen_share)
            for step, time in zip(function.ladder, (1.0, *times), strict=True)
        ]
        rows.append((target, ticks * target.seen.total, tuple(steps)))
    flight_ticks = other_ticks + sum(ticks for _, ticks, _ in rows)
    return tuple(Curve(target, ticks, ticks / flight_ticks, steps) for target, ticks, steps in rows)


def allocate(curves: Sequence[Curve], budget: float) -> tuple[int, ...]:
    """Steps of all functions that together remove most within a share of the flight's kernel time.

    A multiple-choice knapsack problem, solved by dynamic programming over units of the budget (Kellerer, Pferschy
    and Pisinger, Knapsack Problems, 2004, chapter 11); the time of a step is rounded up to whole units.
    """
    # Forwards: how much do the first functions remove within each number of units, and by which steps?
    best = np.zeros(_UNITS + 1)
    taken: list[np.ndarray] = []  # by function: index of the step within each number of units
    for curve in curves:
        gains = np.full((len(curve.steps), _UNITS + 1), -np.inf)
        for number, step in enumerate(curve.steps):
            units = _units(curve.extra(step), budget)
            if units <= _UNITS:
                gains[number, units:] = best[: _UNITS + 1 - units] + curve.removed(step)
        taken.append(gains.argmax(axis=0))  # of equal ones the first, which adds fewest instructions
        best = gains.max(axis=0)

    # Backwards: the step of the last function within all units, then that of the one before within what is left.
    left = _UNITS
    chosen = []
    for curve, steps in zip(reversed(curves), reversed(taken), strict=True):
        chosen.append(int(steps[left]))
        left -= _units(curve.extra(curve.steps[chosen[-1]]), budget)
    return tuple(reversed(chosen))


def allocate_and_retime(
    curves: Sequence[Curve], prepared: Sequence[PreparedFunction], budget: float, seconds: float = TIMED_S
) -> tuple[tuple[Curve, ...], tuple[int, ...]]:
    """Choose steps by `allocate`; once chosen, those of functions that take much of the flight are timed again.

    Of steps whose times are measured with an error, those are chosen whose error is favourable: together they would
    exceed the budget.  The second measurement does not depend on the choice.

    Returns:
        The curves, with the new times, and the index of the chosen step for each of them.
    """
    updated = list(curves)
    retimed = set[tuple[int, int]]()  # function and step
    for _ in range(_MAX_RETIMINGS):
        chosen = set(enumerate(allocate(updated, budget)))
        due = {(n, step) for n, step in chosen - retimed if step and updated[n].share >= _MIN_RETIMED_SHARE}
        if not due:
            break
        retimed |= due
        for n, step in due:
            codes = prepared[n].codes
            _, (time,) = times_of(updated[n].target, [codes[0], codes[step]], seconds)
            steps = list(updated[n].steps)
            steps[step] = replace(steps[step], time=time)
            updated[n] = replace(updated[n], steps=tuple(steps))
    return tuple(updated), allocate(updated, budget)


def _units(time: float, budget: float) -> int:
    """Units of the budget that a time takes; more than there are if it takes too many."""
    if time <= 0.0:
        return 0
    if budget > 0.0:
        return math.ceil(min(time / budget, 2.0) * _UNITS - 1e-9)
    return _UNITS + 1


# ---- from a ledger to a plan ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HardeningStudy:
    """A campaign of instruction faults, as input of the choice.

    Attributes:
        directory: Folder of its ledger.
        campaign: The campaign.
        digest: Digest of its runs.
        kernels: Kernels to protect.
    """

    directory: Path
    campaign: Campaign
    digest: str
    kernels: tuple[str, ...]

    @staticmethod
    def open(directory: Path, kernels: Sequence[str] = ()) -> "HardeningStudy":
        """Open a ledger; no `kernels` = all in which it has faults.

        Raises:
            BadInputError: It is not a ledger of instruction faults, or has none in a kernel.
        """
        with Store.open(directory) as store:
            campaign = stored_campaign(store)
            digest = store.digest()
        sampled = _sampled(campaign)
        if not sampled:
            raise no_instruction_faults(directory)
        for kernel in kernels:
            if kernel not in sampled:
                raise BadInputError(f"--kernels: {not_known(kernel, sampled)}")
        return HardeningStudy(directory, campaign, digest, tuple(kernels) or sampled)

    @cached_property
    def runs(self) -> Runs:
        """The ledger's runs."""
        return Runs.read(self.directory)

    def by_planner(self) -> dict[str, tuple[str, ...]]:
        """All kernels of the missions that are flown, by planner; that of the campaign's mission comes first."""
        environment = self.campaign.environments[0]
        seed = self.campaign.first_seed
        planner_of_campaign = self.campaign.spec(environment, seed).planner
        planners = dict.fromkeys([planner_of_campaign, *(kernel for kernel in self.kernels if kernel in PLANNERS)])
        return {planner: _kernels_of(self.scenario(environment, seed, planner)) for planner in planners}

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
        scenario: Scenario = resolve(self.campaign).host.resolve(
            self.campaign.spec(environment, seed, {"planner": planner})
        )
        return scenario

    @property
    def worlds(self) -> list[str]:
        """Names of the environments of its campaign, whose own names may be paths or parts."""
        host = resolve(self.campaign).host
        seed = self.campaign.first_seed
        specs = (self.campaign.spec(environment, seed) for environment in self.campaign.environments)
        return list(dict.fromkeys(host.resolve(spec).environment.name for spec in specs))

    @property
    def studied(self) -> dict[str, tuple[int, int]]:
        """First and last seed of its missions, by environment."""
        seeds = self.campaign.seeds
        return dict.fromkeys(self.worlds, (seeds.start, seeds.stop - 1))

    def observed(self, planner: str) -> list[Scenario]:
        """Missions of the ledger that the choice observes, evenly over the environments."""
        missions = [(environment, seed) for seed in self.campaign.seeds for environment in self.campaign.environments]
        return [self.scenario(environment, seed, planner) for environment, seed in missions[:MAX_OBSERVED]]

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


def _kernels_of(scenario: Scenario) -> tuple[str, ...]:
    """The kernels and plug-ins of a mission that faults can be in, the planner last."""
    targets = Targets(scenario)
    return tuple(sorted(targets.names, key=lambda name: targets.find(name).kernel == "planner"))


def _sampled(campaign: Campaign) -> tuple[str, ...]:
    """Its kernels; detectors, of which it may sample instructions, too, are not protected."""
    if campaign.sampling.level != "instruction":
        return ()
    return tuple(target.name for target in campaign_targets(campaign) if not target.arm)


class _PlannerFlight(NamedTuple):
    """Functions in the golden flights of a planner: those that flights of earlier planners call, too, and new ones."""

    shared: list[FunctionTarget]
    new: list[FunctionTarget]


def advise(
    study: HardeningStudy,
    budget: float,
    tell: Tell = lambda _: None,
    *,
    addresses: bool = False,
    inject: Injector = injections_in,
    workers: int = 1,
    seconds: float = TIMED_S,
    choices: LadderMaker = choices_of,
) -> list[Advice]:
    """Advice by planner of the missions, that of the campaign's planner first.

    The budget applies to each flight.  Functions that several planners share are chosen in the first one.

    Args:
        study: The ledger.
        budget: Largest share of a flight's kernel time to add.
        tell: Called with each piece of work.
        addresses: See `FunctionTarget`.
        inject: See `prepare_all`.
        workers: Number of processes.
        seconds: For how long each function is timed at most (s).
        choices: See `prepare_all`.

    Raises:
        BadInputError: A mission cannot be flown.
    """
    # 1. Fly golden missions with each planner: which functions do they call that no earlier planner calls?
    flights: list[_PlannerFlight] = []
    earlier: dict[FunctionKey, FunctionTarget] = {}
    for planner, kernels in study.by_planner().items():
        seen = observe_all(study.observed(planner), kernels, tell)
        targets = targets_of(seen, addresses=addresses)
        shared = [earlier[target.key] for target in targets if target.key in earlier]
        new = [target for target in targets if target.key not in earlier]
        flights.append(_PlannerFlight(shared, new))
        earlier |= {target.key: target for target in new}

    # 2. Inject faults in all functions, and make and build their steps, in parallel.
    targets = [target for flight in flights for target in flight.new]
    results = prepare_all(targets, study.kernels, tell, inject, workers, choices)
    prepared_of = {target.key: result for target, result in zip(targets, results, strict=True)}

    # 3. Time the steps and spend the budget of each flight; shared functions have spent a part of it already.
    advices: list[Advice] = []
    for flight in flights:
        chosen = {curve.target.key: (curve, step) for advice in advices for curve, step in advice.steps}
        shared_steps = [chosen[target.key] for target in flight.shared]
        shared_ticks = sum(curve.ticks for curve, _ in shared_steps)
        prepared = [prepared_of[target.key] for target in flight.new]
        curves = curves_of(flight.new, prepared, shared_ticks, tell, seconds)
        flight_ticks = shared_ticks + sum(curve.ticks for curve in curves)
        spent = sum(curve.ticks * (step.time - 1) for curve, step in shared_steps) / flight_ticks
        curves, steps = allocate_and_retime(curves, prepared, budget - spent, seconds)
        advices.append(Advice(budget, curves, steps, spent))
    return advices


def plan_of(study: HardeningStudy, advices: Sequence[Advice]) -> ProtectionPlan:
    """The plan of an advice; functions that were considered and are not protected have the kind none."""
    ticks_of_kernel: dict[str, float] = defaultdict(float)
    for advice in advices:
        for curve in advice.curves:
            ticks_of_kernel[curve.target.kernels[0]] += curve.ticks
    functions = []
    for advice in advices:
        for curve, step in advice.steps:
            if len(curve.steps) > 1:  # others are of kernels that are not to be protected
                share = round(curve.ticks / ticks_of_kernel[curve.target.kernels[0]], 4)
                functions.append(planned_of(curve.target, step, share))
    return ProtectionPlan(
        cpu=processor(),
        ledger=study.digest,
        studied=study.studied,
        budget=advices[0].budget,
        functions=tuple(functions),
    )


def planned_of(target: FunctionTarget, step: CurveStep, share: float | None = None) -> FunctionPlan:
    """The entry of a function in a plan; `share`: its share of the time of its kernel."""
    sites = target.sites(step.choice)
    kind: Kind = "none"
    predicted = None
    if sites:
        kind = "duplicate"
        predicted = coverage_in_plan(step.coverage)
    return FunctionPlan(
        kernel=target.kernels[0],
        function=target.name,
        signature=target.seen.signature_text,
        ir_sha256=target.seen.variant.ir_sha256,
        kind=kind,
        addresses=target.addresses,
        sites=tuple(sites),
        lines=target.lines(sites),
        time=round(step.time, 3),
        share=share,
        predicted=predicted,
    )


def coverage_in_plan(rate: Rate) -> Coverage | None:
    """A rate as a plan states it; None if it is not known."""
    if rate.rate is None or rate.low is None or rate.high is None:
        return None
    return Coverage(estimate=rate.rate, low=rate.low, high=rate.high)
