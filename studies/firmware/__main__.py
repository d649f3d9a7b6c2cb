"""Register faults in a flight controller's firmware: fly them, and write docs/results/firmware.md.

    python -m studies.firmware [FLIGHTS]

Appends to out/firmware/*.jsonl and resumes; flight i has seed i.  The last faults of each pattern are flown again, and
their digests compared.
"""

import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.analysis.statistics import wilson
from mavfi.analysis.table import NUMBER, RATE, SIGNED, Column, Table
from mavfi.api import load
from mavfi.api import table as table_of
from mavfi.extras.firmware.build import installed
from mavfi.extras.firmware.controller import BetaflightController
from mavfi.extras.firmware.host import fly, register_fault
from mavfi.extras.registers.fault import RegisterFault
from mavfi.faults.sampling import stream
from mavfi.flight.compose import resolve
from mavfi.flight.loop import Listener, Loop
from mavfi.mission import MissionSpec
from mavfi.outcomes import LOST_TILT, ControlEffect, ControlErrors, control_of, energy
from mavfi.record import FlightLog
from mavfi.report.text import header
from studies.firmware import patterns
from tools import results
from tools.fault_levels import level_table
from tools.markers import DOCS, ROOT, fill

OUT = Path("out/firmware")
PAGE = "firmware"
ENVIRONMENTS = ("sparse", "dense", "farm", "factory")
FLIGHTS = 400
"""Flights with a fault of each pattern."""
_FIRST_MISSION = 10_000
_OTHER_NOISE = 100_000
_VIEWS = (
    "firmware_control",
    "firmware_control_phases",
    "firmware_classes",
    "firmware_faults",
    "firmware_phases",
    "firmware_functions",
)
Row = dict[str, Any]


def fault_of(pattern: str, seed: int) -> RegisterFault:
    """The fault of flight number `seed`: its instant is uniform in the flight's middle."""
    span = (round(1e6 * patterns.FIRST_S), round(1e6 * patterns.LAST_S))
    return register_fault(int(stream(seed, "firmware", pattern).integers(*span)), seed)


def rows_of(name: str) -> list[Row]:
    """The ledger of a kind of flight, in order of seeds."""
    files = sorted(OUT.glob(f"{name}*.jsonl"))
    rows = [json.loads(line) for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    return sorted({row["seed"]: row for row in rows}.values(), key=lambda row: row["seed"])


def fly_faults(pattern: str, first: int, count: int) -> None:
    """Fly faults that are not in the ledger."""
    OUT.mkdir(parents=True, exist_ok=True)
    done = {row["seed"] for row in rows_of(pattern)}
    golden = patterns.fly(pattern)
    with (OUT / f"{pattern}-{first}.jsonl").open("a", encoding="utf-8") as file:
        for seed in range(first, first + count):
            if seed in done:
                continue
            began = time.perf_counter()
            flight = patterns.fly(pattern, fault_of(pattern, seed))
            row = {"seed": seed, **patterns.to_json(pattern, golden, flight), "golden": golden.digest}
            row |= {"wall_s": round(time.perf_counter() - began, 2), "load": round(os.getloadavg()[0], 1)}
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(seed, row["outcome"], row["function"], row["register_class"], row["wall_s"], flush=True)


def check(pattern: str, count: int) -> None:
    """Fly the last faults of a ledger again, and compare digests."""
    same = 0
    rows = rows_of(pattern)[-count:]
    for row in rows:
        flight = patterns.fly(pattern, fault_of(pattern, row["seed"]))
        is_same = flight.digest == row["digest"] and list(flight.firmware_end) == row["lost"]
        verdict = "different"
        if is_same:
            same += 1
            verdict = "same"
        print(row["seed"], verdict, flush=True)
    _append(f"check-{pattern}", {"seed": pattern, "same": same, "n": len(rows)})


def golden_missions(environment: str, count: int) -> None:
    """Golden missions in an environment; the first one twice."""
    known = {row["seed"] for row in rows_of("golden")}
    for seed in range(_FIRST_MISSION, _FIRST_MISSION + count):
        name = f"{environment}-{seed}"
        if name in known:
            continue
        scenario = resolve(MissionSpec(environment=environment, seed=seed, flight_controller="betaflight"))
        began = time.perf_counter()
        log = fly(scenario).log
        row: Row = {"seed": name, "environment": environment, "status": log.status.label, "digest": log.digest()}
        row |= {"flight_s": float(log.column("time")[-1]), "wall_s": round(time.perf_counter() - began, 2)}
        row |= {"load": round(os.getloadavg()[0], 1)}
        if seed == _FIRST_MISSION:
            row["same"] = fly(scenario).log.digest() == log.digest()
        _append(f"golden-{environment}", row)
        print(row, flush=True)


def healthy_missions(environment: str, first: int, count: int, noises: int) -> None:
    """Missions without a fault: each with its own gyro noise and with others, which are classified as with a fault."""
    known = {row["seed"] for row in rows_of("healthy")}
    for seed in range(first, first + count):
        scenario = resolve(MissionSpec(environment=environment, seed=seed, flight_controller="betaflight"))
        if f"{environment}-{seed}-{noises}" in known:
            continue
        golden = fly(scenario)
        for noise in range(1, noises + 1):
            other = fly(scenario, observers=(_OtherNoise(seed + noise * _OTHER_NOISE),))
            golden_record = golden.record()
            other_record = other.record()
            effect = control_of(golden_record, other_record)
            row: Row = {
                "seed": f"{environment}-{seed}-{noise}",
                "mission": seed,
                "control": effect and effect.value,
                "errors": [flight.extra[ControlErrors.KEY] for flight in (golden, other)],
                "time": other_record.flight_time_s / golden_record.flight_time_s - 1,
                "energy": energy(other_record.energy) / energy(golden_record.energy) - 1,
                "distance_m": _largest_distance(golden.log, other.log),
            }
            _append(f"healthy-{environment}", row)
            print(row, flush=True)


class _OtherNoise(Listener):
    """Draws the gyro's noise of a flight from a seed."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def begin(self, loop: Loop) -> None:
        """See `Listener`."""
        controller = getattr(loop.plant, "controller", None)
        assert isinstance(controller, BetaflightController)  # as the mission says
        controller.draw_noise(self._seed)


def _largest_distance(golden: FlightLog, other: FlightLog) -> float:
    """Largest distance at the same instant (m)."""
    count = min(len(golden.rows), len(other.rows))
    first, second = (log.columns("x", "y", "z")[:count] for log in (golden, other))
    return float(np.linalg.norm(first - second, axis=1).max())


def _append(name: str, row: Row) -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / f"{name}.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


# ---- the page ----------------------------------------------------------------------------------------------------
TEXT = (
    "Two of three flipped bits leave the flight bit for bit as it was; one of six ends the firmware's process, nearly "
    "always one in the stack or a general register, and one of sixteen loses control, mostly one in a floating-point "
    "register. One bit of a register that an instruction of the main thread reads or writes, uniform over its "
    "instructions. How it is done: [firmware](../how-to/firmware.md)."
)
NOTES = (
    f"flights of {patterns.LENGTH_S:g} s without the pipeline, the fault between {patterns.FIRST_S:g} and "
    f"{patterns.LAST_S:g} s; slight: at most {100 * patterns.SLIGHT_M:g} cm from the golden flight; loss of control: "
    f"contact, more than {patterns.LOST_M:g} m off, or tilt above {np.degrees(LOST_TILT):.0f} degrees; 95 % "
    "intervals: Wilson",
)


def grouped(rows: Iterable[Row], key: Callable[[Row], str]) -> dict[str, list[str]]:
    """Outcomes by group, the largest groups first."""
    rows = list(rows)
    outcomes: dict[str, list[str]] = {name: [] for name, _ in Counter(map(key, rows)).most_common()}
    for row in rows:
        outcomes[key(row)].append(row["outcome"])
    return outcomes


def pattern_table() -> Table:
    """Outcomes of the short flights: by flight, register, phase and function."""
    rows = [row for name in patterns.PATTERNS for row in rows_of(name) if row["activated"]]
    groups = {
        "all": {"both": [row["outcome"] for row in rows]},
        "flight": {name: [row["outcome"] for row in rows_of(name) if row["activated"]] for name in patterns.PATTERNS},
        "register": grouped(rows, lambda row: row["register_class"]),
        "phase": grouped(rows, lambda row: row["phase"]),
        "function": grouped(rows, lambda row: row["function"]),
    }
    columns = [Column("by", "by"), Column("group", "group"), Column("n", "n", NUMBER)]
    columns += [Column(outcome.replace(" ", "_"), outcome, RATE) for outcome in patterns.OUTCOMES]
    cells = [
        (title, name, len(ends), *(wilson(ends.count(outcome), len(ends)) for outcome in patterns.OUTCOMES))
        for title, parts in groups.items()
        for name, ends in parts.items()
    ]
    return Table("patterns", "Hover and square, by flight, register, phase, function", tuple(columns), cells, 2, NOTES)


def golden_table() -> Table:
    """Golden missions by environment, with their times and those whose second flight had the same digest."""
    columns = (
        Column("environment", "environment"),
        Column("success", "success", RATE),
        Column("flight_s", "flight time, median (s)", "number .1f"),
        Column("wall_s", "wall time, median (s)", "number .1f"),
        Column("same", "flown twice, same digest", NUMBER),
    )
    cells = []
    for environment in ENVIRONMENTS:
        rows = [row for row in rows_of("golden") if row["environment"] == environment]
        success = wilson(sum(row["status"] == "success" for row in rows), len(rows))
        medians = (float(np.median([row[name] for row in rows])) for name in ("flight_s", "wall_s"))
        cells.append((environment, success, *medians, sum(row.get("same", False) for row in rows)))
    return Table("golden", "Golden missions", columns, cells)


def healthy_table() -> Table:
    """Classes, distances and largest errors of missions without a fault and with other gyro noise."""
    errors = ("tilt", "attitude", "velocity", "yaw_rate")
    columns = (
        Column("seeds", "seeds"),
        Column("flights", "flights", NUMBER),
        *(Column(effect.value.replace(" ", "_"), effect.value, NUMBER) for effect in ControlEffect),
        Column("apart_m", "from the golden run, max (m)", "number .1f"),
        Column("time", "longer, max", SIGNED),
        Column("energy", "more energy, max", SIGNED),
        *(Column(name, f"{name} error, max (rad, m/s, rad/s)", "number .2f") for name in errors),
    )
    # missions of the evaluation and those of the design, which have lower seeds
    evaluation: list[Row] = []
    design: list[Row] = []
    for row in rows_of("healthy"):
        if row["mission"] < _FIRST_MISSION:
            design.append(row)
        else:
            evaluation.append(row)

    cells = []
    for seeds, rows in (("evaluation", evaluation), ("design, from which the limits are", design)):
        counter = Counter(row["control"] for row in rows)
        counts = (counter[effect.value] for effect in ControlEffect)
        largest = (max((row[name] for row in rows), default=None) for name in ("distance_m", "time", "energy"))
        errors_of_flights = [flight for row in rows for flight in row["errors"]]
        worst = (max((flight[name] for flight in errors_of_flights), default=None) for name in errors)
        cells.append((seeds, len(rows), *counts, *largest, *worst))
    return Table("healthy", "Missions without a fault, other gyro noise, classified", columns, cells)


def write_page(campaign: Path) -> Path:
    """Write the page from the ledgers of the patterns, and of the campaign `firmware`."""
    runs = load(campaign)
    tables = {"patterns": pattern_table(), "golden": golden_table(), "healthy": healthy_table()}
    tables |= {view: table_of(runs, view) for view in _VIEWS}
    about = [f"{installed().version}, unmodified, in lock-step"]
    about += [
        f"flown again ({row['seed']}): {row['same']} of {row['n']} gave the same bytes" for row in rows_of("check")
    ]
    about += header(runs.campaign)
    excerpts = [
        results.Excerpt("patterns", lambda row: row["by"] in ("all", "register")),
        results.Excerpt("firmware_faults", lambda row: row["registers"] == "in all"),
    ]
    title = "Register faults in a flight controller's firmware"
    return results.write(PAGE, title, TEXT, tables, excerpts, about, command="python -m studies.firmware")


def headline() -> str:
    """The table of both patterns, for docs/reference/registers.md."""
    excerpt = results.Excerpt("patterns", lambda row: row["by"] == "flight", ("group", "n", *patterns.OUTCOMES))
    return excerpt.markdown(pattern_table())


def main(count: int) -> None:
    """Fly what the ledgers lack, up to a number of flights with a fault per pattern, and write the page."""
    for pattern in patterns.PATTERNS:
        fly_faults(pattern, 0, count)
        check(pattern, 20)
    for environment in ENVIRONMENTS:
        golden_missions(environment, 20)
        healthy_missions(environment, _FIRST_MISSION, 10, 1)
        healthy_missions(environment, 1, 4, 3)
    page = write_page(results.fly("firmware", scale=""))
    fill(DOCS / "reference" / "registers.md", {"firmware": headline()})
    fill(DOCS / "concepts" / "levels.md", {"levels": level_table()})
    print(f"wrote {page.relative_to(ROOT)}")


if __name__ == "__main__":
    flights = FLIGHTS
    if sys.argv[1:]:
        flights = int(sys.argv[1])
    main(flights)
