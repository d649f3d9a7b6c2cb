"""Reasons why a kernel is not instrumented, or a fault not injected: always an error, never a silent omission."""

from mavfi.errors import MavfiError


class RefusedError(MavfiError):
    """The kernel has a construct that cannot be instrumented exactly."""

    def __init__(self, kernel: str, construct: str) -> None:
        super().__init__(f"{kernel}: cannot be instrumented: {construct}")
        self.kernel = kernel
        self.construct = construct


class BuildError(MavfiError):
    """The compiler crashed on the instrumented module."""


class MismatchError(MavfiError):
    """The fault was drawn for other machine code: other source or compiler."""


class AllocationError(MavfiError):
    """An injected kernel requested more memory than available."""
