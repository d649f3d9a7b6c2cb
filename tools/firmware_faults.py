"""Register faults in a flight controller's firmware: fly them, and write docs/generated/firmware.md.

    python -m tools.firmware_faults fly hover --count 400    # appends to out/firmware/hover.jsonl; resumes
    python -m tools.firmware_faults check square --count 20  # repeats the last ones, and compares digests
    python -m tools.firmware_faults golden sparse --count 20 # golden missions in an environment
    python -m tools.firmware_faults healthy sparse --count 5 # missions without a fault, with other gyro noises
    python -m tools.firmware_faults write [DIR]              # the page; DIR: ledger of the campaign `firmware`

Flight i has seed i, so several processes may each fly a part (--first).
"""

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.api import load
from mavfi.api import table as table_of
from mavfi.bridges.firmware.build import installed
from mavfi.bridges.firmware.controller import BetaflightController
from mavfi.bridges.firmware.flight import fly, register_fault
from mavfi.campaign.analysis.statistics import wilson
from mavfi.campaign.analysis.views import views_for
from mavfi.faults.fault import RegisterFault
from mavfi.faults.sampling import stream
from mavfi.flight_log import FlightLog
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.loop.scheduler import Loop
from mavfi.mission import MissionSpec
from mavfi.outcomes import LOST_TILT, Control, ControlErrors, control_of
from mavfi.qof import energy
from mavfi.reports.campaign_report import markdown_table
from mavfi.reports.text import markdown_grid
from tools import firmware_patterns as patterns
from tools.fault_levels import level_table
from tools.markers import DOCS, GENERATED, banner, fill

OUT, PAGE = Path("out/firmware"), GENERATED / "firmware.md"
ENVIRONMENTS = ("sparse", "dense", "farm", "factory")
_MOST_FUNCTIONS = 12
_FIRST_MISSION = 10_000
_OTHER_NOISE = 100_000
_VIEWS = (
    "firmware_control", "firmware_control_phases", "firmware_classes", "firmware_faults", "firmware_phases",
    "firmware_functions",
)  # fmt: skip
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
        is_same = flight.digest == row["digest"] and list(flight.lost) == row["lost"]
        same += is_same
        print(row["seed"], "same" if is_same else "different", flush=True)
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
            other = fly(scenario, observers=(partial(_other_noise, seed + noise * _OTHER_NOISE),))
            ends = golden.record(), other.record()
            found = control_of(*ends)
            row: Row = {"seed": f"{environment}-{seed}-{noise}", "mission": seed, "control": found and found.value}
            row |= {"errors": [flight.extra[ControlErrors.KEY] for flight in (golden, other)]}
            row |= {"time": ends[1].flight_time_s / ends[0].flight_time_s - 1}
            row |= {"energy": energy(ends[1].energy) / energy(ends[0].energy) - 1}
            row |= {"distance_m": _apart(golden.log, other.log)}
            _append(f"healthy-{environment}", row)
            print(row, flush=True)


def _other_noise(seed: int, loop: Loop) -> None:
    """Draw the gyro's noise of a flight that has not started from a seed."""
    controller = getattr(loop.plant, "controller", None)
    assert isinstance(controller, BetaflightController)  # as the mission says
    controller.draw_noise(seed)


def _apart(golden: FlightLog, other: FlightLog) -> float:
    """Largest distance at the same instant (m)."""
    count = min(len(golden.rows), len(other.rows))
    first, second = (log.columns("x", "y", "z")[:count] for log in (golden, other))
    return float(np.linalg.norm(first - second, axis=1).max())


def _append(name: str, row: Row) -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / f"{name}.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


# ---- the page ----------------------------------------------------------------------------------------------------
def shares(title: str, groups: Mapping[str, Sequence[str]], outcomes: Sequence[str]) -> str:
    """Table of the shares of outcomes by group, with 95 % Wilson intervals; groups: outcomes of each flight."""
    rows = (
        [name, str(len(ends)), *(_cell(sum(end == one for end in ends), len(ends)) for one in outcomes)]
        for name, ends in groups.items()
    )
    return markdown_grid((title, "n", *outcomes), rows, left=1)


def _cell(count: int, total: int) -> str:
    rate = wilson(count, total)
    if rate.low is None or rate.high is None:
        return "–"
    return f"{count} ({100 * count / total:.0f} %) [{100 * rate.low:.0f}, {100 * rate.high:.0f}]"


def grouped(rows: Iterable[Row], key: Callable[[Row], str], most: int = 99) -> dict[str, list[str]]:
    """Outcomes by group, the largest groups first; the rest is one group."""
    rows = list(rows)
    names = [name for name, _ in Counter(map(key, rows)).most_common(most)]
    found: dict[str, list[str]] = {name: [] for name in names}
    for row in rows:
        name = key(row)
        found.setdefault(name if name in names else "all others", []).append(row["outcome"])
    return found


def page(campaign: Path | None) -> str:
    """The page, from the ledgers."""
    drawn = {name: rows_of(name) for name in patterns.PATTERNS}
    short = {name: [row for row in part if row["activated"]] for name, part in drawn.items()}
    missed = sum(map(len, drawn.values())) - sum(map(len, short.values()))
    rows = [row for name in short for row in short[name]]
    lines = [
        banner("make firmware").strip(), "", "# Register faults in a flight controller's firmware", "",
        f"{installed().version}, unmodified, in lock-step.  One bit of a register that an instruction of its main "
        "thread reads or writes, uniform over the thread's instructions.  Count, share, 95 % Wilson interval.  "
        "How it is done: [firmware.md](../firmware.md).", "", "## Hover and square", "",
        f"Flights of {patterns.LENGTH_S:g} s without the pipeline; the fault comes between {patterns.FIRST_S:g} and "
        f"{patterns.LAST_S:g} s.  Slight: at most {100 * patterns.SLIGHT_M:g} cm from the golden flight.  Loss of "
        f"control: contact, more than {patterns.LOST_M:g} m off, or tilt above {np.degrees(LOST_TILT):.0f} "
        f"degrees.  Not activated: {missed} of {sum(map(len, drawn.values()))}.", "",
    ]  # fmt: skip
    flown = {name: [row["outcome"] for row in part] for name, part in short.items()}
    tables = {
        "flight": {**flown, "both": [end for part in flown.values() for end in part]},
        "register": grouped(rows, lambda row: row["register_class"]),
        "phase": grouped(rows, lambda row: row["phase"]),
        "function": grouped(rows, lambda row: row["function"], _MOST_FUNCTIONS),
    }
    for title, groups in tables.items():
        lines += [shares(title, groups, patterns.OUTCOMES), ""]
    lost = Counter(row["lost"][1] for row in rows if row["lost"][0] == "crash")
    lines += [f"Ends of the process: {', '.join(f'{name} {count}' for name, count in lost.most_common())}.", ""]
    for row in rows_of("check"):
        lines.append(f"Replay ({row['seed']}): flown again, {row['same']} of {row['n']} flights gave the same bytes.")
    walls = [row["wall_s"] for row in rows]
    lines += ["", f"Wall time per flight: median {np.median(walls):.1f} s (load of the machine "
              f"{np.median([row['load'] for row in rows]):.1f} on {os.cpu_count()} cores).", ""]  # fmt: skip
    return "\n".join([*lines, *_golden_lines(), *_mission_lines(campaign), *_healthy_lines()]).rstrip() + "\n"


def headline() -> str:
    """The table of both patterns, for docs/fault-model.md."""
    ends = {name: [row["outcome"] for row in rows_of(name) if row["activated"]] for name in patterns.PATTERNS}
    return shares("register, firmware", ends, patterns.OUTCOMES)


def _golden_lines() -> list[str]:
    rows = rows_of("golden")
    if not rows:
        return []
    lines = []
    for environment in ENVIRONMENTS:
        own = [row for row in rows if row["environment"] == environment]
        if own:
            good = sum(row["status"] == "success" for row in own)
            medians = (f"{np.median([row[name] for row in own]):.1f}" for name in ("flight_s", "wall_s"))
            lines.append([environment, str(len(own)), _cell(good, len(own)), *medians])
    headings = ("environment", "n", "success", "flight time, median (s)", "wall time, median (s)")
    twice = [row["same"] for row in rows if "same" in row]
    load = np.median([row["load"] for row in rows])
    repeated = f"Flown twice: {len(twice)}, with the same digest: {sum(twice)}."
    return [
        "## Golden missions",
        "",
        markdown_grid(headings, lines, left=1),
        "",
        f"{repeated}  Load of the machine meanwhile: {load:.1f} on {os.cpu_count()} cores.",
        "",
    ]


def _mission_lines(campaign: Path | None) -> list[str]:
    if campaign is None:
        return []
    runs = load(campaign)
    lines = [
        "## Whole missions", "", "`mavfi campaign run firmware`: the whole pipeline flies, the instant is uniform over "
        f"the golden flight.  {len(runs.injected.where('judged'))} runs.", "",
    ]  # fmt: skip
    held = {view.name for view in views_for(runs)}  # ledgers of older versions have no classes of control
    for view in (view for view in _VIEWS if view in held):
        found = table_of(runs, view)
        lines += [markdown_table(found).rstrip().replace("## ", "### ", 1), ""]
    return lines


def _healthy_lines() -> list[str]:
    """What the classes say of missions without a fault, and why the distance from the golden run is none of them."""
    rows = rows_of("healthy")
    parts = {
        "": [row for row in rows if row["mission"] >= _FIRST_MISSION],
        "Design seeds, from which the limits are: ": [row for row in rows if row["mission"] < _FIRST_MISSION],
    }
    found = [f"{title}{_healthy(part)}" for title, part in parts.items() if part]
    return [
        "### Without a fault", "", "The same missions without a fault and with other gyro noise, classified from "
        "take-off on.  Replanning amplifies any difference: the distance from the golden run is no measure of control, "
        "the tracking errors are ([limits](../firmware.md#classes-of-control)).", "",
        *(f"- {line}" for line in found), "",
    ] if found else []  # fmt: skip


def _healthy(rows: Sequence[Row]) -> str:
    """Classes, distances and largest errors of missions without a fault."""
    classes = Counter(row["control"] for row in rows)
    shown = ", ".join(f"{one.value} {_cell(classes[one.value], len(rows))}" for one in Control if classes[one.value])
    apart = [row["distance_m"] for row in rows]
    time, joule = (100 * max(row[name] for row in rows) for name in ("time", "energy"))
    every = [errors for row in rows for errors in row["errors"]]
    tilt, attitude, velocity, yaw_rate = (
        max(errors[name] for errors in every) for name in ("tilt", "attitude", "velocity", "yaw_rate")
    )
    return (
        f"{len(rows)} flights: {shown}.  Up to {max(apart):.1f} m from the golden run (median {np.median(apart):.2f} "
        f"m), {time:.0f} % longer and with {joule:.0f} % more energy.  Largest tilt {np.degrees(tilt):.0f} degrees, "
        f"attitude error {np.degrees(attitude):.1f} degrees, velocity error {velocity:.2f} m/s, yaw rate error "
        f"{yaw_rate:.2f} rad/s."
    )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    for verb, names in (
        ("fly", tuple(patterns.PATTERNS)),
        ("check", tuple(patterns.PATTERNS)),
        ("golden", ENVIRONMENTS),
        ("healthy", ENVIRONMENTS),
    ):
        one = verbs.add_parser(verb)
        one.add_argument("name", choices=names)
        one.add_argument("--count", type=int, default=20)
        if verb in ("fly", "healthy"):
            one.add_argument("--first", type=int, default=0 if verb == "fly" else _FIRST_MISSION)
        if verb == "healthy":
            one.add_argument("--noises", type=int, default=1)
    verbs.add_parser("write").add_argument("campaign", nargs="?", type=Path)
    asked = parser.parse_args()
    if asked.verb == "fly":
        fly_faults(asked.name, asked.first, asked.count)
    elif asked.verb == "check":
        check(asked.name, asked.count)
    elif asked.verb == "golden":
        golden_missions(asked.name, asked.count)
    elif asked.verb == "healthy":
        healthy_missions(asked.name, asked.first, asked.count, asked.noises)
    else:
        PAGE.write_text(page(asked.campaign), encoding="utf-8")
        fill(DOCS / "fault-model.md", {"firmware": headline(), "levels": level_table()})
        print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
