"""Findings: up to five sentences that summarize a campaign, computed from its runs."""

from collections.abc import Callable
from typing import NamedTuple

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.rows import CHANGED, KERNEL_DUE, SILENT
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.campaign.plan import FI, GOLDEN

MAX_SENTENCES = 5


def findings(runs: Runs) -> list[str]:
    """Compute up to `MAX_SENTENCES` sentences; those that do not apply are omitted."""
    sentences = [sentence for compute in _SENTENCES for sentence in compute(runs)]
    return sentences[:MAX_SENTENCES]


class ComparedMissions(NamedTuple):
    """Missions whose success is the headline: judged ones without a fault, and with one in the leading bits."""

    golden: Runs
    faulty: Runs


def compared_missions(runs: Runs) -> ComparedMissions:
    """Missions without a detector, without a fault and with one; both are empty if the runs are no flights."""
    flown = runs
    if not runs.has_missions:
        flown = runs.where(pl.lit(value=False))
    return ComparedMissions(flown.golden.where("judged", setting=GOLDEN), m.leading_faults(flown).where(setting=FI))


def pairs_by_arm(runs: Runs) -> dict[str, Runs]:
    """Pairs of missions with the same fault, without a detector and with one (`measures.against_fi`), by arm."""
    paired = m.against_fi(runs)
    if not len(paired) or not runs.has_missions:
        return {}
    leading = m.leading_populations(runs)
    arms = runs.campaign.get("arms", {})
    # in protected code the same instruction of the draw is another one: what comes back is not brought back by it
    protected = [name for name, arm in arms.items() if arm["mission"].get("protection")]
    compared = paired.where(~pl.col("arm").is_in(protected), pl.col("population").is_in(leading))
    return {pairs.first("arm") or setting: pairs for (setting,), pairs in compared.groups("setting").items()}


def _bits(runs: Runs) -> str:
    """The bits that faults are in, in brackets; empty for all bits of a word."""
    text = m.population_text(runs.values("population"))
    if not text:
        return ""
    return f" ({text} bits)"


def _with_n(rate: Rate) -> str:
    """A rate and its interval in per cent, with the number of runs."""
    return f"{rate.percent or 'unknown'} (n = {rate.n})"


# ---- the sentences: each function returns one, or none if it does not apply ------------------------------------------
def _success(runs: Runs) -> list[str]:
    """Success with and without a fault."""
    golden, faulty = compared_missions(runs)
    if not len(golden) or not len(faulty):
        return []
    without_fault = m.rate_of(golden, "success")
    with_fault = m.rate_of(faulty, "success")
    test = m.against_golden(faulty.where(pl.col("golden_success").is_not_null()))
    return [
        f"Without a fault {_with_n(without_fault)} of missions succeed, with {runs.per_mission}{_bits(faulty)} "
        f"{_with_n(with_fault)}: the fault loses {test.first_only} of {test.n} missions and saves {test.second_only} "
        f"(p = {test.p_value:.2g}, McNemar's test on whole missions: the faults of one count together)."
    ]


def _deaths(runs: Runs) -> list[str]:
    """Faults that kill their kernel, and what that would cost without restarts."""
    faulty = m.leading_faults(runs).where(setting=FI)
    deadly = faulty.where(pl.col("kernel_effect").is_in(KERNEL_DUE), pl.col("kernel") != "")
    if not len(deadly) or not runs.has_missions:
        return []
    if_ended = m.rate_of(faulty, "success_if_ended")
    return [
        f"{len(deadly)} of {len(faulty)} faults{_bits(faulty)} kill their kernel; if a dead node ended the mission, "
        f"{_with_n(if_ended)} would succeed."
    ]


def _effects(runs: Runs) -> list[str]:
    """Effects of faults on the flight, or on the output of a program."""
    faulty = m.leading_faults(runs).where(pl.col("effect") != "unknown", setting=FI)
    if not len(faulty):
        return []
    result = "output"
    if runs.has_missions:
        result = "flight"
    masked = m.rate_of(faulty, pl.col("effect") == "masked")
    others = {
        "change it silently": SILENT,
        "change it after a failure that is noticed (a kernel dies, a sensor gives no data)": CHANGED,
        "are detected by protected code": pl.col("effect") == "detected",
        "end it by a crash or a hang": pl.col("effect").is_in(KERNEL_DUE),
        "do not reach their site": pl.col("effect") == "not_activated",
    }
    rates = {words: m.rate_of(faulty, test) for words, test in others.items()}
    rest = "".join(f", {rate.percent} {words}" for words, rate in rates.items() if rate.successes)
    return [f"{masked.percent} of {len(faulty)} faults{_bits(faulty)} leave the {result} as it was, bit for bit{rest}."]


def _worst_stage(runs: Runs) -> list[str]:
    """Stages by the harm that their faults do."""
    faulty = m.leading_faults(runs).where(setting=FI)
    rates = {stage: m.rate_of(part, m.FAILS_OR_SLOWER) for (stage,), part in faulty.groups("stage").items() if stage}
    if len(rates) < 2:
        return []
    ordered = sorted(rates.items(), key=lambda item: -(item[1].rate or 0.0))
    stages = "; ".join(f"{stage} {_with_n(rate)}" for stage, rate in ordered)
    return [f"Missions that fail or take more than 5 % longer, by stage of the fault{_bits(faulty)}: {stages}."]


def _recovery(runs: Runs) -> list[str]:
    """Missions that each detector with its recovery brings back, and newly loses; other arms: `_other_missions`."""
    parts = []
    for arm, pairs in pairs_by_arm(runs).items():
        if not pairs.first("detector"):
            continue
        regained = 0
        lost = 0
        recovery = m.recovery_of(pairs)
        if recovery is not None:
            regained = recovery.regained
            lost = recovery.lost
        parts.append(
            f"{arm} brings back {regained} of {lost} lost missions and newly loses {m.discordant(pairs).first_only}"
        )
    if not parts:
        return []
    return [f"{'; '.join(parts)}{_bits(m.leading_faults(runs))}."]


def _other_missions(runs: Runs) -> list[str]:
    """The verdict on each arm without a detector, e.g. with another planner, on the same missions and faults."""
    sentences = []
    for arm, pairs in pairs_by_arm(runs).items():
        if pairs.first("detector"):
            continue
        # The name of the arm, with the keys in which its mission differs.
        keys = runs.campaign.get("arms", {}).get(arm, {}).get("mission", {})
        name = arm
        if keys:
            name = f"{arm} ({', '.join(f'{key} {value}' for key, value in keys.items())})"
        # The same missions without a fault, then with the same faults.
        golden = runs.golden.where("judged")
        golden_rates = [m.rate_of(golden.where(arm=which), "success") for which in (arm, "")]
        test = m.discordant(pairs)
        there = m.rate_of(pairs, "dr_success").percent
        here = _with_n(m.rate_of(pairs, "fi_success"))
        sentences.append(
            f"On the same missions and faults{_bits(pairs)}, {name} succeeds in {there}, the campaign's own mission in "
            f"{here}; without a fault in {golden_rates[0].percent} and {_with_n(golden_rates[1])}. {arm} saves "
            f"{test.second_only} that are lost without it and loses {test.first_only} (p = {test.p_value:.2g}, "
            "McNemar's test on whole missions)."
        )
    return sentences


def _false_alarms(runs: Runs) -> list[str]:
    """Alarms of each detector on golden runs."""
    watched = runs.golden.where(pl.col("detector") != "", end="flown")
    rates = {arm: m.alarm_rate(flights) for (arm,), flights in watched.groups("arm").items()}
    by_arm = "; ".join(
        f"{arm} {rate.per_hour:.1f} per hour [{rate.low:.1f}, {rate.high:.1f}] ({rate.events} in {rate.hours:.2g} h)"
        for arm, rate in rates.items()
        if rate.per_hour is not None
    )
    if not by_arm:
        return []
    return [f"Alarms on flights without a fault: {by_arm}."]


def _flight_time(runs: Runs) -> list[str]:
    """Flight times of successful missions with a fault."""
    successes = m.leading_faults(runs).where("success", pl.col("inflation").is_not_null(), setting=FI)
    if not len(successes):
        return []
    median, worst = (m.quantile_of(successes["inflation"], share) or 0.0 for share in (0.5, 1.0))
    return [
        f"Of the missions that succeed with a fault{_bits(successes)} (n = {len(successes)}), the median takes "
        f"{100 * median:+z.1f} % flight time, the worst {100 * worst:+z.1f} % ({m.worst_run(successes)})."
    ]


_SENTENCES: tuple[Callable[[Runs], list[str]], ...] = (
    _success,
    _deaths,
    _effects,
    _other_missions,
    _recovery,
    _worst_stage,
    _false_alarms,
    _flight_time,
)
