"""Views of register faults in a flight controller's firmware: outcomes of the missions, and classes of control."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import SIGNED, Cell
from mavfi.analysis.views import View, has
from mavfi.extras.registers.classes import class_of, function_of
from mavfi.outcomes import COSTLIER, HEALTHY, LASTING_S, LONGER, LOST, ControlEffect
from mavfi.plugins import Chapter

FIRMWARE = "firmware"
"""Value of the column `kernel` for faults in a firmware."""
_MAX_FUNCTIONS = 12
"""Largest number of rows of the table of functions."""
_OUTCOMES = {
    "identical": ("bit-identical", pl.col("effect") == "masked"),
    "arrives": ("other flight, arrives", (pl.col("effect") == "sdc") & pl.col("success")),
    "lost": ("mission lost", (pl.col("effect") == "sdc") & ~pl.col("success")),
    "ends": ("process ends", pl.col("effect") == "crash"),
    "hangs": ("hang", pl.col("effect") == "hang"),
}
"""Outcomes of a fault in the firmware: heading and condition."""
_MEASURES = (m.count("n", "runs"), *(m.rate(key, heading, test) for key, (heading, test) in _OUTCOMES.items()))
"""Columns of tables of outcomes."""
_CLASSES = (
    m.count("n", "runs"),
    *(m.rate(control.name.lower(), control.value, pl.col("control") == control.value) for control in ControlEffect),
)
"""Columns of tables of control errors."""
_INTERVALS = "per cent, [95 % interval, Wilson, adjusted for runs that share a mission], count"
"""What the cells of the tables are."""


def _in_firmware(runs: Runs) -> bool:
    return has(runs.injected, kernel=FIRMWARE)


def _faults(runs: Runs) -> Runs:
    """Activated faults with the columns `registers` (class of the register), `function` and `third` (of the flight)."""
    kind = pl.col("register").map_elements(class_of, return_dtype=pl.String)
    function = pl.col("symbol").map_elements(function_of, return_dtype=pl.String)
    part = (3.0 * pl.col("time_s") / pl.col("golden_flight_time_s")).floor().clip(0, 2).cast(pl.Int64)
    third = part.replace_strict({0: "first", 1: "second", 2: "last"}, return_dtype=pl.String)
    return runs.injected.where("activated", kernel=FIRMWARE).adding(registers=kind, function=function, third=third)


def _has_classes(runs: Runs) -> bool:
    """Whether every mission with a fault in the firmware has its class; ledgers of older versions lack the errors."""
    return _in_firmware(runs) and not has(runs.injected.where("activated", "judged", kernel=FIRMWARE), control="")


def _by_third(runs: Runs) -> Runs:
    """Activated faults, from take-off to the goal."""
    faults = _faults(runs)
    share_of_flight = pl.col("time_s") / pl.col("golden_flight_time_s")
    return replace(faults, frame=faults.frame.sort(share_of_flight, maintain_order=True))


def _by_class(runs: Runs) -> Runs:
    """Activated faults, the classes from harmless to worst."""
    faults = _faults(runs)
    ranks = {control.value: rank for rank, control in enumerate(ControlEffect)}
    rank = pl.col("control").replace_strict(ranks, default=None)
    return replace(faults, frame=faults.frame.sort(rank, maintain_order=True))


def _largest(column: str, scale: float = 1.0) -> Callable[[Runs], Cell]:
    """Largest value of a column; None if there is none."""

    def largest(runs: Runs) -> Cell:
        values = runs.frame[column].drop_nulls()
        if values.is_empty():
            return None
        return scale * float(values.max())  # type: ignore[arg-type]

    return largest


def _definitions(_: Runs) -> tuple[str, ...]:
    """Lines below the table of classes."""
    return (
        f"slight: another flight that follows its commands (tilt to {np.degrees(HEALTHY.tilt):.0f} degrees; for "
        f"{LASTING_S:g} s never beyond {np.degrees(HEALTHY.attitude):.0f} degrees off the commanded attitude, "
        f"{HEALTHY.velocity:g} m/s off the velocity, {HEALTHY.yaw_rate:g} rad/s off the yaw rate) and succeeds if "
        f"its golden run does, with at most {100 * LONGER:.0f} % more time and {100 * COSTLIER:.0f} % more energy",
        f"loss of control: tilt above {np.degrees(LOST.tilt):.0f} degrees, for {LASTING_S:g} s beyond "
        f"{np.degrees(LOST.attitude):.0f} degrees, {LOST.velocity:g} m/s or {LOST.yaw_rate:g} rad/s, or a contact "
        "while not following; degraded: all others whose process runs",
        _INTERVALS,
    )


CHAPTER = Chapter(
    60,
    (
        View(
            "firmware_control",
            "How a mission is controlled after one bit in a register of the firmware",
            ("registers",),
            _CLASSES,
            where=_faults,
            total=("registers", "in all"),
            notes=_definitions,
            largest="n",
            applies=_has_classes,
        ),
        View(
            "firmware_control_phases",
            "Classes of control by third of the golden flight in which the fault comes",
            ("third",),
            _CLASSES,
            where=_by_third,
            applies=_has_classes,
        ),
        View(
            "firmware_classes",
            "What the flights of each class have in common",
            ("control",),
            (
                m.count("n", "runs"),
                m.rate("success", "mission succeeds", "success"),
                m.Measure("time", "longest against golden", SIGNED, _largest("inflation")),
                m.Measure("tilt", "largest tilt", "number .0f deg", _largest("tilt", np.degrees(1.0))),
                m.Measure("attitude", "attitude error", "number .1f deg", _largest("attitude_error", np.degrees(1.0))),
                m.Measure("velocity", "velocity error", "number .2f m/s", _largest("velocity_error")),
                m.Measure("yaw_rate", "yaw rate error", "number .2f rad/s", _largest("yaw_rate_error")),
            ),
            where=_by_class,
            headings=("class",),
            applies=_has_classes,
            notes=lambda _: (f"errors: what lasted for {LASTING_S:g} s, from the fault on; largest of all runs",),
        ),
        View(
            "firmware_faults",
            "What one bit in a register of the firmware does to the mission",
            ("registers",),
            _MEASURES,
            where=_faults,
            total=("registers", "in all"),
            notes=lambda _: (_INTERVALS,),
            largest="n",
            applies=_in_firmware,
        ),
        View(
            "firmware_phases",
            "By third of the golden flight in which the fault comes",
            ("third",),
            _MEASURES,
            where=_by_third,
            applies=_in_firmware,
        ),
        View(
            "firmware_functions",
            "By function of the firmware",
            ("function",),
            _MEASURES,
            where=_faults,
            largest="n",
            limit=_MAX_FUNCTIONS,
            applies=_in_firmware,
        ),
    ),
)
