"""A row of the table of speeds, with the target where there is one."""

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
