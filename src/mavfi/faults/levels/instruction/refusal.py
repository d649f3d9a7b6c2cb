"""Reasons why a fault is not injected: always an error, never a silent omission."""

from mavfi.errors import MavfiError


class MismatchError(MavfiError):
    """The fault was drawn for other machine code: other source or compiler."""


class AllocationError(MavfiError):
    """An injected kernel requested more memory than available."""
