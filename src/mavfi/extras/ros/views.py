"""View of a foreign node: what faults in its registers do."""

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.runs import Runs
from mavfi.analysis.views import View, has
from mavfi.plugins import Chapter

_EFFECTS = {"masked": "masked", "sdc": "SDC", "crash": "crash", "hang": "hang"}
_INTERVALS = (
    "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds], count; a crash or a hang is a "
    "detected error (DUE)"
)
_REPEAT = (
    "the instant of an injection is the machine's, not the seed's: a trial cannot be repeated bit for bit, and the "
    "digest is that of this ledger"
)
_JUDGED = pl.col("effect") != "unknown"


def _of_registers(runs: Runs) -> bool:
    return has(runs.injected, level="register", kernel="")


def _trials(runs: Runs) -> Runs:
    names = {"general": "general + flags", "fp": "XMM, YMM"}
    return runs.injected.where(level="register").adding(registers=pl.col("target").replace(names))


def _endings_note(runs: Runs) -> list[str]:
    crashed = (
        _trials(runs).where(effect="crash").frame["kernel_effect_detail"].value_counts().sort("kernel_effect_detail")
    )
    signals = ", ".join(f"{name} {count}" for name, count in crashed.rows())
    if signals:
        return [f"crashes: {signals}"]
    return []


def _stopped_note(runs: Runs) -> list[str]:
    held = sorted(
        injection.details["stopped_us"]
        for record in _trials(runs).recorded()
        for injection in record.injections
        if "stopped_us" in injection.details
    )
    if held:
        return [f"the process stood still for {held[len(held) // 2] / 1000:.1f} ms (median)"]
    return []


CHAPTER = Chapter(
    40,
    (
        View(
            "register_effects",
            "What one bit in a register does",
            ("registers",),
            (
                m.count("n", "trials", _JUDGED),
                *(m.rate(key, heading, pl.col("effect") == key, _JUDGED) for key, heading in _EFFECTS.items()),
                m.count("unknown", "not judged", effect="unknown"),
            ),
            where=_trials,
            total=("registers", "in all"),
            notes=lambda runs: (_INTERVALS, *_endings_note(runs), *_stopped_note(runs), _REPEAT),
            applies=_of_registers,
        ),
    ),
)
