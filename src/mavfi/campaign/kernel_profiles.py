"""What golden runs of a kernel campaign counted: dynamic instructions of each kernel, in all and by source line."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from mavfi.campaign.plan import PHASE_GOLDEN
from mavfi.campaign.store import Store

KEY = "kernels"
"""Where a golden run's record holds them."""


@dataclass(frozen=True, slots=True)
class KernelProfile:
    """What one kernel did in one golden flight.

    Attributes:
        kernel: Name, as in `mavfi.states.INJECTABLE`.
        environment: Of the flight.
        seed: Of the flight.
        instructions: Dynamic instructions that can be struck, over the whole mission.
        calls: Of its functions.
        lines: Source file, line, and dynamic instructions there (the innermost line of inlined calls).
    """

    kernel: str
    environment: str
    seed: int
    instructions: int
    calls: int
    lines: tuple[tuple[str, int, int], ...]


def read_kernel_profiles(store: Store) -> dict[str, list[KernelProfile]]:
    """Profiles of all golden flights by kernel, in the order of the plan; empty where no kernels were struck."""
    found: dict[str, list[KernelProfile]] = {}
    for profile in _profiles(store):
        found.setdefault(profile.kernel, []).append(profile)
    return found


def _profiles(store: Store) -> Iterator[KernelProfile]:
    for run in store.runs(PHASE_GOLDEN, done=True):
        counted: dict[str, Any] = (run.record or {}).get(KEY, {})
        for kernel, data in counted.items():
            lines = tuple((str(file), int(line), int(count)) for file, line, count in data["lines"])
            yield KernelProfile(
                kernel, run.spec.environment, run.spec.seed, data["instructions"], data["calls"], lines
            )  # fmt: skip
