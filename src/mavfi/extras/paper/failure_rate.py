"""Failures per flight hour: upset rate x dynamic instructions per flight hour x measured increase in failures (harm).

The paper's rates are conditional on one fault per mission.  They cannot compare schemes that execute different numbers
of instructions: idle instructions added by a scheme lower the share of harmful faults but save no mission (Schirmeier,
Borchert, Spinczyk, DSN 2015).  The absolute number of failures can.  Detectors and recovery are therefore counted,
injected and summed like other kernels, and recomputations count towards their kernels.
"""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import polars as pl
from pydantic import Field, model_validator

from mavfi.analysis.measures import Measure, against_fi
from mavfi.analysis.runs import ALL, Runs
from mavfi.analysis.statistics import Estimate, Rate, paired_difference
from mavfi.analysis.table import ESTIMATE, NUMBER, POINTS, Table
from mavfi.analysis.views import View, has
from mavfi.campaign.plan import FI
from mavfi.config import Config, shipped
from mavfi.plugins import Chapter
from mavfi.report.text import cell
from mavfi.states import DETECTORS, PLANNERS

_HOUR = 3600.0


class Range(Config):
    """A value with its uncertainty band."""

    value: float = Field(ge=0, le=1e9)
    low: float = Field(ge=0, le=1e9)
    high: float = Field(ge=0, le=1e9)

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if not self.low <= self.value <= self.high:
            raise ValueError(f"value: {self.value:g}: allowed: {self.low:g} to {self.high:g}, its low and high")
        return self


class UpsetConfig(Config):
    """Parameters of the rate at which radiation changes instruction results."""

    name: str
    fit_per_mbit: Range = Field(description="upsets per 10^9 h and Mbit at sea level in New York City")
    unprotected_mbit: float = Field(gt=0, le=1e6, description="state without error correction, Mbit")
    visible: float = Field(gt=0, le=1, description="share of its upsets that change the result of an instruction")
    altitude: Range = Field(description="m above sea level")
    instructions_per_second: float = Field(gt=0, le=1e15, description="of the busy processor")
    sources: dict[str, str] = Field(default_factory=dict, description="source of a value, by key")

    @model_validator(mode="after")
    def _known_keys(self) -> "UpsetConfig":
        for name in self.sources:
            if name not in type(self).model_fields:
                allowed = ", ".join(key for key in type(self).model_fields if key not in ("name", "sources"))
                raise ValueError(f"sources: {name!r}: not known; allowed: {allowed}")
        if self.altitude.high > MAX_ALTITUDE:
            raise ValueError(f"altitude: {self.altitude.high:g} m: allowed: up to {MAX_ALTITUDE:g}")
        return self


MAX_ALTITUDE = 18_000.0
"""Highest altitude at which the flux formula is valid (m)."""


def find_upsets(name: str = "low_altitude") -> UpsetConfig:
    """Load upset rates: shipped ones by name or a file by path; `BadInputError` if they do not exist or are invalid."""
    return shipped("upsets", UpsetConfig, name)


def altitude_factor(altitude: float) -> float:
    """Neutron flux at an altitude (m) relative to sea level, after JESD89A: exp((1033 - A) / 131.3).

    A is the atmospheric depth (g/cm2), 1033 exp(-0.03813 h - 0.00014 h^2 + 6.4e-7 h^3), h in 1000 ft.
    """
    h = altitude / 304.8
    depth = 1033.0 * math.exp(-0.03813 * h - 0.00014 * h * h + 6.4e-7 * h**3)
    return math.exp((1033.0 - depth) / 131.3)


def upsets_per_instruction(upsets: UpsetConfig) -> Estimate:
    """Probability that an upset changes the result of one instruction, with the band due to flux and FIT rate.

    Visible upsets per busy hour, FIT/Mbit x 1e-9 x Mbit x flux x visible, divided by instructions per busy hour.
    """

    def at(fit: float, altitude: float) -> float:
        per_hour = 1e-9 * fit * upsets.unprotected_mbit * upsets.visible * altitude_factor(altitude)
        return per_hour / (_HOUR * upsets.instructions_per_second)

    fit = upsets.fit_per_mbit
    altitude = upsets.altitude
    return Estimate(at(fit.value, altitude.value), at(fit.low, altitude.low), at(fit.high, altitude.high))


@dataclass(frozen=True, slots=True)
class ExposedKernel:
    """A kernel or detector in the fault space of a setting.

    Attributes:
        instructions: Dynamic instructions per flight hour.
        harm: Increase in the probability of mission failure per fault.
    """

    instructions: float
    harm: Estimate

    def failures(self, upset: float) -> Estimate:
        """Failures per flight hour at an upset probability per instruction; the interval reflects the harm only."""
        return self.harm.times(self.instructions * upset)

    def without_negative_harm(self) -> "ExposedKernel":
        """The kernel as the cause of failures, of which a fault cannot cause fewer than none.

        A difference of two settings is one of harms as measured, which may have either sign.
        """
        return replace(self, harm=self.harm.not_negative())


def total_failures(exposed: Iterable[ExposedKernel], upset: float) -> Estimate:
    """Failures per flight hour, summed over kernels.

    Distances to the bounds are added in quadrature (MOVER; Zou and Donner 2008), since the faults of different kernels
    are drawn independently.
    """
    failures = [kernel.failures(upset) for kernel in exposed]
    value = sum(kernel.value for kernel in failures)
    below = math.hypot(*(kernel.value - kernel.low for kernel in failures))
    above = math.hypot(*(kernel.high - kernel.value for kernel in failures))
    return Estimate(value, value - below, value + above)


# ---- failures per flight hour by setting and kernel, from campaigns with instruction faults ------------------------

INSTRUCTION = "instruction"


def instructions_per_hour(golden: Runs) -> dict[str, float]:
    """Dynamic instructions per flight hour by kernel, from golden runs with instruction counts."""
    counted = [record for record in golden.recorded() if record.counts]
    hours = sum(record.flight_time_s for record in counted) / 3600
    executed: dict[str, float] = {}
    for record in counted:
        for kernel, counts in record.counts.items():
            executed[kernel] = executed.get(kernel, 0.0) + counts["instructions"]
    if hours > 0:
        return {kernel: number / hours for kernel, number in executed.items()}
    return {}


class KernelFaults(NamedTuple):
    """The faults of a campaign in one kernel or detector, and what they cost."""

    run_ids: list[str]
    exposed: ExposedKernel


FaultsBySetting = dict[tuple[str, str], dict[str, KernelFaults]]
"""Faults by (environment, setting), then by kernel."""


def faults_by_setting(runs: Runs, success: str = "success") -> FaultsBySetting:
    """Faults of a campaign in each kernel, by environment and setting; computed once for these runs.

    Harm is measured against the golden run of the same arm and mission.  An upset affects every instruction with the
    same probability, but faults are drawn within missions: they have the weight of the instructions that the golden run
    of their mission executes.  `success` names the column for the success of injected runs: "success" (as flown) or
    "success_if_ended".  Settings without instruction counts and kernels without faults are omitted; faults for which a
    mission executes no instruction are not counted.
    """
    if ("exposed", success) not in runs.memo:
        runs.memo["exposed", success] = _group_faults(runs, success)
    grouped: FaultsBySetting = runs.memo["exposed", success]
    return grouped


def _group_faults(runs: Runs, success: str) -> FaultsBySetting:
    """See `faults_by_setting`."""
    golden_runs = _golden(runs)
    grouped: FaultsBySetting = {}
    injected = runs.injected.where("judged", level=INSTRUCTION)
    for (environment, setting, arm), faults in injected.groups("environment", "setting", "arm").items():
        counts = instructions_per_hour(runs.golden.where(environment=environment, arm=arm))
        for (kernel,), kernel_faults in faults.groups("kernel").items():
            # Only faults that had an instruction to hit, and a flight without them to compare with.
            rows = [row for row in kernel_faults if row["has_site"] and (row["arm"], row["world"]) in golden_runs]
            if not counts.get(kernel) or not rows:
                continue
            # Each fault is compared with the golden run of its mission, with the weight of the mission's instructions.
            worlds = [row["world"] for row in rows]
            golden = [golden_runs[arm, world] for world in worlds]
            weights = _weights(runs, kernel, [row["run_id"] for row in golden], worlds)
            without_fault = [row["success"] for row in golden]
            with_fault = [row[success] for row in rows]
            harm = paired_difference(without_fault, with_fault, worlds, weights)
            kernels = grouped.setdefault((environment, setting), {})
            kernels[kernel] = KernelFaults([row["run_id"] for row in rows], ExposedKernel(counts[kernel], harm))
    return grouped


def _golden(runs: Runs) -> dict[tuple[str, str], dict[str, Any]]:
    """Judged golden runs by arm and world."""
    return {(row["arm"], row["world"]): row for row in runs.golden.where("judged")}


def _weights(runs: Runs, kernel: str, golden: Sequence[str], worlds: Sequence[str]) -> list[float] | None:
    """Weight of each fault: instructions of its golden run / faults of its world; None = these are not counted."""
    faults = Counter(worlds)
    executed = [runs.records[run_id].counts.get(kernel, {}).get("instructions", 0) for run_id in golden]
    weights = [number / faults[world] for number, world in zip(executed, worlds, strict=True)]
    if any(weights):
        return weights
    return None


def payoff(runs: Runs, environment: str, setting: str, upset: float, kernels: Collection[str] = ()) -> Estimate | None:
    """Failures per flight hour under a detector minus those without: of kernels, and of the detector.

    Args:
        runs: A campaign with instruction faults.
        environment: Environment.
        setting: A setting with a detector.
        upset: Upsets per instruction.
        kernels: Only these kernels beside the detector; all if empty.

    Returns:
        Differences in pairs of runs with the same fault; None if no kernel was injected in both settings.
    """
    kernels_of_setting = faults_by_setting(runs).get((environment, setting))
    if kernels_of_setting is None:
        return None
    changes = _changes(runs, environment, setting, kernels)
    if not changes:
        return None
    # What the faults in the setting's own detector cause.
    detectors = _detectors(runs)
    of_detectors = [faults.exposed for kernel, faults in kernels_of_setting.items() if kernel in detectors]
    return total_failures([*changes, *of_detectors], upset)


def _detectors(runs: Runs) -> set[str]:
    """Names of the detectors among the kernels."""
    return {*DETECTORS, *runs.campaign.get("custom_detectors", ())}


def _changes(runs: Runs, environment: str, setting: str, kernels: Collection[str]) -> list[ExposedKernel]:
    """Change of the failures by faults in kernels under a setting, in pairs with the same fault.

    A pair counts if the mission succeeds without a fault in both settings: what a detector loses by false alarms is no
    failure by a fault.  I' h' - I h has two parts: the change of harm, I' (h' - h), and the harm in instructions that
    only the setting executes, (I' - I) h.

    Args:
        runs: A campaign with instruction faults in kernels.
        environment: Environment.
        setting: A setting with a detector.
        kernels: Only these kernels; all if empty.

    Returns:
        The parts of all kernels; instructions are those of the setting's golden runs or, where these were not counted,
        of those without an arm.
    """
    pairs = against_fi(runs).where("judged", "has_site", level=INSTRUCTION, environment=environment, setting=setting)
    golden_runs = _golden(runs)
    golden = runs.golden.where(environment=environment)
    counts = {arm: instructions_per_hour(golden.where(arm=arm)) for arm in ("", *pairs.values("arm"))}
    detectors = _detectors(runs)
    parts_by_kernel: dict[str, list[ExposedKernel]] = {}
    for (kernel, arm), kernel_pairs in pairs.groups("kernel", "arm").items():
        counted_arm = ""
        if counts[arm]:
            counted_arm = arm
        if kernel in detectors or kernel not in counts[counted_arm]:
            continue
        if kernels and kernel not in kernels:
            continue

        # Pairs whose mission succeeds without a fault, with the setting and without an arm.
        successful_worlds = []
        for world in kernel_pairs.values("world"):
            golden_pair = (golden_runs.get(("", world), {}), golden_runs.get((arm, world), {}))
            if all(golden_run.get("success") for golden_run in golden_pair):
                successful_worlds.append(world)
        kernel_pairs = kernel_pairs.where(pl.col("world").is_in(successful_worlds))
        if not len(kernel_pairs):
            continue

        # The two parts of the change, each with the weights of its golden runs.
        with_setting = [golden_runs[counted_arm, world]["run_id"] for world in kernel_pairs["world"]]
        without_arm = [golden_runs["", world]["run_id"] for world in kernel_pairs["world"]]
        executed = counts[counted_arm][kernel]
        executed_without = counts[""].get(kernel, 0.0)
        parts_by_kernel[kernel] = _changed(kernel_pairs, kernel, executed, executed_without, with_setting, without_arm)
    return [part for parts in parts_by_kernel.values() for part in parts]


def _changed(
    pairs: Runs,
    kernel: str,
    executed: float,
    executed_without: float,
    with_setting: Sequence[str],
    without_arm: Sequence[str],
) -> list[ExposedKernel]:
    """The parts of `_changes` of a kernel, from instructions and golden runs with the setting and without an arm."""
    worlds = pairs["world"]
    fault_alone = pairs["fi_success"]
    weights = _weights(pairs, kernel, with_setting, worlds)
    harm_change = paired_difference(fault_alone, pairs["dr_success"], worlds, weights)
    parts = [ExposedKernel(executed, harm_change)]
    # The harm in added instructions; none are known if those without an arm were not counted.
    if executed_without not in (0.0, executed):
        weights = _weights(pairs, kernel, without_arm, worlds)
        harm = paired_difference([True] * len(pairs), fault_alone, worlds, weights)
        parts.append(ExposedKernel(executed - executed_without, harm))
    return parts


def payoffs(runs: Runs, upset: float) -> list[str]:
    """Whether each detector prevents more failures than its own instructions cause, in words."""
    sentences = []
    for environment, setting in faults_by_setting(runs):
        if setting == FI:
            continue
        difference = payoff(runs, environment, setting, upset)
        if difference is None:
            continue
        text = f"{verdict(difference)} over all kernels and its own instructions"
        planner = payoff(runs, environment, setting, upset, tuple(PLANNERS))
        if planner is not None:
            text += f"; {verdict(planner)} over the planner and its own instructions"
        sentences.append(f"does {setting} pay in {environment}? {text}")
    return sentences


def verdict(difference: Estimate) -> str:
    """Whether a difference of failures per flight hour is below zero, and the difference."""
    if difference.high < 0:
        word = "yes"
    elif difference.low > 0:
        word = "no"
    else:
        word = "undecided at this n"
    return f"{word}, {difference.value:+.1e} [{difference.low:+.1e}, {difference.high:+.1e}] failures per flight hour"


def _rows(runs: Runs, upsets: UpsetConfig) -> Iterable[Mapping[str, Any]]:
    """Rows for each kernel of a setting, and one for their sum; `run_id`: the runs behind it."""
    upset = upsets_per_instruction(upsets).value
    grouped = faults_by_setting(runs)
    grouped_if_ended = faults_by_setting(runs, "success_if_ended")
    for (environment, setting), kernels in grouped.items():
        group = {"environment": environment, "setting": setting}
        if_ended = {
            kernel: faults.exposed.without_negative_harm()
            for kernel, faults in grouped_if_ended[environment, setting].items()
        }

        # A row for each kernel.
        for kernel, (run_ids, part) in kernels.items():
            caused = part.without_negative_harm().failures(upset)
            yield {
                **group,
                "kernel": kernel,
                "run_id": run_ids,
                "n": len(run_ids),
                "against": None,
                "instructions": part.instructions,
                "harm": asdict(part.harm),
                "failures": asdict(caused),
                "ended": asdict(if_ended[kernel].failures(upset)),
            }

        # Their sum, against that of faults without a detector.
        parts = [faults.exposed for faults in kernels.values()]
        instructions = sum(part.instructions for part in parts)
        total = _caused(kernels, upset)
        harm = total_failures(parts, 1.0).times(1 / instructions)
        against = None
        if setting != FI and (environment, FI) in grouped:
            alone = _caused(grouped[environment, FI], upset).value
            if alone > 0:
                against = total.value / alone
        run_ids = [run_id for faults in kernels.values() for run_id in faults.run_ids]
        yield {
            **group,
            "kernel": ALL,
            "run_id": run_ids,
            "n": len(run_ids),
            "against": against,
            "instructions": instructions,
            "harm": asdict(harm),
            "failures": asdict(total),
            "ended": asdict(total_failures(if_ended.values(), upset)),
        }


def _caused(kernels: Mapping[str, KernelFaults], upset: float) -> Estimate:
    """Failures per flight hour that faults in kernels cause."""
    return total_failures([part.without_negative_harm() for _, part in kernels.values()], upset)


def _computed(runs: Runs, upsets: UpsetConfig) -> Runs:
    """The rows of the table as runs, with a row for each run behind them."""
    rows = list(_rows(runs, upsets))
    if rows:
        frame = pl.DataFrame(rows, infer_schema_length=None).explode("run_id")
    else:
        frame = runs.frame.clear()
    return replace(runs, frame=frame)


def _estimate(key: str, heading: str) -> Measure:
    """A column of estimates."""
    return Measure(key, heading, ESTIMATE, lambda runs: Estimate(**runs.first(key)))


_DIFFERENCE = (
    "does a setting pay: its failures per flight hour less those of fi, of kernels in pairs with the same fault whose "
    "missions succeed without one in both settings, [95 % interval: MOVER]; the kernel with most instructions decides "
    "the width"
)


def failure_notes(upsets: UpsetConfig, runs: Runs) -> list[str]:
    """Notes on omitted settings, definitions, assumptions and sources of the table."""
    # Whether a detector pays, with the explanation of the test; settings that are left out.
    rate = upsets_per_instruction(upsets)
    verdicts = payoffs(runs, rate.value)
    if verdicts:
        verdicts = [*verdicts, _DIFFERENCE]
    fit = upsets.fit_per_mbit
    altitude = upsets.altitude
    counted = {setting for _, setting in faults_by_setting(runs)}
    left_out = [
        f"{setting}: not in the table, the golden runs of its arm were not counted; needed: its detector (for "
        "recommended: acceptance) in sampling.kernels"
        for setting in runs.injected.where(level=INSTRUCTION).values("setting")
        if setting not in counted
    ]
    return [
        *left_out,
        *verdicts,
        "failures per flight hour = upsets per instruction x dynamic instructions per flight hour (golden runs of the "
        "setting, recomputations and detector included) x harm; [95 % interval of the harm, cut at 0: a fault cannot "
        "cause fewer failures than none]; faults alone, not the failures without a fault",
        "harm: missions lost by the fault against the golden run of the same setting, in pairs, each mission with the "
        "weight of its instructions, [95 % interval: MOVER], n = faults; coverage, 1 – harm, rewards idle instructions "
        "and compares nothing (Schirmeier et al., DSN 2015): compare failures",
        f"upsets {upsets.name}: {rate.value:.1e} per instruction, band {rate.low:.1e} to {rate.high:.1e}, which scales "
        f"all rows alike: {fit.value:g} FIT/Mbit ({fit.low:g} to {fit.high:g}) x {upsets.unprotected_mbit:g} Mbit x "
        f"{upsets.visible:g} visible at {altitude.value:g} m ({altitude.low:g} to {altitude.high:g}), "
        f"{upsets.instructions_per_second:.1e} instructions/s",
        *(f"{key}: {source}" for key, source in upsets.sources.items()),
        "instructions are values that the kernels' LLVM IR writes; kernels that were not injected are not in the sum; "
        "the machine's caches, memories and operating system are not in the fault space",
    ]


_VIEW = View(
    "failures_per_hour",
    "Failures per flight hour by setting and kernel",
    ("environment", "setting", "kernel"),
    (
        _estimate("failures", "failures per flight hour"),
        Measure("against", "against fi", "number .2f ×", lambda runs: runs.first("against"), hidden=True),
        Measure("instructions", "instructions/h", "number .2e", lambda runs: runs.first("instructions")),
        Measure("n", "faults", NUMBER, lambda runs: runs.first("n")),
        Measure("harm", "harm (points)", POINTS, lambda runs: Rate(runs.first("n"), *runs.first("harm").values())),
        _estimate("ended", "failures, dead node ends mission"),
    ),
    where=lambda runs: _computed(runs, find_upsets()),
    notes=lambda runs: failure_notes(find_upsets(), runs),
    applies=lambda runs: has(runs.injected, level=INSTRUCTION),
)
CHAPTER = Chapter(50, (_VIEW,))


def failure_table(runs: Runs, upsets: UpsetConfig) -> Table:
    """The view as a table, computed with the given upset rates."""
    view = replace(_VIEW, where=lambda runs: _computed(runs, upsets), notes=lambda runs: failure_notes(upsets, runs))
    return view.table(runs)


def summary(runs: Runs, upsets: UpsetConfig) -> list[str]:
    """Failures per flight hour of each setting, one sentence per environment, and whether its detector pays."""
    upset = upsets_per_instruction(upsets).value
    rates_by_environment: dict[str, list[str]] = {}
    for (environment, setting), kernels in faults_by_setting(runs).items():
        total = _caused(kernels, upset)
        rates_by_environment.setdefault(environment, []).append(f"{setting} {cell(total, ESTIMATE)}")
    rates = [
        f"Failures per flight hour, {environment}: {'; '.join(texts)}."
        for environment, texts in rates_by_environment.items()
    ]
    return [*rates, *(f"{text[0].upper()}{text[1:]}." for text in payoffs(runs, upset))]
