"""The deterministic host: every flight in this process, on integer microseconds."""

from mavfi.hosts.host import Flight
from mavfi.hosts.local.flight import fly

__all__ = ["Flight", "fly"]
