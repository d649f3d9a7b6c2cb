"""Put the fault map that a campaign measured between the markers of fault-map.md, its key lines into golden-rates.md.

    python -m docs.build_fault_map out/fault_map

The figures are those of the report's summary.json; none is ever typed.
"""

import json
import sys
from pathlib import Path
from typing import Any

from docs.build_pages import between

FAULT_MAP = Path(__file__).with_name("fault-map.md")
GOLDEN_RATES = Path(__file__).with_name("golden-rates.md")
KEYS = ("way-point", "time_to_collision", "trajectory epochs", "command")
"""What a row begins with that stands beside the golden table."""


def row(entry: dict[str, Any]) -> str:
    """One row: what was struck, n, failures and delays with their intervals, worst flight time."""
    hurt = entry["fails_or_slower"]
    cells = (
        entry["target"],
        str(entry["n"]),
        f"{100 * (1 - entry['rate']):.0f} [{100 * (1 - entry['high']):.0f}, {100 * (1 - entry['low']):.0f}]",
        f"{100 * hurt['rate']:.0f} [{100 * hurt['low']:.0f}, {100 * hurt['high']:.0f}]",
        f"{100 * entry['worst_inflation']:+.0f} %",
    )
    return "| " + " | ".join(cells) + " |"


def key_lines(page: str) -> str:
    """What stands beside the golden table: provenance, head of the table, and the key rows.

    Args:
        page: fault-map.md.
    """
    _, _, after = page.partition("<!-- map:begin -->\n")
    block = after.partition("<!-- map:end -->")[0].splitlines()
    heads = ("Stack", "| struck", "| ---", *(f"| {key}" for key in KEYS))
    kept = [line for line in block if line.startswith(heads) or not line]
    return "\n".join(kept).strip()


def main(out: Path) -> int:
    """Update the pages from a folder that a report was written to; returns the exit code."""
    summary = out / "summary.json"
    if not summary.is_file():
        print(f"{summary}: not there; run `make fault-map`", file=sys.stderr)
        return 2
    data = json.loads(summary.read_text(encoding="utf-8"))
    c = data["campaign"]
    lines = [
        f"Stack `{c['stack']}`, {', '.join(c['environments'])}, {c['flights']} missions (seeds {c['seeds'][0]} to "
        f"{c['seeds'][1]}), {data['date']}, mavfi {c['versions']['mavfi']}, digest `{c['digest'][:16]}`.",
        "",
        "| struck | n | missions that fail, % | that fail or take > 5 % longer, % | worst time |",
        "| --- | ---: | ---: | ---: | ---: |",
        *(row(entry) for entry in data["by_target"] if entry["setting"] == "fi" and entry["n"]),
    ]
    page = between(FAULT_MAP.read_text(encoding="utf-8"), "map", "\n".join(lines) + "\n")
    FAULT_MAP.write_text(page, encoding="utf-8")
    beside = GOLDEN_RATES.read_text(encoding="utf-8")
    GOLDEN_RATES.write_text(between(beside, "faults", key_lines(page)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/fault_map")))
