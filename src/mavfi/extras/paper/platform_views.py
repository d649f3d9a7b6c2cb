"""Fig. 9 of the paper and its table: the same missions on different computing platforms."""

import operator
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis import published as paper
from mavfi.analysis.flight_views import ONE_FAULT, of_missions
from mavfi.analysis.measures import Measure
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import PERCENT, PERCENT_TEST, TIMES_TEST
from mavfi.analysis.views import View
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.extras.paper.worlds import CONTRAST, contrast_measure
from mavfi.plugins import Chapter

_SECONDS, _KJ, _RATIO = "number .1f s", "number .1f kJ", "number .2f ×"


def platforms(runs: Runs) -> dict[str, str]:
    """Platform by environment, in order, for a campaign whose parts are distinct platforms; empty for others."""
    parts = runs.campaign.get("parts", {})
    found = {name: part["platform"] for name, part in parts.items() if part.get("platform")}
    return found if len(found) > 1 and len(set(found.values())) == len(found) else {}


def compared(runs: Runs) -> Runs:
    """Successful runs, without golden runs of detector arms, which differ from the bare ones by false alarms only."""
    own = of_missions(runs).where("judged", "success")
    return own.where(pl.col("setting").is_in([GOLDEN, *runs.settings()]))


def _worst(own: Runs) -> float:
    found: Any = own.frame["flight_time_s"].max()
    return float(found)


def _median(own: Runs) -> float | None:
    found: Any = own.frame["flight_time_s"].median()
    return None if found is None else float(found)


def _power(own: Runs) -> float | None:
    """Mean power (W): total energy / total flight time."""
    seconds = sum(own["flight_time_s"])
    return sum(own["energy_j"]) / seconds if seconds else None


def _papers_platform(quantity: str, setting: str = GOLDEN) -> Callable[[Runs], Any]:
    """A value of the paper's table, shown in the rows of one setting."""

    def of(own: Runs) -> Any:
        if own.first("setting") != setting or not paper.comparable(own.campaign, ""):
            return None
        return paper.figure("platforms", quantity=quantity, platform=_platform(own))

    return of


def _platform(own: Runs) -> str:
    return platforms(own).get(own.first("environment"), "")


def _papers_power(own: Runs) -> float | None:
    time, energy = _papers_platform("flight_time_s")(own), _papers_platform("energy_kj")(own)
    return 1000 * energy / time if time and energy else None


def _against_first(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Columns computed across groups: ratios to the first platform, and the recovered share of worst flight time."""
    del by
    groups = runs.groups("environment", "setting")
    first = next(iter(platforms(runs)), "")

    def on_both(own: Runs) -> tuple[Runs, ...]:
        base = groups.get((first, own.first("setting")))
        return () if base is None or own.first("environment") == first else (own, base)

    def ratio(key: str, heading: str, column: str, share: float) -> Measure:
        return contrast_measure(key, heading, TIMES_TEST, on_both, column, share, operator.truediv, by="seed")

    def papers_ratio(own: Runs) -> float | None:
        slow = own.first("environment") != first and own.first("setting") == FI
        found: float = paper.figure("platforms_worst", quantity="flight_time_ratio")
        return found if slow and paper.comparable(own.campaign, "") else None

    def recoverable(own: Runs) -> tuple[Runs, ...]:
        golden, faulty = (groups.get((own.first("environment"), setting)) for setting in (GOLDEN, FI))
        if golden is None or faulty is None or own.first("setting") in (GOLDEN, FI):
            return ()
        return (faulty, own, golden) if _worst(faulty) > _worst(golden) else ()

    def papers_recovery(own: Runs) -> float | None:
        slow = own.first("environment") != first and paper.comparable(own.campaign, own.first("detector_profile"))
        return paper.figure("platforms_recovered", setting=own.first("setting")) if slow else None

    yield ratio("median_ratio", "median ratio", "flight_time_s", 0.5)
    yield ratio("energy_ratio", "of energy", "energy_j", 0.5)
    yield ratio("worst_ratio", "worst ratio", "flight_time_s", 1.0)
    yield Measure("paper_ratio", "paper", _RATIO, papers_ratio)
    yield contrast_measure(
        "recovered", "recovered", PERCENT_TEST, recoverable, "flight_time_s", 1.0,
        lambda fi, dr, golden: np.where(fi > golden, (fi - dr) / (fi - golden), 0.0),  # of a sample without a worse one
    )  # fmt: skip
    yield Measure("paper_recovered", "paper", PERCENT, papers_recovery)


def _explanation(runs: Runs) -> list[str]:
    """Notes that compare the paper's ratio of flight times with that of the campaign."""
    golden = {name: own for (name,), own in compared(runs).where(setting=GOLDEN).groups("environment").items()}
    times = [_median(golden[name]) for name in platforms(runs) if name in golden]
    ours = times[-1] / times[0] if len(times) > 1 and times[0] and times[-1] else None
    held = {
        quantity: [paper.figure("platforms", quantity=quantity, platform=name) for name in ("i9-9940x", "cortex-a57")]
        for quantity in ("flight_time_s", "energy_kj")
    }
    fast, slow = held["flight_time_s"]
    watts = [1000 * energy / time for energy, time in zip(held["energy_kj"], (fast, slow), strict=True)]
    lines = [
        f"the paper's {slow} s / {fast} s = {slow / fast:.1f} is what its text says of the worst flight times, so its "
        "table may hold worst cases; which flights, course and environment is not said",
        "the published tracker advances its reference by 10 ms per loop and needs 26 ms per loop on the TX2, so "
        "flights there take up to 2.6 times as long; latencies of perception and planning add to that where it waits",
        f"the paper's energy / flight time is {watts[0]:.0f} W and {watts[1]:.0f} W, little more than the constant of "
        "the power model: its energies follow from its times",
    ]
    if ours is None:
        return lines
    flown = compared(runs).where(setting=GOLDEN)
    course, distance = (m.quantile_of(flown[name], 0.5) or 0.0 for name in ("course_m", "distance_m"))
    return [
        f"ours: golden flights take {ours:.2f} times as long (medians), over a course of {course:.0f} m and "
        f"{distance:.0f} m of path",
        *lines,
    ]


PLATFORMS = Chapter(90, (
    View(
        "platforms", "Computing platforms (Fig. 9): flights that succeed", ("environment", "setting"),
        (
            m.count("n", "flights"),
            Measure("median_s", "median time", _SECONDS, _median), Measure("worst_s", "worst time", _SECONDS, _worst),
            Measure("paper_s", "paper", _SECONDS, _papers_platform("flight_time_s")),
            m.median("energy_j", "median energy", _KJ),
            Measure("paper_kj", "paper", _KJ, lambda own: _kilo(_papers_platform("energy_kj")(own))),
            Measure("power_w", "power", "number .0f W", _power),
            Measure("paper_w", "paper", "number .0f W", _papers_power), _against_first,
            Measure(
                "paper_processor", "paper: processor", "text", lambda own: _watts(_papers_platform("power_w")(own))
            ),
        ),
        where=compared, headings=("platform", "setting"),
        notes=lambda runs: (
            "recovered: of the worst flight time with a fault beyond the worst golden one, the share that the detector "
            "takes away; ratios: to the same setting on the first platform",
            f"{CONTRAST} (platforms of a ratio, detector and none of recovered); of a worst case the interval is too "
            "narrow, since no sample is worse than the flown ones", *_explanation(runs),
            "latencies are modelled; power is that of the rotors, the processor's is not in it", ONE_FAULT,
        ), applies=lambda runs: bool(platforms(runs)),
    ),
))  # fmt: skip


def _kilo(kilojoule: float | None) -> float | None:
    return None if kilojoule is None else 1000 * kilojoule


def _watts(text: str | None) -> str | None:
    return None if text is None else f"{text} W"
