"""Modelled computers: latency of results in simulated time."""

import hashlib

from mavfi.config import PlatformConfig
from mavfi.errors import BadInputError
from mavfi.states import KERNELS, STAGE_KERNELS, Stage


def latency(platform: PlatformConfig, kernel: str) -> int:
    """Latency of a kernel (us); `BadInputError` if the platform does not define it."""
    if KERNELS[kernel].on_flight_controller:
        return 0
    try:
        return platform.latency_us[kernel]
    except KeyError:
        raise BadInputError(
            f"platform {platform.name}: key 'latency_us': no kernel {kernel!r}; it has {', '.join(platform.latency_us)}"
        ) from None


def stage_latency(platform: PlatformConfig, stage: Stage) -> int:
    """Cost of rerunning a stage (us)."""
    return sum(latency(platform, kernel) for kernel in STAGE_KERNELS[stage])


class Latencies:
    """Latencies as charged in a flight (us).

    On a real computer a kernel takes another time in each run.  With a jitter j, each latency is therefore multiplied
    by a factor drawn uniformly from 1 / (1 + j) to 1 + j.  The factor is a hash of seed, kernel and instant: no
    generator has a state that a checkpoint would have to contain.

    Args:
        platform: The computer.
        seed: Seed of the mission.
        jitter: The jitter j; 0 = none.
    """

    def __init__(self, platform: PlatformConfig, seed: int = 0, jitter: float = 0.0) -> None:
        self._platform = platform
        self._seed = seed
        self._jitter = jitter

    def of_kernel(self, kernel: str, now: int) -> int:
        """Latency of a kernel's step at an instant (us)."""
        nominal_us = latency(self._platform, kernel)
        if self._jitter == 0.0:
            return nominal_us
        return round(nominal_us * self._factor(kernel, now))

    def of_stage(self, stage: Stage, now: int) -> int:
        """Cost of rerunning a stage at an instant (us)."""
        return sum(self.of_kernel(kernel, now) for kernel in STAGE_KERNELS[stage])

    def of_recomputation(self, kernel: str, stage: Stage, now: int) -> int:
        """Cost of recomputing after an alarm on a kernel's result: its stage's; 0 on the flight controller."""
        if KERNELS[kernel].on_flight_controller:
            return 0
        return self.of_stage(stage, now)

    def _factor(self, kernel: str, now: int) -> float:
        """Latency / nominal latency of a kernel's step at an instant (us)."""
        digest = hashlib.blake2b(f"{self._seed} {kernel} {now}".encode(), digest_size=8).digest()
        share = (int.from_bytes(digest, "little") >> 11) / 2**53  # as many bits as a float has, in [0, 1)
        longest = 1.0 + self._jitter
        shortest = 1.0 / longest
        return shortest + (longest - shortest) * share
