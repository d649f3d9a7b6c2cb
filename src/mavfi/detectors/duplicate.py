"""Kernel steps computed twice: a request to the host, which compares and votes (`hosts.loop.duplicate`)."""

from collections.abc import Sequence

from mavfi.detectors.chain import Chain
from mavfi.errors import BadInputError
from mavfi.states import KERNELS


class Duplicate(Chain):
    """Requests duplication; checks nothing itself.

    Args:
        kernels: The kernels whose steps are computed twice.

    Raises:
        BadInputError: Unknown kernel.
    """

    def __init__(self, kernels: Sequence[str] = ("collision_check", "trajectory", "waypoint")) -> None:
        super().__init__()
        unknown = [name for name in kernels if name not in KERNELS]
        if unknown:
            raise BadInputError(f"kernels: {', '.join(unknown)}: not known; allowed: {', '.join(KERNELS)}")
        self.duplicates = tuple(kernels)
