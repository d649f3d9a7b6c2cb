"""Writes docs/generated/sensors.md, what failing sensors and motors do to missions, from a campaign's ledger.

mavfi campaign run sensors --scale paper --out out/sensors
python -m tools.sensor_faults out/sensors
"""

import sys
from pathlib import Path

from mavfi.api import load, table
from mavfi.campaign.analysis.findings import findings
from mavfi.reports.campaign_report import markdown_table
from mavfi.reports.text import header
from tools.markers import GENERATED, banner

PAGE = GENERATED / "sensors.md"
VIEWS = ("by_unit", "by_failure", "by_unit_and_environment")


def page(ledger: Path) -> str:
    """The page, from a ledger of the campaign `sensors`."""
    runs = load(ledger)
    lines = [
        banner("make sensors").strip(), "", "# Failing sensors and motors", "",
        "Each fails from a random instant of the flight to its end, one of eight types in equal shares. What the types "
        "are, and how they are injected: [fault model](../fault-model.md#sensors-and-motors).", "",
        *(f"- {line}" for line in (*header(runs.campaign), *findings(runs))), "",
        *(f"{markdown_table(table(runs, name))}\n" for name in VIEWS),
    ]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(Path(sys.argv[1])), encoding="utf-8")
    sys.stdout.write(f"wrote {PAGE.name}\n")
