r"""Writes docs/generated/detector-faults.md, faults in detectors, in copies and in recovery, from campaigns' ledgers.

mavfi campaign run detector_memory --scale paper --out out/detector-memory
mavfi campaign run detector_memory_others --scale paper --out out/detector-memory-others
mavfi campaign run recovery_memory --scale paper --out out/recovery-memory
mavfi campaign run replicas --scale paper --out out/replicas
mavfi campaign run detector_instructions --scale paper --out out/detector-instructions
mavfi campaign run recovery_instructions --scale paper --out out/recovery-instructions
mavfi campaign run failure_rate --scale paper --out out/failure-rate
mavfi bench detectors --part instruction --scale paper --out out/bench-paper
mavfi bench detectors --part instruction --out out/bench-quick
python -m tools.detector_faults out/detector-memory out/detector-memory-others out/recovery-memory out/replicas \
    out/detector-instructions out/recovery-instructions out/failure-rate out/bench-paper/instruction \
    out/bench-quick/instruction

The last three, or any others with faults in kernels, say whether detectors pay for their own instructions.
"""

import sys
from pathlib import Path

from mavfi.api import load
from tools import detector_payoff
from tools.campaign_page import page, section
from tools.markers import GENERATED

MEMORY = (
    "One bit of what a detector remembers between publications flips, drawn by exposure over all that it stores. "
    "`_x2`, `_x3`: two or three copies that vote, of which the first is injected "
    "([copies](../models.md#recommended)). A detector may lose a mission, or delay it by needless recomputation; no "
    "mission has another fault."
)
OTHERS = (
    "The same number of faults in what each further detector remembers, in the flight that it watches; "
    "`gaussian_tuned` has the physics gate in front, into which these faults are injected."
)
WAITING = (
    "Faults in what recovery remembers under `recommended`: remaining restarts, whether it has silenced the detector, "
    "instants of alarms, the wait for a path."
)
INSTRUCTIONS = (
    "One bit of the result of one instruction of a detector flips, drawn over all that it executes in a flight. "
    "Failures per flight hour count the instructions that copies add, which a share of harmful faults does not: "
    "[failures per flight hour](../models.md#failures-per-flight-hour)."
)
EVERY = (
    "The same number of faults in each detector whose code is compiled, in the flight that it watches; "
    "`gaussian_tuned` has the physics gate in front."
)
RECOVERY = (
    "One bit of the result of one instruction of recovery flips, drawn over all that it executes in a flight: it "
    "checks at every collision status whether the path that answers an alarm is overdue, and selects the response "
    "where there is an alarm (see the alarms on flights without a fault below). A fault may restart the planner's node "
    "without need, or delay the restart of one that is lost."
)
VIEWS, FAILURES = ("by_target", "outcomes"), ("failures_per_hour",)


def content(
    memory: Path, others: Path, waiting: Path, copies: Path, every: Path, recovery: Path, *kernels: Path
) -> str:  # fmt: skip
    """The page, from the ledgers of its six campaigns, and of others with faults in kernels."""
    pages = [page(memory, "make detector-faults", "Faults in detectors", MEMORY, VIEWS)]
    for ledger, title, text, views in (
        (others, "## Memory of other detectors", OTHERS, VIEWS),
        (waiting, "## Memory of recovery", WAITING, VIEWS),
        (copies, "## Instructions of detectors, alone and in copies", INSTRUCTIONS, FAILURES),
        (every, "## Instructions of every detector", EVERY, FAILURES),
        (recovery, "## Instructions of recovery", RECOVERY, FAILURES),
    ):
        pages.append(section(ledger, title, text, views))
    if kernels:
        pages.append(detector_payoff.section([load(copies), load(every)], [load(ledger) for ledger in kernels]))
    return "\n".join(pages)


if __name__ == "__main__":
    (GENERATED / "detector-faults.md").write_text(content(*map(Path, sys.argv[1:])), encoding="utf-8")
