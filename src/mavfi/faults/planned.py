"""Base of the planned faults of all levels."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Self

from mavfi.config import checked

NO_SITE = -1
"""`StateFault.time_us` or `InstructionFault.call` of a draw for which the golden run has no site."""


@dataclass(frozen=True, slots=True)
class Planned:
    """Common base of all levels."""

    level: ClassVar[str]

    @property
    def has_site(self) -> bool:
        """Whether there is a value to change, as far as known before the run."""
        return getattr(self, "time_us", 0) != NO_SITE

    @property
    def bit_class(self) -> str:
        """Meaning of the bit, e.g. "exponent"; "" if unknown."""
        return ""

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"level": self.level, **asdict(self)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        return checked(cls, data, f"fault of level {cls.level}")
