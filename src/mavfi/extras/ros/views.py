"""Views of a ROS 2 stack: what faults in its messages and registers do."""

from collections.abc import Iterable

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.effects import ALARMED, HEADINGS, has_verdicts
from mavfi.analysis.measures import Measure
from mavfi.analysis.runs import Runs
from mavfi.analysis.views import View, has
from mavfi.campaign.plan import FI
from mavfi.plugins import Chapter

HOST = "ros2_stack"
_EFFECTS = ("masked", "sdc", "crash", "hang")
_INTERVALS = (
    "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds], count; a crash or a hang is a "
    "detected error (DUE)"
)
_REPEAT = (
    "the instant of an injection is the machine's, not the seed's: a run cannot be repeated bit for bit, and the "
    "digest is that of this ledger"
)
_JUDGED = pl.col("effect") != "unknown"
_FAULTS = (pl.col("kind") == "injected") & _JUDGED
_GOLDEN = pl.col("kind") == "golden"


def _of_messages(runs: Runs) -> bool:
    return runs.campaign.get("host") == HOST and has(runs.injected, level="message")


def _of_registers(runs: Runs) -> bool:
    return has(runs.injected, level="register", kernel="")


def _messages(runs: Runs) -> Runs:
    """Runs with a fault in a message; its field without indices, its operation without the number of the bit."""
    return runs.injected.where(level="message", setting=FI).adding(
        topic=pl.col("state"),
        field=pl.col("field").str.replace_all(r"\[\d+\]", "[]").replace("", "message"),
        operation=pl.col("operation").str.replace(r"^bit=\d+", "flip"),
    )


def _registers(runs: Runs) -> Runs:
    names = {"general": "general + flags", "fp": "XMM, YMM"}
    return runs.injected.where(level="register").adding(registers=pl.col("target").replace(names))


def _effects(runs: Runs, _: tuple[str, ...]) -> Iterable[Measure]:
    """Number of faults and share of each effect; with a verdict, also of lost missions."""
    yield m.count("n", "runs", _JUDGED)
    for effect in _EFFECTS:
        yield m.rate(effect, HEADINGS.get(effect, effect), pl.col("effect") == effect, _JUDGED)
    if has_verdicts(runs):
        yield m.rate("lost", "mission lost", ~pl.col("success"), _JUDGED)
    yield m.count("unknown", "not judged", effect="unknown")


def _watched(runs: Runs) -> Runs:
    """Runs in the arms with a detector."""
    return runs.where(pl.col("detector") != "")


def _endings_note(runs: Runs) -> list[str]:
    crashed = runs.injected.where(effect="crash", setting=FI).frame["kernel_effect_detail"].value_counts()
    endings = ", ".join(f"{name} {count}" for name, count in crashed.sort("kernel_effect_detail").rows())
    if endings:
        return [f"crashes: {endings}"]
    return []


def _stopped_note(runs: Runs) -> list[str]:
    held = sorted(
        injection.details["stopped_us"]
        for record in _registers(runs).recorded()
        for injection in record.injections
        if "stopped_us" in injection.details
    )
    if held:
        return [f"the process stood still for {held[len(held) // 2] / 1000:.1f} ms (median)"]
    return []


def _of_stack(name: str, title: str, by: tuple[str, ...]) -> View:
    """A table of the effects of faults in messages."""
    return View(
        name,
        title,
        by,
        (_effects,),
        where=_messages,
        total=(by[0], "in all"),
        notes=lambda runs: (_INTERVALS, *_endings_note(runs)),
        applies=_of_messages,
    )


CHAPTER = Chapter(
    40,
    (
        _of_stack("message_effects", "What a fault in a message does to the stack", ("topic", "operation")),
        _of_stack("field_effects", "What a fault does, by field", ("topic", "field")),
        View(
            "stack_alarms",
            "What detectors of the stack's messages notice",
            ("arm", "detector"),
            (
                m.count("n", "faults", _JUDGED, kind="injected"),
                m.rate("detected", "detected", ALARMED, _FAULTS),
                m.rate("detected_sdc", "of SDC", ALARMED, _FAULTS, pl.col("effect") == "sdc"),
                m.rate("false_alarms", "runs without a fault, with an alarm", pl.col("alarms_total") > 0, _GOLDEN),
            ),
            where=_watched,
            notes=lambda _: (_INTERVALS, "detected: an alarm follows the fault that the run without a fault has not"),
            applies=lambda runs: runs.campaign.get("host") == HOST and len(_watched(runs)) > 0,
        ),
        View(
            "register_effects",
            "What one bit in a register does",
            ("registers",),
            (_effects,),
            where=_registers,
            total=("registers", "in all"),
            notes=lambda runs: (_INTERVALS, *_endings_note(runs), *_stopped_note(runs), _REPEAT),
            applies=_of_registers,
        ),
    ),
)
