"""Writes docs/generated/sensors.md, what failing sensors and motors do to missions, from a campaign's ledger.

mavfi campaign run sensors --scale paper --out out/sensors
python -m tools.sensor_faults out/sensors
"""

import sys
from pathlib import Path

from tools.campaign_page import write

TEXT = (
    "Each fails from a random instant of the flight to its end, one of eight types in equal shares. What the types "
    "are, and how they are injected: [fault model](../fault-model.md#sensors-and-motors)."
)
VIEWS = ("by_unit", "by_failure", "by_unit_and_environment")


if __name__ == "__main__":
    write("sensors", Path(sys.argv[1]), "Failing sensors and motors", TEXT, VIEWS)
