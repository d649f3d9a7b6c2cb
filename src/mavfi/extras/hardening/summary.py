"""An advice in numbers, for the terminal, JSON and the page, and what the faults of its ledger did to missions."""

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import polars as pl

from mavfi.analysis.rows import ACTIVATED, KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate, clustered_rate
from mavfi.campaign.plan import FI
from mavfi.errors import BadInputError
from mavfi.extras.hardening.advise import Advice, Curve, CurveStep, HardeningStudy, coverage_of_steps
from mavfi.extras.hardening.certify import rate_of
from mavfi.extras.hardening.choose import added
from mavfi.extras.hardening.duplicate import candidates
from mavfi.extras.hardening.plan import FunctionKey, ModuleSite, ProtectionPlan
from mavfi.extras.hardening.target import FunctionTarget
from mavfi.outcomes import Effect

_SDC = Effect.SDC.label
_SMALLEST_SUM = 1e-300
"""Divisor of shares where all are 0."""


@dataclass(frozen=True, slots=True)
class Harm:
    """What the faults of a ledger did to missions that succeed without them: what protection cannot buy.

    Attributes:
        silent: Missions lost to a silent corruption.
        dead: Missions lost to a crash, hang or exception of a kernel, whose node restarts.
        dead_share: Crashes, hangs and exceptions per injection.
    """

    silent: Rate
    dead: Rate
    dead_share: Rate


def harm_of(runs: Runs) -> Harm:
    """Missions lost in a ledger, by effect on the kernel; bits and instructions as drawn.

    Raises:
        BadInputError: No flight with a fault in an instruction is done.
    """
    injected = runs.injected.where("judged", "golden_success", level="instruction", setting=FI, site_outcome=ACTIVATED)
    if not len(injected):
        raise BadInputError(
            "no flight with a fault in an instruction has ended and met its instruction; "
            "`mavfi campaign run` flies the rest"
        )
    silent = injected.where(kernel_effect=_SDC)
    dead = injected.where(pl.col("kernel_effect").is_in(KERNEL_DUE))
    is_dead = [effect in KERNEL_DUE for effect in injected["kernel_effect"]]
    return Harm(
        silent=_lost(silent),
        dead=_lost(dead),
        dead_share=clustered_rate(is_dead, injected["world"]),
    )


def _lost(runs: Runs) -> Rate:
    """Lost missions per fault; the faults of one world are a cluster."""
    return clustered_rate([not success for success in runs["success"]], runs["world"])


# ---- the advice -----------------------------------------------------------------------------------------------------

PROTECTED = "protected"
"""Key of the removed share among the `escapes` of a function."""


@dataclass(frozen=True, slots=True)
class KernelSummary:
    """What the advice says of a kernel.

    Attributes:
        kernel: Its name.
        share: Share of a flight's kernel time.
        added: Time that the plan adds, as a share of a flight's kernel time.
        time: Protected / plain time.
        coverage: Predicted share of its silent corruptions that is removed.
    """

    kernel: str
    share: float
    added: float
    time: float
    coverage: Rate


@dataclass(frozen=True, slots=True)
class StepSummary:
    """A step of a function's curve.

    Attributes:
        fraction: Of the instructions that duplicating everything adds.
        instructions: Dynamic instructions / those of the plain function.
        time: Measured time / that of plain code.
        coverage: Predicted share of silent corruptions that it removes.
        chosen: Whether the advice takes this step.
    """

    fraction: float
    instructions: float
    time: float
    coverage: Rate
    chosen: bool


@dataclass(frozen=True, slots=True)
class LineSummary:
    """An executed source line of a function.

    Attributes:
        file: Source file; "" = not known.
        line: Number in the file.
        instructions: Share of the function's dynamic instructions.
        sdc: Share of its expected silent corruptions.
        protected: Share of the latter that the plan removes.
    """

    file: str
    line: int
    instructions: float
    sdc: float
    protected: float


@dataclass(frozen=True, slots=True)
class FunctionSummary:
    """What the advice says of a function.

    Attributes:
        kernel: The first kernel that calls it.
        function: Module and name.
        entry: Its name.
        signature: Numba types of its arguments.
        calls: Number of calls in the golden flights.
        recorded: Number of these whose arguments were recorded.
        missions: Number of missions that call it.
        instructions: Dynamic instructions of these.
        injections: Number of injections in recorded calls.
        sdc: Silent corruptions per injection.
        share: Share of the flight's kernel time.
        time: Protected / plain time of the chosen step.
        added: Time that this adds, as a share of the flight's kernel time.
        coverage: Predicted share of silent corruptions that it removes; not known if too few missions call it.
        certified: The same, measured with fresh faults in the same protected code; None = not certified.
        sites: Number of duplicated instructions.
        all_sites: Number of those that can be duplicated.
        steps: Its curve.
        escapes: Shares of the expected silent corruptions: `PROTECTED`, and those that escape, by reason.
        lines: Its executed source lines.
        unseen_lines: Source lines that no mission executed, by file.
    """

    kernel: str
    function: str
    entry: str
    signature: str
    calls: int
    recorded: int
    missions: int
    instructions: int
    injections: int
    sdc: Rate
    share: float
    time: float
    added: float
    coverage: Rate
    certified: Rate | None
    sites: int
    all_sites: int
    steps: tuple[StepSummary, ...]
    escapes: dict[str, float]
    lines: tuple[LineSummary, ...]
    unseen_lines: dict[str, list[int]]


@dataclass(frozen=True, slots=True)
class AdviceSummary:
    """What to protect, what it costs, which share of the silent corruptions goes, and what remains.

    Attributes:
        campaign: Name of the campaign.
        ledger: Digest of its ledger.
        budget: Share of a flight's kernel time that may be added.
        spent: What the plan adds, in the campaign's missions; other planners fly in missions of their own.
        coverage: Predicted share of the silent corruptions that is removed, in the same missions.
        injections: Number of injections from which the choice was made.
        complete: Whether the studied kernels are all of the missions.
        selected: The studied kernels, if they are not all of the ledger's.
        addresses: Whether addresses are compared before loads, too.
        kernels: By kernel.
        functions: By function.
        harm: What faults did to missions.
    """

    campaign: str
    ledger: str
    budget: float
    spent: float
    coverage: Rate
    injections: int
    complete: bool
    selected: tuple[str, ...]
    addresses: bool
    kernels: tuple[KernelSummary, ...]
    functions: tuple[FunctionSummary, ...]
    harm: Harm


def summary(
    study: HardeningStudy, advices: Sequence[Advice], harm: Harm, plan: ProtectionPlan | None = None
) -> AdviceSummary:
    """Sum up an advice; `plan` is the plan made from it, which states the certified coverage of functions."""
    first = advices[0]
    certified: dict[FunctionKey, Rate] = {}
    if plan is not None:
        certified = {planned.key: rate_of(planned.certified) for planned in plan.functions if planned.certified}
    studied = [(curve, step) for advice in advices for curve, step in advice.steps if curve.target.injections]
    return AdviceSummary(
        campaign=study.campaign.name,
        ledger=study.digest,
        budget=first.budget,
        spent=first.spent,
        coverage=first.coverage,
        injections=sum(len(curve.target.injections) for curve, _ in studied),
        complete=study.complete,
        selected=study.selected,
        addresses=any(curve.target.addresses for curve, _ in studied),
        kernels=tuple(_kernel(kernel, studied) for kernel in study.kernels),
        functions=tuple(_function(curve, step, certified.get(curve.target.key)) for curve, step in studied),
        harm=harm,
    )


def growth_of(curve: Curve, step: CurveStep) -> float:
    """Dynamic instructions of a step / those of the plain function."""
    return 1 + added(curve.target.values, step.choice.chosen) / max(curve.target.seen.instructions, 1)


def _kernel(kernel: str, studied: Sequence[tuple[Curve, CurveStep]]) -> KernelSummary:
    steps = [(curve, step) for curve, step in studied if kernel in curve.target.kernels]
    share = sum(curve.share for curve, _ in steps)
    extra = sum(curve.extra(step) for curve, step in steps)
    time = 1.0
    if share:
        time = 1 + extra / share
    return KernelSummary(kernel, share, extra, time, coverage_of_steps(steps))


def _function(curve: Curve, chosen: CurveStep, certified: Rate | None) -> FunctionSummary:
    """What was measured of a function, and what the chosen step does to it."""
    target = curve.target
    sites = target.sites(chosen.choice)
    steps = tuple(
        StepSummary(step.fraction, growth_of(curve, step), step.time, step.coverage, step is chosen)
        for step in curve.steps
    )
    return FunctionSummary(
        kernel=target.kernels[0],
        function=target.name,
        entry=target.seen.entry,
        signature=target.seen.signature_text,
        calls=target.seen.total,
        recorded=len(target.seen.calls),
        missions=len(target.seen.parts),
        instructions=target.seen.instructions,
        injections=len(target.injections),
        sdc=target.sdc_rate,
        share=curve.share,
        time=chosen.time,
        added=curve.extra(chosen),
        coverage=chosen.coverage,
        certified=certified,
        sites=len(sites),
        all_sites=len(target.values),
        steps=steps,
        escapes=_escapes(target, sites),
        lines=_lines(target, sites),
        unseen_lines=target.unseen_lines,
    )


def _escapes(target: FunctionTarget, sites: Collection[ModuleSite]) -> dict[str, float]:
    """Shares of the expected silent corruptions: removed, not affordable, and not duplicable, the latter by opcode."""
    repeatable = set(candidates(target.module))
    masses: dict[str, float] = defaultdict(float)
    for executed in target.masses:
        if executed.site in sites:
            reason = PROTECTED
        elif executed.site in repeatable:
            reason = "beyond the budget"
        else:
            reason = f"cannot repeat: {executed.row.opcode}"
        masses[reason] += executed.mass
    total = max(sum(masses.values()), _SMALLEST_SUM)
    return {reason: mass / total for reason, mass in sorted(masses.items(), key=lambda item: -item[1]) if mass}


@dataclass(slots=True)
class _LineSums:
    """Sums over the executed sites of a source line: executions, expected silent corruptions, and removed ones."""

    executions: float = 0.0
    mass: float = 0.0
    removed: float = 0.0


def _lines(target: FunctionTarget, sites: Collection[ModuleSite]) -> tuple[LineSummary, ...]:
    """Executed source lines, by file and number."""
    sums: dict[tuple[str, int], _LineSums] = defaultdict(_LineSums)
    for executed in target.masses:
        line = sums[executed.row.file, executed.row.line]
        line.executions += executed.executions
        line.mass += executed.mass
        if executed.site in sites:
            line.removed += executed.mass
    all_executions = max(sum(line.executions for line in sums.values()), _SMALLEST_SUM)
    all_masses = max(sum(line.mass for line in sums.values()), _SMALLEST_SUM)
    lines = []
    for (file, number), line in sorted(sums.items(), key=lambda item: item[0]):
        removed_share = 0.0
        if line.mass:
            removed_share = line.removed / line.mass
        share_of_executions = line.executions / all_executions
        lines.append(LineSummary(file, number, share_of_executions, line.mass / all_masses, removed_share))
    return tuple(lines)
