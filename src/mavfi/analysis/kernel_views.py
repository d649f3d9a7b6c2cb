"""Views of instruction faults: the success table under both policies, and the effects on kernels."""

from collections.abc import Callable
from typing import Any

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.flight_views import (
    INSTRUCTION,
    ONE_FAULT,
    faulty_and_bare,
    separable_note,
    unknown_note,
)
from mavfi.analysis.measures import Measure
from mavfi.analysis.rows import ACTIVATED, KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import RATE, TEXT
from mavfi.analysis.views import View, has, register
from mavfi.campaign.plan import FI
from mavfi.extras.paper import published as paper

_DYING = (
    "node restarts / mission ends: what becomes of a mission whose kernel crashes, hangs or raises; the paper's ROS "
    "starts such nodes again; the share of kernels that die is measured in LLVM IR, not machine code"
)
_RATES = "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds], successes / n; bits of all kinds"
_LEVEL = "SDC rates may be quoted; crash, hang and exception rates are measured in LLVM IR, not machine code"
_EFFECTS = (
    "masked: what the kernel publishes and remembers is bit for bit the golden; sdc: it is not; intervals: 95 %, "
    "Wilson, n reduced by the design effect of worlds"
)


def _of_instructions(runs: Runs) -> bool:
    return has(runs.injected, level=INSTRUCTION)


def _by_stages(runs: Runs) -> bool:
    # equal numbers of faults per stage, so that rates over all faults are comparable with the paper's table
    return _of_instructions(runs) and runs.campaign.get("each") == "stage"


# ---- success under both policies ---------------------------------------------------------------------------------
def _success(kind: str, column: str) -> Callable[[Runs], Any]:
    return lambda own: m.rate_of(own.where("judged"), column) if own.first("kind") == kind else None


def _estimand(runs: Runs) -> str:
    planned = {name: place for place, name in enumerate(runs.campaign.get("kernels", ()))}
    stages = runs.injected.where(level=INSTRUCTION).groups("stage")
    kernels = {
        stage: sorted(own.values("kernel"), key=lambda name: planned.get(name, len(planned)))
        for (stage,), own in stages.items()
    }
    shares = "; ".join(f"{stage}: {', '.join(names)}" for stage, names in kernels.items())
    which = runs.campaign.get("which", "all")
    drawn = "dynamic instructions" if which == "all" else f"dynamic instructions of class {which}"
    return (
        f"equal numbers of faults per stage, shared equally among its kernels ({shares}); within a kernel uniform over "
        f"its {drawn} in the golden flight, then over the bits of the value"
    )


def _missed_note(runs: Runs) -> str:
    parts = runs.injected.where("judged").groups("setting")
    counts = ", ".join(f"{setting} {_missed(own)}" for (setting,), own in parts.items())
    return f"faults that found no such call or were not activated, kept in every rate: {counts}"


def _missed(own: Runs) -> int:
    return len(own.where(pl.col("site_outcome") != ACTIVATED))


register(
    View(
        "instructions_as_in_the_paper", "Instruction level, the paper's Table I: success rates, one fault per mission",
        ("row",),
        (
            Measure("here", "here", RATE, _success("golden", "success")),
            Measure("restart", "here, node restarts", RATE, _success("injected", "success")),
            Measure("end", "here, mission ends", RATE, _success("injected", "success_if_ended")),
            paper.column(paper.success),
        ),
        where=faulty_and_bare, across="environment", headings=("",),
        notes=lambda runs: (
            paper.INSTRUCTION_LEVEL, ONE_FAULT, _estimand(runs), _RATES, _DYING, _missed_note(runs),
            *unknown_note(faulty_and_bare(runs)), *separable_note(runs),
        ), leads=True, applies=_by_stages,
    ),
)  # fmt: skip


# ---- effects on kernels ------------------------------------------------------------------------------------------
def kernel_runs(runs: Runs) -> Runs:
    """Runs in setting `fi` with an instruction fault, of which the effects on kernel and flight are known."""
    return _all_settings(runs).where(setting=FI)


def _all_settings(runs: Runs) -> Runs:
    """As `kernel_runs`, of all settings."""
    judged = (pl.col("kernel_effect") != "") & (pl.col("effect") != "unknown")
    return runs.injected.where(judged, level=INSTRUCTION)


def _effect(*effects: str) -> pl.Expr:
    return pl.col("kernel_effect").is_in(effects)


_THREE = (
    m.rate("masked", "masked", _effect("masked")),
    m.rate("sdc", "sdc", _effect("sdc")),
    m.rate("due", "due", _effect(*KERNEL_DUE)),
)
_FOUND = _effect("detected")


def _replayable_note(runs: Runs) -> str:
    own = kernel_runs(runs)
    again = len(own.where("replayable"))
    note = f"{again} of {len(own)} flights can be replayed bit for bit"
    return note if again == len(own) else (
        f"{note}: not those with a corrupted address or branch in a kernel whose memory belongs to a library"
    )  # fmt: skip


register(
    View(
        "kernel_effects", "One fault in one instruction: what the kernel did", ("environment", "kernel"),
        (
            m.count("n", "n"), *_THREE,
            Measure("due_kinds", "crash / hang / exc.", TEXT,
                    lambda own: " / ".join(str(len(own.where(kernel_effect=name))) for name in KERNEL_DUE)),
        ),
        where=kernel_runs, notes=lambda runs: (_EFFECTS, _LEVEL, _replayable_note(runs)),
        applies=_of_instructions,
    ),
    View(
        "kernel_effects_by_setting", "One fault in one instruction of a kernel, plain and protected",
        ("environment", "kernel", "setting"),
        (
            m.count("n", "n"), *_THREE, m.rate("found", "detected", _FOUND),
            m.rate("success", "success", "success"),
            m.rate("success_due", "success | due", "success", _effect(*KERNEL_DUE)),
        ),
        where=lambda runs: _all_settings(runs).where(site_outcome=ACTIVATED),
        notes=lambda _: (
            _EFFECTS, "detected: by protected code, whose call is computed again; due: crash, hang or exception",
            "n: faults that were activated; protected kernels take longer, so that the same call number meets other "
            "values, or none: settings are compared as samples, not in pairs", _LEVEL,
        ), applies=lambda runs: _of_instructions(runs) and len(_all_settings(runs).where(_FOUND)) > 0,
    ),
)  # fmt: skip
