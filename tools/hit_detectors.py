"""Writes docs/generated/hit-detectors.md, faults in detectors alone and in copies, from two campaigns' ledgers.

mavfi campaign run detector_memory --scale paper --out out/detector-memory
mavfi campaign run replicas --scale paper --out out/replicas
python -m tools.hit_detectors out/detector-memory out/replicas
"""

import sys
from pathlib import Path

from tools.campaign_page import page
from tools.markers import GENERATED

NAME = "hit-detectors"
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


def main(memory: Path, instructions: Path) -> None:
    """Write the page."""
    first = page(memory, f"make {NAME}", "Faults in detectors", MEMORY, ("by_target", "outcomes"))
    second = page(instructions, "", "Instructions of detectors", INSTRUCTIONS, ("failures_per_hour",))
    path = GENERATED / f"{NAME}.md"
    path.write_text(f"{first}\n{second[second.index('# ') :].replace('# ', '## ', 1)}", encoding="utf-8")
    print(f"wrote {path.name}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
