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
UNCHARGED = ("state_estimation",)
"""Kernels that run on the flight controller: some 10 us a step there, nothing on the modelled computer."""


def latency(platform: PlatformConfig, kernel: str) -> int:
    """Latency of a kernel (microseconds).

    Raises:
        BadInputError: The platform does not say.
    """
    if kernel in UNCHARGED:
        return 0
    try:
        return platform.latency_us[kernel]
    except KeyError:
        raise BadInputError(
            f"platform {platform.name}: key 'latency_us': no kernel {kernel!r}; it has {', '.join(platform.latency_us)}"
        ) from None


def redo_latency(platform: PlatformConfig, kernel: str, stage: Stage) -> int:
    """What answering an alarm at a kernel's result costs (microseconds): its stage, or nothing if it is uncharged."""
    return 0 if kernel in UNCHARGED else stage_latency(platform, stage)


def stage_latency(platform: PlatformConfig, stage: Stage) -> int:
    """What running a stage again costs (microseconds)."""
    return sum(latency(platform, kernel) for kernel in STAGE_KERNELS[stage])
