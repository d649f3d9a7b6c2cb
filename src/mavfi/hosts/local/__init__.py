"""The deterministic host: all flights run in this process, in integer microseconds."""

from mavfi.hosts.host import Flight
from mavfi.hosts.local.flight import fly

__all__ = ["Flight", "fly"]
