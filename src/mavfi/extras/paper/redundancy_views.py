"""Fig. 8 of the paper: redundant processors against detection, by the visual performance model, without flights."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import polars as pl

from mavfi.analysis import published as paper
from mavfi.analysis.measures import Measure, first
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Table
from mavfi.analysis.views import View
from mavfi.extras.paper.redundancy import (
    DesignConfig,
    at_ends,
    energy_ratio,
    performance,
    safe_speed,
    shipped_designs,
    time_ratio,
)
from mavfi.plugins import Chapter

SPEED_LIMIT = 3.0
"""Speed limit of the published mission (m/s)."""
AUTOENCODER, GAUSSIAN, DMR, TMR = "autoencoder", "Gaussian", "DMR", "TMR"
_WORST = "dense"
"""Environment with the paper's largest detection overheads."""


def schemes() -> dict[str, tuple[int, float]]:
    """Number of processors and compute overhead (from the paper) by scheme; the first scheme is the reference."""
    overheads = {
        name: float(paper.figure("overhead", environment=_WORST, setting=f"dr_{name.lower()}"))
        for name in (AUTOENCODER, GAUSSIAN)
    }
    return {name: (1, overhead) for name, overhead in overheads.items()} | {DMR: (2, 0.0), TMR: (3, 0.0)}


def ratio(design: DesignConfig, scheme: str) -> float:
    """Flight time with a scheme relative to that with the autoencoder."""
    return time_ratio(performance(design, *schemes()[scheme]), performance(design, *schemes()[AUTOENCODER]))


def band(design: DesignConfig, scheme: str) -> tuple[float, float]:
    """Smallest and largest ratio when each parameter in turn is set to the ends of its band."""
    ends = [end for key in design.bands for end in at_ends(design, key) if end is not None]
    found = [ratio(end, scheme) for end in (design, *ends)]
    return min(found), max(found)


def _of(rows: Iterable[dict[str, Any]]) -> Runs:
    return Runs(pl.DataFrame(list(rows), infer_schema_length=None))


def _comparison(designs: Sequence[DesignConfig]) -> Runs:
    """Comparison of schemes: one row per design and scheme."""
    rows = []
    for design in designs:
        reference = performance(design, *schemes()[AUTOENCODER])
        for scheme, (copies, overhead) in schemes().items():
            own = performance(design, copies, overhead)
            low, high = band(design, scheme)
            rows.append({
                "vehicle": design.craft, "calibration": design.calibration, "scheme": scheme,
                "payload": 1000 * own.payload, "mass": 1000 * own.mass, "acceleration": own.acceleration,
                "speed": own.speed, "time": time_ratio(own, reference), "low": low, "high": high,
                "energy": energy_ratio(own, reference), "limited": time_ratio(own, reference, SPEED_LIMIT),
                "paper": paper.figure("redundancy_time", vehicle=design.craft, scheme=scheme),
                "paper_energy": paper.figure("redundancy_energy", vehicle=design.craft, scheme=scheme),
            })  # fmt: skip
    return _of(rows)


def _sensitivity(designs: Sequence[DesignConfig]) -> Runs:
    """Sensitivity of TMR: one row per design and parameter with a band."""
    rows = []
    for design in designs:
        for key, found in design.bands.items():
            low, high = (None if end is None else ratio(end, TMR) for end in at_ends(design, key))
            rows.append({
                "vehicle": design.craft, "calibration": design.calibration, "parameter": key.replace("_", " "),
                "value": getattr(design, key), "from": found.low, "to": found.high, "at_low": low, "at_high": high,
                "source": design.sources.get(key, ""),
            })  # fmt: skip
    return _of(rows)


def _stopping(speed: float) -> float:
    """Stopping distance (m) at a speed (m/s), by RoboRun's fit to flights."""
    return 0.05494 * speed * speed + 0.3549 * speed - 0.2038


def _published_speeds() -> Runs:
    """Check of the model: one row per published pair of action period and speed."""
    mavbench = [("MAVBench, a and d of its launch files", 6.0, 6.5, *pair) for pair in ((0.0, 8.83), (4.0, 1.57))]
    seen, braking = 7.0, 5.0  # range (m) and acceleration limit (m/s^2) of the published mission
    roborun = [
        ("RoboRun, fit of stopping distances", braking, seen, (seen - _stopping(speed)) / speed, speed)
        for speed in (2.0, 3.0, 4.0, 6.0)
    ]
    return _of(
        {
            "source": source, "period": round(period, 3), "acceleration": acceleration, "range": distance,
            "published": published, "speed": safe_speed(acceleration, period, distance),
        }
        for source, acceleration, distance, period, published in (*mavbench, *roborun)
    )  # fmt: skip


def _number(key: str, heading: str, form: str) -> Measure:
    def of(own: Runs) -> Any:
        value = own.first(key)
        return "cannot hover" if value is not None and math.isinf(value) else value

    return Measure(key, heading, form, of)


def between(low: float, high: float) -> str:
    """Words for a band of ratios; an infinite end means that the vehicle cannot hover there."""
    return f"≥ {low:.2f}" if math.isinf(high) else f"{low:.2f}–{high:.2f}"


def _band(own: Runs) -> str | None:
    low, high = own.first("low"), own.first("high")
    return between(low, high) if low < high and own.first("scheme") != AUTOENCODER else None


_TIMES, _WHO = "number .3f ×", ("vehicle", "calibration")
_COMPARED = View(
    "redundancy", "Redundant processors against detection (Fig. 8): flight time and energy over the same distance",
    (*_WHO, "scheme"),
    (
        _number("time", "flight time", _TIMES), Measure("band", "band", TEXT, _band),
        _number("paper", "paper", "number .2f ×"), _number("energy", "energy, hover power", _TIMES),
        _number("paper_energy", "paper, energy", "number .2f ×"),
        _number("limited", f"flight time, v ≤ {SPEED_LIMIT:g} m/s", _TIMES),
        _number("speed", "speed", "number .2f m/s"), _number("acceleration", "acceleration", "number .2f m/s²"),
        _number("mass", "mass", "number .0f g"), _number("payload", "of it computer", "number .0f g"),
    ),
    where=lambda _: _comparison(shipped_designs()), by_name=True,
    notes=lambda _: (
        "ratios to the autoencoder scheme; a vehicle flies at the speed from which it still stops within its sensing "
        "range: v T + v²/(2a) = d (Krishnan et al., IEEE CAL 2020); DMR, TMR: 2, 3 processors in lockstep on a board, "
        "each with its heat sink; detectors lengthen T by the overhead of the paper's Table II, Dense",
        "band: one parameter after the other at the ends of the range that sources support (view redundancy_band); ≥: "
        "at one end it cannot hover",
        "calibrated to the paper's two figures after the fact, not a reproduction: its recipe and vehicle data are not "
        "public, and neither calibration has support for every number of the Spark",
        "energy, hover power: rotors need ~ mass^1.5 (momentum theory), so energy grows more than time; at constant "
        "power, as in the paper, the ratio of energies is that of flight times",
        f"with the published mission's limit of {SPEED_LIMIT:g} m/s a vehicle that may fly faster loses no time",
    ),
)  # fmt: skip
_BAND = View(
    "redundancy_band", "Redundant processors: flight time of TMR by parameter", (*_WHO, "parameter"),
    (
        _number("value", "value", "number .5g"), _number("from", "from", "number .5g"),
        _number("to", "to", "number .5g"), _number("at_low", "TMR at lower end", _TIMES),
        _number("at_high", "TMR at upper end", _TIMES), first("source", "source"),
    ),
    where=lambda _: _sensitivity(shipped_designs()), by_name=True,
    notes=lambda _: ("SI units; — = cannot hover with one processor",),
)  # fmt: skip
_SPEEDS = View(
    "redundancy_speeds", "The stopping model against published speeds", ("source", "period"),
    (
        _number("acceleration", "acceleration", "number .0f m/s²"), _number("range", "range", "number .1f m"),
        _number("published", "published", "number .2f m/s"), _number("speed", "model", "number .2f m/s"),
    ),
    where=lambda _: _published_speeds(), by_name=True,
    headings=("source", "action period (s)"),
    notes=lambda _: (
        "RoboRun: the period is what its stopping distance leaves of 7 m; the model brakes with 5 m/s², limit of the "
        "published mission",
    ),
)  # fmt: skip
CHAPTER = Chapter(100, (_COMPARED, _BAND, _SPEEDS))


def redundancy_tables(designs: Sequence[DesignConfig]) -> list[Table]:
    """Tables for designs: comparison, sensitivity (if any design has bands), and check of the model."""
    nothing = Runs(pl.DataFrame())
    found = [replace(_COMPARED, where=lambda _: _comparison(designs)).table(nothing)]
    if any(design.bands for design in designs):
        found.append(replace(_BAND, where=lambda _: _sensitivity(designs)).table(nothing))
    return [*found, _SPEEDS.table(nothing)]


def summary(designs: Sequence[DesignConfig]) -> list[str]:
    """One sentence per design with the flight time of TMR relative to detection."""
    found = []
    for design in designs:
        times, (low, high) = ratio(design, TMR), band(design, TMR)
        printed = paper.figure("redundancy_time", vehicle=design.craft, scheme=TMR)
        reach = f", band {between(low, high)}" if design.bands else ""
        reference = f"; the paper: {printed:.2f} times" if printed is not None else ""
        what = "cannot hover" if math.isinf(times) else f"takes {times:.2f} times as long as with a detector{reach}"
        found.append(f"{design.craft} ({design.calibration}): with TMR it {what}{reference}.")
    return found
