"""Writes docs/generated/hit-detectors.md, faults in detectors alone and in copies, from two campaigns' ledgers.

mavfi campaign run detector_memory --scale paper --out out/detector-memory
mavfi campaign run replicas --scale paper --out out/replicas
python -m tools.hit_detectors out/detector-memory out/replicas
"""

import sys
from pathlib import Path

from tools.campaign_page import page, section
from tools.markers import GENERATED

MEMORY = (
    "One bit of what a detector remembers between publications flips, drawn by exposure over all that it stores. "
    "`_x2`, `_x3`: two or three copies that vote, of which the first is hit "
    "([copies](../models.md#recommended)). A detector may lose a mission, or delay it by needless recomputation; no "
    "mission has another fault."
)
INSTRUCTIONS = (
    "One bit of the result of one instruction of a detector flips, drawn over all that it executes in a flight. "
    "Failures per flight hour count the instructions that copies add, which a share of harmful faults does not: "
    "[failures per flight hour](../models.md#failures-per-flight-hour)."
)


VIEWS = ("by_target", "outcomes")


def content(memory: Path, instructions: Path) -> str:
    """The page."""
    first = page(memory, "make hit-detectors", "Faults in detectors", MEMORY, VIEWS)
    return f"{first}\n{section(instructions, '## Instructions of detectors', INSTRUCTIONS, ('failures_per_hour',))}"


if __name__ == "__main__":
    (GENERATED / "hit-detectors.md").write_text(content(Path(sys.argv[1]), Path(sys.argv[2])), encoding="utf-8")
