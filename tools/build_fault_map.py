"""Write docs/generated/fault-map.md from a ledger, and copy its key rows to docs/generated/golden-rates.md.

python -m tools.build_fault_map out/fault_map
"""

import sys
from datetime import date
from pathlib import Path

import polars as pl

from mavfi.api import load
from mavfi.campaign.analysis.measures import FAILS_OR_SLOWER, rate_of
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.statistics import Rate
from mavfi.errors import BadInputError
from tools.markers import GENERATED, banner, fill

FAULT_MAP = GENERATED / "fault-map.md"
GOLDEN_RATES = GENERATED / "golden-rates.md"
KEYS = ("way-point", "time_to_collision", "trajectory epochs", "command")
"""Initial words of the rows that are copied to golden-rates.md."""

HEAD = """# Fault map: what one flipped bit does, by site

Faults on the design seeds, flown again (`make fault-map`) after every change of a rule of `published`: a change that
makes golden flights better and faults invisible would show here. The autopilot profiles were tuned on these seeds, so
these figures are not for publication; the campaigns `table1` and `states` fly other seeds.

"""
FOOT = """
Brackets: Wilson's 95 % interval. If a golden flight never publishes the state, its fault counts as one without effect.

How to read it next to the paper (MAVFI, sections III-B and III-C):

- **Way-point in force.** A sign or exponent flip of a position sends the vehicle off its course; the reference clock
  waits for it (slowed on saturation, at most ×10), so the error lasts seconds. As in the paper, way-point coordinates
  and velocities matter, and mantissa bits do not. Yaw only turns the camera.
- **time_to_collision** decides between a stop and a replacement in flight: a wrong value costs time, rarely a mission.
- **future_collision_seq** is robust in its low bits, as the paper found: consumers accept any growth. A flip of its
  sign bit, or of the collision flag, loses the one-shot alarm, and the vehicle flies on blind.
- **Sequence numbers of a trajectory** are among the most dangerous numbers: one upward flip makes consumers reject all
  later plans or alarms. The paper does not show them; no detector of the paper watches them.
- **Path vertices** matter while their plan is flown; many are replaced before.
- **Cloud points and voxels** have no effect: neighbours and the next scan repair them, the paper's first finding.
- **Commands** last for 20 ms and are bounded by the flight controller: nearly harmless at state level, unlike the
  paper's instruction-level result for control.
"""
COLUMNS = """| injected | n | missions that fail, % | that fail or take > 5 % longer, % | worst time |
| --- | ---: | ---: | ---: | ---: |
"""


def percent(rate: Rate) -> str:
    """A rate with its interval, in integer per cent."""
    return f"{100 * (rate.rate or 0.0):.0f} [{100 * (rate.low or 0.0):.0f}, {100 * (rate.high or 0.0):.0f}]"


def row(target: str, own: Runs) -> str:
    """One row: site, n, failures and delays with their intervals, worst flight time.

    Args:
        target: Name of the site.
        own: The site's judged runs.
    """
    fails, hurt = rate_of(own.adding(failed=~pl.col("success")), "failed"), rate_of(own, FAILS_OR_SLOWER)
    worst = max((value for value in own["inflation"] if value is not None), default=0.0)
    return f"| {target} | {len(own)} | {percent(fails)} | {percent(hurt)} | {100 * worst:+.0f} % |\n"


def page(runs: Runs, today: str) -> str:
    """The complete page.

    Args:
        runs: Runs of the campaign `fault_map`.
        today: Date of the page.
    """
    c = runs.campaign
    origin = (
        f"Autopilot profile `{c['profile']}`, {', '.join(c['environments'])}, {c['missions']} missions (seeds "
        f"{c['seeds'][0]} to {c['seeds'][1]}), {today}, mavfi {c['versions']['mavfi']}, digest "
        f"`{c['digest'][:16]}`.\n\n"
    )
    groups = runs.injected.where("judged").groups("target").items()
    return (
        banner("make fault-map")
        + HEAD
        + origin
        + COLUMNS
        + "".join(row(str(target), own) for (target,), own in groups)
        + FOOT
    )


def key_lines(fault_map: str) -> str:
    """The part copied to golden-rates.md: origin, table head, and key rows.

    Args:
        fault_map: The text of fault-map.md.
    """
    heads = ("Autopilot profile `", "| injected", "| ---", *(f"| {key}" for key in KEYS))
    origin, *table = [line for line in fault_map.splitlines() if line.startswith(heads)]
    return "\n".join([origin, "", *table])


def main(out: Path) -> int:
    """Update the pages from the folder of a ledger; returns the exit code."""
    try:
        runs = load(out)
    except BadInputError as error:
        print(f"{error}; run `make fault-map`", file=sys.stderr)
        return 2
    text = page(runs, date.today().isoformat())
    FAULT_MAP.write_text(text, encoding="utf-8")
    fill(GOLDEN_RATES, {"faults": key_lines(text)})
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/fault_map")))
