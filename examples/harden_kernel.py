"""Protect a kernel of one's own against silent corruption, and test the protection with fresh faults.

python examples/harden_kernel.py
"""

import numpy as np

from mavfi.campaign.hardening.kernel import certify_function, harden
from mavfi.numerics.jit import kernel_jit
from mavfi.reports.hardening.plain import interval


@kernel_jit
def follow(path: np.ndarray, position: np.ndarray, gain: float, command: np.ndarray) -> float:
    """Velocity towards the nearest point of a path; returns the distance to it."""
    nearest, best = 0, 1e300
    for i in range(len(path)):
        x, y, z = path[i, 0] - position[0], path[i, 1] - position[1], path[i, 2] - position[2]
        distance = x * x + y * y + z * z
        if distance < best:
            nearest, best = i, distance
    for axis in range(3):
        command[axis] = gain * (path[nearest, axis] - position[axis])
    return best**0.5


def main(faults: int = 400, budget: float = 0.5) -> None:
    random = np.random.default_rng(1)
    calls = [(random.normal(size=(30, 3)), random.normal(size=3), 0.8, np.zeros(3)) for _ in range(24)]
    found = harden(follow, calls[:12], budget, faults=2 * faults)
    for step in found.steps:
        print(f"time x{step.time:.2f}: {interval(step.coverage)} of the silent corruptions removed, predicted")
    print(f"chosen: {len(found.planned.sites)} instructions, time x{found.planned.time:.2f}")
    certificate = certify_function(follow, calls[12:], found.planned, faults)
    print(f"fresh faults: {interval(certificate.coverage)}, prediction {certificate.verdict}")
    print("a protected call:", found.code(calls[0])(*calls[0]))


if __name__ == "__main__":
    main()
