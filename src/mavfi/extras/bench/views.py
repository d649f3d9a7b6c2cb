"""Views that compare schemes (detectors with recovery, policies for dead nodes) on the same flights and faults."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.flight_views import INSTRUCTION, MEMORY, ONE_FAULT, SENSOR, STATE
from mavfi.analysis.measures import Measure
from mavfi.analysis.rows import KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Paired, mcnemar
from mavfi.analysis.table import NUMBER, PER_HOUR, SMALL
from mavfi.analysis.views import View, has
from mavfi.campaign.plan import FI
from mavfi.plugins import Chapter

PAIR = "pair"
"""Kind of a row that joins the runs of a fault in `fi` and in an arm; columns of the arm have the prefix `dr_`."""
_SEPARATOR = ", "
LOST = (pl.col("kind") == PAIR) & pl.col("golden_success") & ~pl.col("success")
"""Pairs in which the fault loses the mission in `fi`."""
LATE = (pl.col("kind") == PAIR) & (pl.col("inflation") > m.SLOWER).fill_null(value=False)
RANKED = (("autoencoder", "gaussian"), ("autoencoder tuned", "gaussian tuned"))
"""Arms of benches that differ in their detector alone."""
VEHICLE_LOST = ("collision", "fly_away", "invalid_state")
"""Statuses after which there is no vehicle; a mission that fails otherwise ends in the air."""
_CRASHED = LOST & pl.col("status").is_in(VEHICLE_LOST)
DIED = pl.col("kernel_effect").is_in(KERNEL_DUE)
_SAVED = ~pl.col("dr_status").is_in(VEHICLE_LOST)
_SAME_VALUE = pl.col("time_s").eq_missing(pl.col("dr_time_s")) & pl.col("before").eq_missing(pl.col("dr_before"))
"""Pairs in which the flip meets the same value at the same instant."""
_IN_TIME = pl.col("dr_success") & (pl.col("dr_inflation") <= m.SLOWER).fill_null(value=False)


def against_base(runs: Runs) -> Runs:
    """Pairs of all arms, and the arms' golden runs with `bare_success`, the success of the golden run without arm."""
    pairs = m.against_fi(runs)
    bare = runs.golden.where(arm="").frame.select("world", bare_success="success")
    golden = runs.golden.where(pl.col("arm") != "").frame.join(bare, on="world", how="left", maintain_order="left")
    frames = [pairs.frame.rename({"fi_success": "success"}).with_columns(kind=pl.lit(PAIR)), golden]
    return replace(runs, frame=pl.concat(frames, how="diagonal"))


def pairs_only(runs: Runs) -> Runs:
    """As `against_base`, without golden runs."""
    return against_base(runs).where(kind=PAIR)


def by_duration(runs: Runs) -> Runs:
    """As `pairs_only`, with the `duration` of the fault: what follows the comma in the name of its group.

    It is that of the group, not of the fault: a burst in a flag has one bit, but belongs with the other bursts.
    """
    return pairs_only(runs).adding(duration=pl.col("target").str.split(_SEPARATOR).list.last())


def _has_durations(runs: Runs) -> bool:
    """Whether the groups of a campaign are named "fields, duration"."""
    names = runs.injected.values("target")
    return _schemes_on(runs, STATE) and all(name.count(_SEPARATOR) == 1 for name in names)


def _schemes_on(runs: Runs, level: str) -> bool:
    """Whether arms are compared on faults of a level, which are flown without an arm, too."""
    return has(runs.injected, level=level, setting=FI) and len(runs.settings()) > 1


def _only_the_scheme(runs: Runs) -> int:
    """Missions, with and without a fault, that fail under the scheme only."""
    pairs = runs.where(pl.col("kind") == PAIR, "golden_success", "success", ~pl.col("dr_success"))
    return len(pairs) + len(runs.golden.where("bare_success", ~pl.col("success")))


def _golden(runs: Runs) -> Runs:
    """Golden flights."""
    return runs.golden.where(end="flown")


def _lost_by(test: pl.Expr | str, key: str, heading: str, *where: pl.Expr) -> Measure:
    return m.rate(key, heading, test, LOST, *where)


def _mcnemar(runs: Runs) -> Paired:
    """Missions with the fault, without and with the scheme."""
    pairs = runs.where(kind=PAIR)
    return mcnemar(pairs["success"], pairs["dr_success"], pairs["world"])


def _ranking(runs: Runs) -> list[str]:
    """Notes with paired tests of the paper's ranking: its AAD against its GAD."""
    arms = {str(arm): of_arm.frame for (arm,), of_arm in pairs_only(runs).groups("arm").items()}
    notes = []
    for first, second in RANKED:
        if first in arms and second in arms:
            other = arms[second].select("world", "target", "index", second=pl.col("dr_success"))
            both = arms[first].join(other, on=["world", "target", "index"])
            test = mcnemar(both["dr_success"].to_list(), both["second"].to_list(), both["world"].to_list())
            notes.append(
                f"{first} against {second}: missions that only one of them flies to the end {test.first_only} : "
                f"{test.second_only} of {test.n}, p = {test.p_value:.2g}"
            )
    return notes


_COUNTED = (
    m.count("pairs", "faults", kind=PAIR),
    m.count("lost", "lost", LOST),
    _lost_by("dr_success", "back", "brought back"),
)
_P = Measure("p", "p", "number .2g", lambda runs: _mcnemar(runs).p_value)
_TESTED = (*_COUNTED, _P)
_BACK_MONITORED = _lost_by("dr_success", "back_monitored", "of monitored", pl.col("monitored"))
_TESTED_CALLS = (
    *_COUNTED[:2],
    _lost_by("dr_success", "back", "brought back", _SAME_VALUE),
    replace(_P, of=lambda runs: _mcnemar(runs.where(_SAME_VALUE)).p_value),
    _lost_by("dr_success", "died_back", "died, back", _SAME_VALUE, DIED),
    _lost_by("dr_success", "sdc_back", "sdc, back", _SAME_VALUE, ~DIED),
)
_LOST_UNDER = Measure(
    "lost_under",
    "lost under it",
    NUMBER,
    lambda runs: len(runs.where(pl.col("kind") == PAIR, "golden_success", ~pl.col("dr_success"))),
)
_IN_TIME_AGAIN = m.rate("late_in_time", "late, in time", _IN_TIME, LATE)
_HARM = (_LOST_UNDER, Measure("newly_lost", "only it lost", NUMBER, _only_the_scheme), _IN_TIME_AGAIN)
_HARM_OF_CALLS = (
    _LOST_UNDER,
    m.count("same_value", "same value injected", pl.col("kind") == PAIR, _SAME_VALUE),
    # a pair in which the flip meets another value is left out: its harm is not the scheme's
    Measure(
        "newly_lost",
        "of these, only it lost",
        NUMBER,
        lambda runs: _only_the_scheme(runs.where((pl.col("kind") != PAIR) | _SAME_VALUE)),
    ),
    _IN_TIME_AGAIN,
)
_DETECTED = _lost_by("dr_detected", "detected", "detected")
_ALARM_AFTER = Measure(
    "alarm_after", "alarm after", "number .2f s", lambda runs: runs.where(LOST).frame["dr_alarm_after_s"].median()
)
_ALARMS = (
    Measure("per_hour", "false alarms", PER_HOUR, lambda runs: m.alarm_rate(_golden(runs))),
    Measure("hours", "exposure", "number .2f h", lambda runs: sum(_golden(runs)["flight_time_s"]) / 3600),
    Measure("recomputed", "recomputation", SMALL, lambda runs: m.recomputed(_golden(runs))),
)
_LOST_NOTE = (
    "lost: missions that succeed without the fault and fail with it; brought back: of these, those that succeed under "
    "the scheme; [95 % interval: Wilson, n reduced by the design effect of worlds], n"
)
_HARM_NOTE = (
    "lost under it: missions that fail with the fault and the scheme; only it lost: missions{} that fail only under "
    "the scheme; late, in time: of missions that succeed > 5 % later with the fault, those that are at most 5 % late "
    "under the scheme"
)
_TEST_NOTE = f"p: {m.PAIRED_TEST}; missions with the fault that succeed with and without the scheme"
_NOTES_OF_PAIRS = (_LOST_NOTE, _HARM_NOTE.format(" with the fault"), ONE_FAULT)
_NOTES_OF_SCHEMES = (
    _LOST_NOTE,
    _HARM_NOTE.format(", golden ones included,"),
    "false alarms: per hour of golden flight; recomputation: its modelled time / compute time, golden flights",
)
_AFTER_NOTE = (
    "alarm after: median time from the fault to the first alarm that the golden flight lacks, in missions that the "
    "fault loses; 0 inline where the corrupted publication itself raises it"
)
_NOTES = (*_NOTES_OF_SCHEMES[:1], _TEST_NOTE, *_NOTES_OF_SCHEMES[1:], _AFTER_NOTE)


def _schemes(
    level: str,
    name: str,
    title: str,
    measures: tuple[Measure | m.MeasureFactory, ...],
    notes: Sequence[str | Callable[[Runs], list[str]]],
) -> View:
    """A table with one row per scheme, for faults of one level; a note may be computed from the runs."""

    def notes_on(runs: Runs) -> Iterable[str]:
        for note in notes:
            if isinstance(note, str):
                yield note
            else:
                yield from note(runs)
        yield ONE_FAULT

    return View(
        name,
        title,
        ("arm",),
        measures,
        where=against_base,
        headings=("scheme",),
        notes=notes_on,
        applies=lambda runs: _schemes_on(runs, level),
        by_name=True,
    )


_OF_STATES = _schemes(
    STATE,
    "schemes",
    "Schemes on the same faults in states",
    (*_COUNTED, _BACK_MONITORED, _P, *_HARM, _DETECTED, _ALARM_AFTER, *_ALARMS),
    (
        *_NOTES,
        "of monitored: brought back of those lost to a fault in a field that the paper's detectors monitor",
        "detected: of the lost ones, alarm on the corrupted publication",
        _ranking,
    ),
)
_OF_MEMORY = _schemes(
    MEMORY,
    "schemes_memory",
    "Schemes on the same faults in memory",
    (*_TESTED, *_HARM, _ALARM_AFTER, *_ALARMS),
    (*_NOTES, _ranking),
)
_OF_SENSORS = _schemes(
    SENSOR,
    "schemes_sensor",
    "Schemes on the same failures of sensors and motors",
    (*_COUNTED, *_HARM, *_ALARMS),
    (
        *_NOTES_OF_SCHEMES,
        "a failure lasts from its instant to the end of the flight: every message then carries what the "
        "device gave, and its checksum and its copy agree with it",
    ),
)
_OF_INSTRUCTIONS = _schemes(
    INSTRUCTION,
    "schemes_instructions",
    "Schemes on the same faults in instructions",
    (*_TESTED_CALLS, *_HARM_OF_CALLS, _ALARM_AFTER, *_ALARMS),
    (
        *_NOTES,
        _ranking,
        "died / sdc: the kernel died of the fault, or continued with a wrong value",
        "a fault names its call and value by number; if a scheme changes the flight, by false alarms or "
        "latencies (duplicate), that call computes something else, which may be harmless. Same value injected: "
        "faults that meet the same value at the same instant; brought back, p and only it lost count these "
        "alone, and golden flights. Lost under it counts all",
    ),
)
_BY_TARGET = View(
    "schemes_by_target",
    "Schemes, by injected site",
    ("target", "arm"),
    (*_COUNTED, *_HARM),
    where=pairs_only,
    headings=("site", "scheme"),
    notes=lambda _: _NOTES_OF_PAIRS,
    applies=lambda runs: has(runs.injected, setting=FI) and len(runs.settings()) > 1,
    by_name=True,
)
_BY_DURATION = View(
    "schemes_by_duration",
    "Schemes, by duration and width of the fault",
    ("duration", "arm"),
    (*_COUNTED, m.rate("vehicle_saved", "vehicle saved", _SAVED, _CRASHED), *_HARM),
    where=by_duration,
    headings=("fault", "scheme"),
    notes=lambda _: (
        *_NOTES_OF_PAIRS,
        "vehicle saved: of lost missions that end in a collision or beyond the arena, those that "
        "do not under the scheme: they succeed, or end in the air",
    ),
    applies=_has_durations,
    by_name=True,
)

CHAPTER = Chapter(110, (_OF_STATES, _OF_MEMORY, _OF_SENSORS, _OF_INSTRUCTIONS, _BY_TARGET, _BY_DURATION))
