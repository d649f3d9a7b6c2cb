r"""Writes docs/generated/detector-faults.md, faults in detectors, from campaigns' ledgers.

mavfi campaign run detector_memory --scale paper --out out/detector-memory
mavfi campaign run detector_memory_others --scale paper --out out/detector-memory-others
mavfi campaign run detector_instructions --scale paper --out out/detector-instructions
mavfi campaign run failure_rate --scale paper --out out/failure-rate
mavfi bench detectors --part instruction --scale paper --out out/bench-paper
mavfi bench detectors --part instruction --out out/bench-quick
python -m tools.detector_faults out/detector-memory out/detector-memory-others out/detector-instructions \
    out/failure-rate out/bench-paper/instruction out/bench-quick/instruction

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
    "A detector may lose a mission, or delay it by needless recomputation; no mission has another fault."
)
OTHERS = (
    "The same number of faults in what each further detector remembers, in the flight that it watches; "
    "`gaussian_tuned` has the physics gate in front, into which these faults are injected."
)
INSTRUCTIONS = (
    "One bit of the result of one instruction of a detector flips, drawn over all that it executes in a flight. "
    "The same number of faults in each detector whose code is compiled, in the flight that it watches; "
    "`gaussian_tuned` has the physics gate in front: "
    "[failures per flight hour](../models.md#failures-per-flight-hour)."
)
VIEWS, FAILURES = ("by_target", "outcomes"), ("failures_per_hour",)


def content(memory: Path, others: Path, instructions: Path, *kernels: Path) -> str:
    """The page, from the ledgers of its three campaigns, and of others with faults in kernels."""
    pages = [
        page(memory, "make detector-faults", "Faults in detectors", MEMORY, VIEWS),
        section(others, "## Memory of other detectors", OTHERS, VIEWS),
        section(instructions, "## Instructions of every detector", INSTRUCTIONS, FAILURES),
    ]
    if kernels:
        pages.append(detector_payoff.section([load(instructions)], [load(ledger) for ledger in kernels]))
    return "\n".join(pages)


if __name__ == "__main__":
    (GENERATED / "detector-faults.md").write_text(content(*map(Path, sys.argv[1:])), encoding="utf-8")
