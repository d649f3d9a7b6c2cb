"""Flies golden missions in all settings and writes docs/golden-rates.md.

    N=60 HARD_N=100 WORKERS=1 ONLY=clutter python benchmarks/golden_rates.py

N: flights of each of the paper's settings (300); HARD_N: of each hard one (100); ONLY: a word that a row's name must
hold (other rows then keep what out/golden-rates.json says).
"""

import json
import os
import sys
import time
from dataclasses import asdict
from datetime import date
from importlib.metadata import version
from pathlib import Path

from mavfi.campaign.golden import EVALUATION_SEED, GoldenFlight, Row, Setting, fly_row

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "golden-rates.md"
RECORD = ROOT / "out" / "golden-rates.json"
"""Every flight of every row, so that rows can be flown one after the other."""
PAPER = [
    Setting(environment, stack, least=100 if stack == "hardened" else least)
    for stack in ("published", "hardened")
    for environment, least in (("factory", 100), ("farm", 100), ("sparse", 95), ("dense", 85))
]
HARD = [
    Setting("clutter", "hardened", v_max=5.0, least=97),
    Setting("dense30", "hardened", v_max=5.0, least=99),
    Setting("dense", "hardened", platform="cortex-a57", least=99),
]
REPORTED = [Setting("dense", "hardened", depth_noise=0.02)]
HEAD = """# Golden rates

Error-free flights: how often they arrive, and how well they fly. `make golden-rates` flies them (N=... flights of each
of the paper's settings, HARD_N=... of each hard one) and writes this page. Seeds follow each other from {seed} on; none
is left out. Stacks are tuned on seeds below 10000.

- *closest*: smallest distance of the hull (sphere of 0.35 m) from the true nearest obstacle or the ground, over all
  flights; below 0 is a contact.
- *replans*: plans after the first, median and largest. *alarms*: collisions that the check predicted, median.
- *off reference*: largest distance of the vehicle from its reference. *speed*: largest, as a share of v_max.
- Intervals are Wilson's, 95 %. Flight times are those of flights that arrived.
"""
COLUMNS = (
    "environment", "stack", "planner", "platform", "v_max", "arrived", "95 %", "wanted", "flight time (s): median",
    "p95", "max", "limit (s)", "closest (m)", "replans", "failed plans", "alarms", "off reference (m)", "speed",
    "warnings",
)  # fmt: skip


def median(values: list[int]) -> str:
    """Middle value, without a fraction where there is none."""
    ordered = sorted(values)
    middle = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
    return f"{middle:g}"


def cells(row: Row) -> list[str]:
    """One line of the table."""
    s, flights, rate = row.setting, row.flights, row.success
    times = row.flight_times()
    name = s.environment if s.depth_noise == 0.0 else f"{s.environment}, depth noise {100 * s.depth_noise:g} %"
    return [
        name, s.stack, s.planner, s.platform, f"{s.v_max:g}", f"{rate.successes}/{rate.n}",
        f"{100 * (rate.low or 0.0):.1f}–{100 * (rate.high or 0.0):.1f}",
        "—" if s.least is None else f"≥ {s.least:g} %",
        *(["—"] * 3 if times is None else (f"{t:.1f}" for t in times)),
        f"{max(f.limit_s for f in flights):.0f}", f"{min(f.clearance_m for f in flights):.2f}",
        f"{median([max(f.plans - 1, 0) for f in flights])} / {max(f.plans for f in flights) - 1}",
        str(sum(f.failed_plans for f in flights)), median([f.alarms for f in flights]),
        f"{max(f.tracking_m for f in flights):.2f}", f"{max(f.speed_share for f in flights):.3f}",
        str(sum(f.warnings for f in flights)),
    ]  # fmt: skip


def line(values: list[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(values) + " |"


def failure(row: Row, flight: GoldenFlight) -> str:
    """One flight that did not arrive."""
    x, y, z = flight.position
    return (
        f"- {row.setting.environment}, {row.setting.stack}, seed {flight.seed}: **{flight.status}** after "
        f"{flight.time_s:.1f} s at ({x:g}, {y:g}, {z:g}) m; {flight.plans} plans, {flight.failed_plans} failed, "
        f"closest {flight.clearance_m:.2f} m; last: {flight.events}. `{row.setting.command(flight.seed)}`"
    )


def page(stored: list[dict[str, object]]) -> str:
    """The page from what was measured, whenever that was."""
    rows = [as_row(entry) for entry in stored]
    runs = sorted({f"{entry['date']} ({entry['versions']})" for entry in stored})
    parts = [HEAD.format(seed=EVALUATION_SEED), "Measured: " + "; ".join(runs) + ".", ""]
    parts += [line(list(COLUMNS)), line(["---"] * len(COLUMNS)), *(line(cells(row)) for row in rows), ""]
    lost = [failure(row, flight) for row in rows for flight in row.failures()]
    parts += ["## Flights that did not arrive", "", *(lost or ["None."]), ""]
    return "\n".join(parts)


def as_row(entry: dict) -> Row:
    """A stored row."""
    flights = tuple(GoldenFlight(**flight | {"position": tuple(flight["position"])}) for flight in entry["flights"])
    return Row(Setting(**entry["setting"]), flights)


def fly_all(names: str, n: int, hard_n: int, workers: int) -> list[dict]:
    """Fly the wanted rows; the others stay as they were measured."""
    before = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.is_file() else []
    versions = ", ".join(f"{name} {version(name)}" for name in ("mavfi", "numba", "numpy", "mujoco-core"))
    stored = []
    for setting in [*PAPER, *HARD, *REPORTED]:
        old = next((entry for entry in before if entry["setting"] == asdict(setting)), None)
        if names not in setting.command(0):
            stored += [old] if old is not None else []
            continue
        start = time.perf_counter()
        row = fly_row(setting, n if setting in PAPER else hard_n, workers)
        stored.append({
            "setting": asdict(setting), "flights": [asdict(flight) for flight in row.flights],
            "date": date.today().isoformat(), "versions": versions,
        })  # fmt: skip
        sys.stdout.write(f"{line(cells(row))}  {time.perf_counter() - start:.0f} s\n")
        for flight in row.failures():
            sys.stdout.write(f"  {failure(row, flight)}\n")
        sys.stdout.flush()
    return stored


def main() -> None:
    """Fly, print, write."""
    n, workers = int(os.environ.get("N", "300")), int(os.environ.get("WORKERS", str(os.cpu_count() or 1)))
    stored = fly_all(os.environ.get("ONLY", ""), n, int(os.environ.get("HARD_N", "100")), workers)
    RECORD.parent.mkdir(exist_ok=True)
    RECORD.write_text(json.dumps(stored) + "\n", encoding="utf-8")
    PAGE.write_text(page(stored), encoding="utf-8")
    sys.stdout.write(f"wrote {PAGE.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()
