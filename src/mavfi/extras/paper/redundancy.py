"""Visual performance model of a UAV with redundant processors: mass, speed, flight time, energy.

The model has the structure of Krishnan et al., "The Sky Is Not the Limit" (IEEE CAL 2020), and of F-1, from which
MAVFI's Fig. 8 is computed: maximum speed is limited by the stop within the sensing range.  Neither the recipe nor the
vehicle data of that figure are published, so the inputs in `configs/redundancy` are calibrated, with bands.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import polars as pl
from pydantic import Field, model_validator

from mavfi.analysis import published as paper
from mavfi.analysis.measures import Measure, first
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Table
from mavfi.analysis.views import View
from mavfi.config import Config, names, shipped
from mavfi.errors import not_known
from mavfi.plugins import Chapter

GRAVITY = 9.80665
"""Standard gravity (m/s^2)."""
CANNOT_HOVER = math.inf
"""Ratio of flight times if the heavier vehicle has no excess thrust."""


class Band(Config):
    """Range of a parameter supported by public sources, with all other parameters fixed."""

    low: float = Field(gt=0, le=1e6)
    high: float = Field(gt=0, le=1e6)

    @model_validator(mode="after")
    def _ordered(self) -> "Band":
        if self.low > self.high:
            raise ValueError(f"low: {self.low:g}: allowed: at most high, {self.high:g}")
        return self


class DesignConfig(Config):
    """A UAV and its on-board computer, for comparing redundancy with detection."""

    name: str
    vehicle: str = Field("", description="which vehicle this is; the name by default")
    calibration: str = Field("own", description="name of this set of inputs")
    mass: float = Field(gt=0, le=1e3, description="kg: frame, rotors and battery, without the computer")
    max_thrust: float = Field(gt=0, le=1e5, description="N, of all rotors")
    board_mass: float = Field(0.085, ge=0, le=100, description="kg, of the computer without heat sink")
    processor_power: float = Field(5.0, gt=0, le=1e4, description="W, of one processor")
    heatsink: float = Field(0.0054, ge=0, le=1, description="kg/W")
    action_period: float = Field(0.37246, ge=0, le=60, description="s, from an image to the command that answers it")
    sensing_range: float = Field(7.0, gt=0, le=1e4, description="m")
    acceleration: Literal["excess_thrust", "tilt"] = Field(
        "excess_thrust", description="largest: F/m - g, or level at the largest tilt, g sqrt((F/(m g))^2 - 1)"
    )
    replicated: Literal["processor", "board"] = Field(
        "processor", description="processors with heat sinks on one board, or whole boards"
    )
    bands: dict[str, Band] = Field(default_factory=dict, description="supported range, by key")
    sources: dict[str, str] = Field(default_factory=dict, description="source of a value, by key")

    @model_validator(mode="after")
    def _known_keys(self) -> "DesignConfig":
        for key, allowed in (("bands", NUMBERS), ("sources", tuple(type(self).model_fields))):
            for name in getattr(self, key):
                if name not in allowed:
                    raise ValueError(f"{key}: {not_known(name, allowed)}")
        if not max_acceleration(self, self.mass + payload(self, 1)) > 0:
            weight = GRAVITY * (self.mass + payload(self, 1))
            raise ValueError(
                f"max_thrust: {self.max_thrust:g} N: cannot hover; allowed: above the weight with one processor, "
                f"{weight:.4g} N"
            )
        return self

    @property
    def craft(self) -> str:
        """Name of the vehicle."""
        return self.vehicle or self.name


NUMBERS = tuple(name for name, field in DesignConfig.model_fields.items() if field.annotation is float)
"""Numeric keys, which may have a band."""


@dataclass(frozen=True, slots=True)
class Performance:
    """Performance of a vehicle.

    Attributes:
        payload: Mass of the computer with heat sinks (kg).
        mass: Mass of the whole vehicle (kg).
        acceleration: Maximum (m/s^2); 0 = no thrust beyond hovering.
        speed: Maximum speed at which the vehicle can stop within its sensing range (m/s).
    """

    payload: float
    mass: float
    acceleration: float
    speed: float


def payload(design: DesignConfig, copies: int) -> float:
    """Mass of the computer (kg) with `copies` processors; heat sink mass is proportional to power."""
    boards = 1
    if design.replicated == "board":
        boards = copies
    return boards * design.board_mass + copies * design.heatsink * design.processor_power


def max_acceleration(design: DesignConfig, mass: float) -> float:
    """Maximum acceleration (m/s^2) at a vehicle mass (kg); 0 if thrust does not exceed weight."""
    per_mass = design.max_thrust / mass
    if per_mass <= GRAVITY:
        return 0.0
    if design.acceleration == "excess_thrust":
        return per_mass - GRAVITY
    return math.sqrt(per_mass**2 - GRAVITY**2)


def safe_speed(acceleration: float, action_period: float, sensing_range: float) -> float:
    """Maximum speed v (m/s) at which the vehicle can stop within its sensing range: v T + v^2 / (2 a) = d.

    Args:
        acceleration: Deceleration a during braking (m/s^2); 0 gives 0.
        action_period: Reaction time T before braking starts (s).
        sensing_range: Sensing range d (m).
    """
    if acceleration <= 0:
        return 0.0
    # 2 d / (T + sqrt(T^2 + 2 d / a)): the root in a form without cancellation
    root = math.sqrt(action_period**2 + 2 * sensing_range / acceleration)
    return 2 * sensing_range / (action_period + root)


def performance(design: DesignConfig, copies: int = 1, overhead: float = 0.0) -> Performance:
    """Performance with 1 (no redundancy), 2 (DMR) or 3 (TMR) processors and a detector's compute overhead.

    Copies run in lockstep with a voter of zero latency; the overhead is a fraction of the action period.
    """
    carried = payload(design, copies)
    mass = design.mass + carried
    acceleration = max_acceleration(design, mass)
    period = design.action_period * (1 + overhead)
    return Performance(carried, mass, acceleration, safe_speed(acceleration, period, design.sensing_range))


def time_ratio(slow: Performance, fast: Performance, speed_limit: float = math.inf) -> float:
    """Ratio of flight times over the same distance, `slow` / `fast`, with both speeds capped at a limit (m/s)."""
    speed = min(slow.speed, speed_limit)
    if speed > 0:
        return min(fast.speed, speed_limit) / speed
    return CANNOT_HOVER


def energy_ratio(slow: Performance, fast: Performance) -> float:
    """Ratio of energies over the same distance, with hover power ~ (m g)^1.5 (momentum theory)."""
    masses = slow.mass / fast.mass
    return time_ratio(slow, fast) * masses * math.sqrt(masses)


def find_design(name: str) -> DesignConfig:
    """Load a design: a shipped one by name or a file by path; `BadInputError` if it does not exist or is invalid."""
    return shipped("redundancy", DesignConfig, name)


def shipped_designs() -> list[DesignConfig]:
    """All shipped designs."""
    return [find_design(name) for name in names("redundancy")]


# ---- Fig. 8 of the paper: redundant processors against detection, by the visual performance model, without flights -

SPEED_LIMIT = 3.0
"""Speed limit of the published mission (m/s)."""
AUTOENCODER = "autoencoder"
GAUSSIAN = "Gaussian"
DMR = "DMR"
TMR = "TMR"
_WORST = "dense"
"""Environment with the paper's largest detection overheads."""


SCHEMES: dict[str, tuple[int, float]] = {
    **{
        name: (1, float(paper.figure("overhead", environment=_WORST, setting=f"dr_{name.lower()}")))
        for name in (AUTOENCODER, GAUSSIAN)
    },
    DMR: (2, 0.0),
    TMR: (3, 0.0),
}
"""Number of processors, and compute overhead (from the paper), by scheme; the first scheme is the reference."""


def ratio(design: DesignConfig, scheme: str) -> float:
    """Flight time with a scheme relative to that with the autoencoder."""
    return time_ratio(performance(design, *SCHEMES[scheme]), performance(design, *SCHEMES[AUTOENCODER]))


def energy(design: DesignConfig, scheme: str) -> float:
    """Energy with a scheme relative to that with the autoencoder."""
    return energy_ratio(performance(design, *SCHEMES[scheme]), performance(design, *SCHEMES[AUTOENCODER]))


def ratios_at_ends(design: DesignConfig, key: str, scheme: str) -> list[float | None]:
    """Ratio with a parameter at each end of its band; None = cannot hover even with one processor."""
    ratios: list[float | None] = []
    for value in (design.bands[key].low, design.bands[key].high):
        end = design.model_copy(update={key: value})
        if performance(end).acceleration > 0:
            ratios.append(ratio(end, scheme))
        else:
            ratios.append(None)
    return ratios


def band(design: DesignConfig, scheme: str) -> tuple[float, float]:
    """Smallest and largest ratio when each parameter in turn is set to the ends of its band."""
    at_ends = [value for key in design.bands for value in ratios_at_ends(design, key, scheme) if value is not None]
    ratios = [ratio(design, scheme), *at_ends]
    return min(ratios), max(ratios)


def _table_of(rows: Iterable[dict[str, Any]]) -> Runs:
    """Rows of a model's results, in the form that views are made of."""
    return Runs(pl.DataFrame(list(rows), infer_schema_length=None))


def _comparison(designs: Sequence[DesignConfig]) -> Runs:
    """Comparison of schemes: one row per design and scheme."""
    rows = []
    for design in designs:
        reference = performance(design, *SCHEMES[AUTOENCODER])
        for scheme, processors in SCHEMES.items():
            scheme_performance = performance(design, *processors)
            low, high = band(design, scheme)
            rows.append(
                {
                    "vehicle": design.craft,
                    "calibration": design.calibration,
                    "scheme": scheme,
                    "payload": 1000 * scheme_performance.payload,
                    "mass": 1000 * scheme_performance.mass,
                    "acceleration": scheme_performance.acceleration,
                    "speed": scheme_performance.speed,
                    "time": ratio(design, scheme),
                    "low": low,
                    "high": high,
                    "energy": energy(design, scheme),
                    "limited": time_ratio(scheme_performance, reference, SPEED_LIMIT),
                    "paper": paper.figure("redundancy_time", vehicle=design.craft, scheme=scheme),
                    "paper_energy": paper.figure("redundancy_energy", vehicle=design.craft, scheme=scheme),
                }
            )
    return _table_of(rows)


def _sensitivity(designs: Sequence[DesignConfig]) -> Runs:
    """Sensitivity of TMR: one row per design and parameter with a band."""
    rows = []
    for design in designs:
        for key, supported in design.bands.items():
            at_low, at_high = ratios_at_ends(design, key, TMR)
            rows.append(
                {
                    "vehicle": design.craft,
                    "calibration": design.calibration,
                    "parameter": key.replace("_", " "),
                    "value": getattr(design, key),
                    "from": supported.low,
                    "to": supported.high,
                    "at_low": at_low,
                    "at_high": at_high,
                    "source": design.sources.get(key, ""),
                }
            )
    return _table_of(rows)


def _stopping(speed: float) -> float:
    """Stopping distance (m) at a speed (m/s), by RoboRun's fit to flights."""
    return 0.05494 * speed * speed + 0.3549 * speed - 0.2038


def _published_speeds() -> Runs:
    """Check of the model: one row per published pair of action period and speed."""
    mavbench = [("MAVBench, a and d of its launch files", 6.0, 6.5, *pair) for pair in ((0.0, 8.83), (4.0, 1.57))]
    sensing_range = 7.0  # m, of the published mission
    braking = 5.0  # m/s^2, its limit of acceleration
    roborun = [
        (
            "RoboRun, fit of stopping distances",
            braking,
            sensing_range,
            (sensing_range - _stopping(speed)) / speed,
            speed,
        )
        for speed in (2.0, 3.0, 4.0, 6.0)
    ]
    return _table_of(
        {
            "source": source,
            "period": round(period, 3),
            "acceleration": acceleration,
            "range": distance,
            "published": published,
            "speed": safe_speed(acceleration, period, distance),
        }
        for source, acceleration, distance, period, published in (*mavbench, *roborun)
    )


def _number(key: str, heading: str, form: str) -> Measure:
    def of(runs: Runs) -> Any:
        value = runs.first(key)
        if value is not None and math.isinf(value):
            return "cannot hover"
        return value

    return Measure(key, heading, form, of)


def between(low: float, high: float) -> str:
    """Words for a band of ratios; an infinite end means that the vehicle cannot hover there."""
    if math.isinf(high):
        return f"≥ {low:.2f}"
    return f"{low:.2f}–{high:.2f}"


def _band(runs: Runs) -> str | None:
    low = runs.first("low")
    high = runs.first("high")
    if low < high and runs.first("scheme") != AUTOENCODER:
        return between(low, high)
    return None


_TIMES = "number .3f ×"
_WHO = ("vehicle", "calibration")
_HEADLINE_MEASURES = 3
"""Leading columns of the comparison in the headline."""
_COMPARED = View(
    "redundancy",
    "Redundant processors against detection (Fig. 8): flight time and energy over the same distance",
    (*_WHO, "scheme"),
    (
        _number("time", "flight time", _TIMES),
        Measure("band", "band", TEXT, _band),
        _number("paper", "paper", "number .2f ×"),
        _number("energy", "energy, hover power", _TIMES),
        _number("paper_energy", "paper, energy", "number .2f ×"),
        _number("limited", f"flight time, v ≤ {SPEED_LIMIT:g} m/s", _TIMES),
        _number("speed", "speed", "number .2f m/s"),
        _number("acceleration", "acceleration", "number .2f m/s²"),
        _number("mass", "mass", "number .0f g"),
        _number("payload", "of it computer", "number .0f g"),
    ),
    where=lambda _: _comparison(shipped_designs()),
    by_name=True,
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
)
_BAND = View(
    "redundancy_band",
    "Redundant processors: flight time of TMR by parameter",
    (*_WHO, "parameter"),
    (
        _number("value", "value", "number .5g"),
        _number("from", "from", "number .5g"),
        _number("to", "to", "number .5g"),
        _number("at_low", "TMR at lower end", _TIMES),
        _number("at_high", "TMR at upper end", _TIMES),
        first("source", "source"),
    ),
    where=lambda _: _sensitivity(shipped_designs()),
    by_name=True,
    notes=lambda _: ("SI units; — = cannot hover with one processor",),
)
_SPEEDS = View(
    "redundancy_speeds",
    "The stopping model against published speeds",
    ("source", "period"),
    (
        _number("acceleration", "acceleration", "number .0f m/s²"),
        _number("range", "range", "number .1f m"),
        _number("published", "published", "number .2f m/s"),
        _number("speed", "model", "number .2f m/s"),
    ),
    where=lambda _: _published_speeds(),
    by_name=True,
    headings=("source", "action period (s)"),
    notes=lambda _: (
        "RoboRun: the period is what its stopping distance leaves of 7 m; the model brakes with 5 m/s², limit of the "
        "published mission",
    ),
)
CHAPTER = Chapter(100, (_COMPARED, _BAND, _SPEEDS))


def redundancy_headline(designs: Sequence[DesignConfig]) -> Table:
    """The comparison of designs in the columns that fit 80 characters, with the notes on these."""
    view = replace(
        _COMPARED,
        title="Flight time over the same distance, relative to that with the autoencoder",
        measures=_COMPARED.measures[:_HEADLINE_MEASURES],
        where=lambda _: _comparison(designs),
        notes=lambda _: (
            "band: one parameter after the other at the ends of the range that sources support; DMR, TMR: 2, 3 "
            "processors; paper: its Fig. 8, which gives TMR alone",
        ),
    )
    return view.table(Runs(pl.DataFrame()))


def redundancy_tables(designs: Sequence[DesignConfig]) -> list[Table]:
    """Tables for designs: comparison, sensitivity (if any design has bands), and check of the model."""
    nothing = Runs(pl.DataFrame())
    tables = [replace(_COMPARED, where=lambda _: _comparison(designs)).table(nothing)]
    if any(design.bands for design in designs):
        tables.append(replace(_BAND, where=lambda _: _sensitivity(designs)).table(nothing))
    return [*tables, _SPEEDS.table(nothing)]


def summary(designs: Sequence[DesignConfig]) -> list[str]:
    """One sentence per design with the flight time of TMR relative to detection."""
    sentences = []
    for design in designs:
        times = ratio(design, TMR)
        if math.isinf(times):
            what = "cannot hover"
        else:
            what = f"takes {times:.2f} times as long as with a detector"
            if design.bands:
                what += f", band {between(*band(design, TMR))}"
        reference = ""
        printed = paper.figure("redundancy_time", vehicle=design.craft, scheme=TMR)
        if printed is not None:
            reference = f"; the paper: {printed:.2f} times"
        sentences.append(f"{design.craft} ({design.calibration}): with TMR it {what}{reference}.")
    return sentences
