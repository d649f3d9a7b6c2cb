"""A row of the speed table, with an optional target, and the name of the measured processor."""

import platform
from pathlib import Path
from typing import NamedTuple


class Row(NamedTuple):
    """A measurement in words; `ratio` is compared with `target`, an upper limit if `at_most`."""

    what: str
    value: str
    ratio: float | None = None
    target: float | None = None
    at_most: bool = False

    @property
    def verdict(self) -> str:
        """The target and whether it was met; empty without a target."""
        if self.ratio is None or self.target is None:
            return ""
        met = self.ratio <= self.target if self.at_most else self.ratio >= self.target
        sign = "≤" if self.at_most else "≥"
        return f"{sign} {self.target:g}: {'met' if met else 'not met'}"


def processor() -> str:
    """Name of the processor, as reported by the system."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
