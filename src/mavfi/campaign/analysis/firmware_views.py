"""Views of register faults in a flight controller's firmware: outcomes of the missions."""

import polars as pl

from mavfi.campaign.analysis import measures as m
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.views import View, has, register
from mavfi.faults.register.classes import class_of, function_of

FIRMWARE = "firmware"
"""Value of the column `kernel` for faults in a firmware."""
_MOST = 12
_OUTCOMES = {
    "identical": ("bit-identical", pl.col("effect") == "masked"),
    "arrives": ("other flight, arrives", (pl.col("effect") == "sdc") & pl.col("success")),
    "lost": ("mission lost", (pl.col("effect") == "sdc") & ~pl.col("success")),
    "ends": ("process ends", pl.col("effect") == "crash"),
    "hangs": ("hang", pl.col("effect") == "hang"),
}
_MEASURES = (m.count("n", "runs"), *(m.rate(key, heading, test) for key, (heading, test) in _OUTCOMES.items()))
_INTERVALS = "per cent, [95 % interval, Wilson, adjusted for runs that share a mission], count"


def _in_firmware(runs: Runs) -> bool:
    return has(runs.injected, kernel=FIRMWARE)


def _faults(runs: Runs) -> Runs:
    """Activated faults with the columns `registers` (class of the register), `function` and `third` (of the flight)."""
    kind = pl.col("register").map_elements(class_of, return_dtype=pl.String)
    function = pl.col("symbol").map_elements(function_of, return_dtype=pl.String)
    part = (3.0 * pl.col("time_s") / pl.col("golden_flight_time_s")).floor().clip(0, 2).cast(pl.Int64)
    third = part.replace_strict({0: "first", 1: "second", 2: "last"}, return_dtype=pl.String)
    return runs.injected.where("activated", kernel=FIRMWARE).adding(registers=kind, function=function, third=third)


register(
    View(
        "firmware_faults", "What one bit in a register of the firmware does to the mission", ("registers",), _MEASURES,
        where=_faults, total=("registers", "in all"), notes=lambda _: (_INTERVALS,), largest="n",
        applies=_in_firmware,
    ),
    View(
        "firmware_phases", "By third of the golden flight in which the fault comes", ("third",), _MEASURES,
        where=_faults, applies=_in_firmware,
    ),
    View(
        "firmware_functions", "By function of the firmware", ("function",), _MEASURES, where=_faults, largest="n",
        limit=_MOST, applies=_in_firmware,
    ),
)  # fmt: skip
