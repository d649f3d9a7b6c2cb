"""Write docs/generated/fault-map.md from a report, and its key rows into docs/generated/golden-rates.md.

    python -m tools.build_fault_map out/fault_map

The figures are those of the report's summary.json; none is typed.
"""

import json
import sys
from pathlib import Path
from typing import Any

from tools.markers import GENERATED, banner, fill

FAULT_MAP = GENERATED / "fault-map.md"
GOLDEN_RATES = GENERATED / "golden-rates.md"
KEYS = ("way-point", "time_to_collision", "trajectory epochs", "command")
"""First words of the rows that golden-rates.md repeats."""

HEAD = """# Fault map: what one flipped bit does, by site

Faults on the design seeds, flown again (`make fault-map`) after every change of a rule of `published`: a change that
makes golden flights better and faults invisible would show here. The autopilot profiles were tuned on these seeds, so
these figures are not for publication; the campaigns `table1`, `states` and `bits` fly other seeds.

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
- **Sequence numbers of a trajectory** are the most dangerous numbers: one upward flip makes consumers reject all later
  plans or alarms. The paper does not show them; no detector of the paper watches them.
- **Path vertices** matter while their plan is flown; many are replaced before.
- **Cloud points and voxels** have no effect: neighbours and the next scan repair them, the paper's first finding.
- **Commands** last for 20 ms and are bounded by the flight controller: nearly harmless at state level, unlike the
  paper's instruction-level result for control.
"""
COLUMNS = """| injected | n | missions that fail, % | that fail or take > 5 % longer, % | worst time |
| --- | ---: | ---: | ---: | ---: |
"""


def row(entry: dict[str, Any]) -> str:
    """One row: site, n, failures and delays with their intervals, worst flight time."""
    hurt = entry["fails_or_slower"]
    cells = (
        entry["target"],
        str(entry["n"]),
        f"{100 * (1 - entry['rate']):.0f} [{100 * (1 - entry['high']):.0f}, {100 * (1 - entry['low']):.0f}]",
        f"{100 * hurt['rate']:.0f} [{100 * hurt['low']:.0f}, {100 * hurt['high']:.0f}]",
        f"{100 * entry['worst_inflation']:+.0f} %",
    )
    return "| " + " | ".join(cells) + " |\n"


def page(data: dict[str, Any]) -> str:
    """The whole page.

    Args:
        data: A report's summary.json.
    """
    c = data["campaign"]
    origin = (
        f"Autopilot profile `{c['stack']}`, {', '.join(c['environments'])}, {c['flights']} missions (seeds "
        f"{c['seeds'][0]} to {c['seeds'][1]}), {data['date']}, mavfi {c['versions']['mavfi']}, digest "
        f"`{c['digest'][:16]}`.\n\n"
    )
    rows = (row(entry) for entry in data["by_target"] if entry["setting"] == "fi" and entry["n"])
    return banner("make fault-map") + HEAD + origin + COLUMNS + "".join(rows) + FOOT


def key_lines(fault_map: str) -> str:
    """What golden-rates.md repeats: origin, head of the table, and the key rows.

    Args:
        fault_map: The text of fault-map.md.
    """
    heads = ("Autopilot profile `", "| injected", "| ---", *(f"| {key}" for key in KEYS))
    origin, *table = [line for line in fault_map.splitlines() if line.startswith(heads)]
    return "\n".join([origin, "", *table])


def main(out: Path) -> int:
    """Update the pages from the folder of a report; returns the exit code."""
    summary = out / "summary.json"
    if not summary.is_file():
        print(f"{summary}: not there; run `make fault-map`", file=sys.stderr)
        return 2
    text = page(json.loads(summary.read_text(encoding="utf-8")))
    FAULT_MAP.write_text(text, encoding="utf-8")
    fill(GOLDEN_RATES, {"faults": key_lines(text)})
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/fault_map")))
