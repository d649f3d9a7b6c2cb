"""Modelled computers: what a kernel's result costs in simulated time."""

from mavfi.config import PlatformConfig
from mavfi.errors import BadInputError
from mavfi.states import Stage

STAGE_KERNELS: dict[Stage, tuple[str, ...]] = {
    Stage.PERCEPTION: ("point_cloud", "octomap", "collision_check"),
    Stage.PLANNING: ("planner", "trajectory"),
    Stage.CONTROL: ("pid",),
}
"""Kernels whose latencies make up a stage's (hand-over itself costs nothing)."""


def latency(platform: PlatformConfig, kernel: str) -> int:
    """Latency of a kernel (microseconds).

    Raises:
        BadInputError: The platform does not say.
    """
    try:
        return platform.latency_us[kernel]
    except KeyError:
        raise BadInputError(
            f"platform {platform.name}: key 'latency_us': no kernel {kernel!r}; it has {', '.join(platform.latency_us)}"
        ) from None


def stage_latency(platform: PlatformConfig, stage: Stage) -> int:
    """What running a stage again costs (microseconds)."""
    return sum(latency(platform, kernel) for kernel in STAGE_KERNELS[stage])
