"""Findings: up to five sentences that summarize a campaign, computed from its runs."""

from collections.abc import Callable

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.rows import KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.campaign.plan import FI, GOLDEN

MOST = 5


def findings(runs: Runs) -> list[str]:
    """Compute up to `MOST` sentences; those that do not apply are omitted."""
    found = [line for say in _SENTENCES for line in say(runs)]
    return found[:MOST]


def _bits(own: Runs) -> str:
    text = m.population_text(own.values("population"))
    if text:
        return f" ({text} bits)"
    return ""


def _percent(rate: Rate) -> str:
    if rate.rate is None or rate.low is None or rate.high is None:
        return "unknown"
    return f"{100 * rate.rate:.1f} % [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


def _with_n(rate: Rate) -> str:
    return f"{_percent(rate)} (n = {rate.n})"


def _success(runs: Runs) -> list[str]:
    golden = runs.golden.where("judged", setting=GOLDEN)
    faulty = m.leading_faults(runs).where(setting=FI)
    if not runs.has_missions or not len(golden) or not len(faulty):
        return []
    without = m.rate_of(golden, "success")
    with_fault = m.rate_of(faulty, "success")
    known = faulty.where(pl.col("golden_success").is_not_null())
    test = m.against_golden(known)
    return [
        f"Without a fault {_with_n(without)} of missions succeed, with one fault{_bits(faulty)} "
        f"{_with_n(with_fault)}: the fault loses {test.first_only} of {test.n} missions and saves {test.second_only} "
        f"(McNemar p = {test.p_value:.2g})."
    ]


def _deaths(runs: Runs) -> list[str]:
    own = runs.injected.where("judged", pl.col("kernel_effect").is_in(KERNEL_DUE), pl.col("kernel") != "", setting=FI)
    faulty = runs.injected.where("judged", setting=FI)
    if not len(own) or not runs.has_missions:
        return []
    ended = m.rate_of(faulty, "success_if_ended")
    return [
        f"{len(own)} of {len(faulty)} faults kill their kernel; if a dead node ended the mission, {_with_n(ended)} "
        "would succeed."
    ]


def _effects(runs: Runs) -> list[str]:
    own = runs.injected.where("judged", pl.col("effect") != "unknown", setting=FI)
    if not len(own):
        return []
    masked, silent, *others = (
        m.rate_of(own, pl.col("effect").is_in(names))
        for names in (("masked",), ("sdc",), ("detected",), KERNEL_DUE, ("not_activated",))
    )
    what = "are detected by protected code", "end in a crash or a hang", "do not reach their site"
    rest = "".join(f", {_percent(rate)} {words}" for rate, words in zip(others, what, strict=True) if rate.successes)
    result = "flight" if runs.has_missions else "output"
    return [
        f"{_percent(masked)} of {len(own)} faults leave the {result} as it was, bit for bit, "
        f"{_percent(silent)} change it silently{rest}."
    ]


def _worst_stage(runs: Runs) -> list[str]:
    own = m.leading_faults(runs).where(setting=FI)
    rates = {stage: m.rate_of(part, m.FAILS_OR_SLOWER) for (stage,), part in own.groups("stage").items() if stage}
    if len(rates) < 2:
        return []
    ordered = sorted(rates.items(), key=lambda item: -(item[1].rate or 0.0))
    stages = "; ".join(f"{stage} {_with_n(rate)}" for stage, rate in ordered)
    return [f"Missions that fail or take more than 5 % longer, by stage of the fault{_bits(own)}: {stages}."]


def _recovery(runs: Runs) -> list[str]:
    paired = m.against_fi(runs)
    if not len(paired):
        return []
    leads = m.leads(m.population_names(runs.injected, ()))
    parts = []
    arms = runs.campaign.get("arms", {})
    # in protected code the same instruction of the draw is another one: what comes back is not brought back by it
    protected = [name for name, arm in arms.items() if arm["mission"].get("protection")]
    paired = paired.where(~pl.col("arm").is_in(protected))
    for (setting,), own in paired.where(pl.col("population").is_in(leads)).groups("setting").items():
        test = m.discordant(own)
        found = m.recovery_of(own)
        if found is None:
            back = 0
            lost = 0
        else:
            back = found.regained
            lost = found.lost
        parts.append(
            f"{own.first('arm') or setting} brings back {back} of {lost} lost missions and newly loses "
            f"{test.first_only}"
        )
    if parts:
        return [f"{'; '.join(parts)}."]
    return []


def _false_alarms(runs: Runs) -> list[str]:
    own = runs.golden.where(pl.col("detector") != "", end="flown")
    rates = {arm: m.alarm_rate(part) for (arm,), part in own.groups("arm").items()}
    by_arm = "; ".join(
        f"{arm} {rate.per_hour:.1f} per hour [{rate.low:.1f}, {rate.high:.1f}] ({rate.events} in {rate.hours:.2g} h)"
        for arm, rate in rates.items()
        if rate.per_hour is not None
    )
    if by_arm:
        return [f"Alarms on flights without a fault: {by_arm}."]
    return []


def _flight_time(runs: Runs) -> list[str]:
    own = runs.injected.where("judged", "success", pl.col("inflation").is_not_null(), setting=FI)
    if not len(own):
        return []
    median, worst = (m.quantile_of(own["inflation"], share) or 0.0 for share in (0.5, 1.0))
    return [
        f"Of the missions that succeed with a fault (n = {len(own)}), the median takes {100 * median:+z.1f} % flight "
        f"time, the worst {100 * worst:+z.1f} % ({m.worst_run(own)})."
    ]


_SENTENCES: tuple[Callable[[Runs], list[str]], ...] = (
    _success,
    _deaths,
    _effects,
    _recovery,
    _worst_stage,
    _false_alarms,
    _flight_time,
)
