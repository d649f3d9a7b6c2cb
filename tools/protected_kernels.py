"""Writes docs/generated/protected.md, protected kernels with a detector and its restarts, from a campaign's ledger.

mavfi campaign run protected --scale paper --out out/protected
python -m tools.protected_kernels out/protected
"""

import sys
from pathlib import Path

from tools.campaign_page import write

TEXT = (
    "Faults in instructions of the flown kernels, in plain and in protected code, without and with a detector and the "
    "restart policy that goes with it. `ten_percent` is the plan for 10 % of a flight's kernel time, `full` protects "
    "some kernels in full ([hardening](../hardening.md)); `recommended` is the acceptance test with its recovery "
    "([models](../models.md#recommended))."
)
VIEWS = ("kernel_effects_by_setting", "schemes_instructions", "failures_per_hour")


if __name__ == "__main__":
    write("protected", Path(sys.argv[1]), "Protected kernels, a detector, and restarts", TEXT, VIEWS)
