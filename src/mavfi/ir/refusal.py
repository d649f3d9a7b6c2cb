"""Reasons why the IR of a kernel is not rewritten: always an error, never a silent omission."""

from mavfi.errors import MavfiError


class RefusedError(MavfiError):
    """The kernel has a construct that cannot be instrumented exactly."""

    def __init__(self, kernel: str, construct: str) -> None:
        super().__init__(f"{kernel}: cannot be instrumented: {construct}")
        self.kernel = kernel
        self.construct = construct


class BuildError(MavfiError):
    """The compiler crashed on the rewritten module."""
