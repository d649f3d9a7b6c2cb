"""Modelled computers: latency of a kernel's result in simulated time."""

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


def redo_latency(platform: PlatformConfig, kernel: str, stage: Stage) -> int:
    """Cost of recomputing after an alarm on a kernel's result (us): its stage's; 0 on the flight controller."""
    return 0 if KERNELS[kernel].on_flight_controller else stage_latency(platform, stage)


def stage_latency(platform: PlatformConfig, stage: Stage) -> int:
    """Cost of rerunning a stage (us)."""
    return sum(latency(platform, kernel) for kernel in STAGE_KERNELS[stage])
