"""The planned change of a field in publications of an inter-kernel state."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

from mavfi.errors import BadInputError
from mavfi.faults import strata
from mavfi.faults.changes import Change
from mavfi.faults.fault import Fault, FaultSite
from mavfi.faults.fields import find_field
from mavfi.faults.operations import VALUE_OPERATIONS, check_number_operation
from mavfi.levels.state.carriers import is_length
from mavfi.states import STATES, find_state

LIFETIME: Mapping[str, float | int] = {"lasts_s": 0.0, "share": 1.0, "width": 1, "times": 1}
"""Defaults of the duration and width of a `StateFault`."""


@dataclass(frozen=True, slots=True)
class StateFault(Fault):
    """A bit of a field in one publication of an inter-kernel state, or in several; or another change of its value.

    Attributes:
        where: State, field, element.
        time_us: The first publication at or after this instant is changed (of those that consumers act on); `NO_SITE`
            = the golden run has no site for the drawn field, which is reported and never redrawn.
        bit: Bit to flip; None = null fault: the whole path through the injector with an empty mask, unless there is a
            `change`.
        stratum: Stratum of the draw, e.g. "sign_exponent" (see faults/strata.py), "" if the bit was given.
        weight: Probability that a bit drawn from the whole word falls in the stratum, for whole-word rates.
        seed: Seed of the draw.
        lasts_s: Time for which the bit is stuck at its flipped value, in every publication (s); "inf" = for ever.  Of a
            `change`: time from the first changed publication on in which others are changed.
        share: Probability that a publication after the first one is changed, drawn by the seed; 1 = all.
        width: Number of adjacent bits to flip, starting at `bit`.
        times: Least number of publications, including recomputed ones, in which the bit is stuck.
        also: Further fields of the same publication, each with its flipped bit; only of a fault in one bit of one
            publication.
        change: What is done to the value instead, and in which publications from `time_us` on; stored as text, e.g.
            "set=nan:times=3@0"; None = the bit is flipped.

    Raises:
        BadInputError: A number out of range, a further field that cannot be changed with the first one, or a change
            that the field does not allow.
    """

    level: ClassVar[Literal["state"]] = "state"
    later_fields: ClassVar[tuple[str, ...]] = ("also", "change", *LIFETIME)
    where: FaultSite
    time_us: int = 0
    bit: int | None = None
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0
    lasts_s: float = 0.0
    share: float = 1.0
    width: int = 1
    times: int = 1
    also: tuple[tuple[str, int], ...] = ()
    change: Change | None = None

    def __post_init__(self) -> None:
        for key, is_allowed, allowed in (
            ("lasts_s", self.lasts_s >= 0.0, "0 or more"),
            ("share", 0.0 < self.share <= 1.0, "above 0, to 1"),
            ("width", self.width >= 1, "1 or more"),
            ("times", self.times >= 1, "1 or more"),
        ):
            if not is_allowed:
                raise BadInputError(f"fault in {self.site}: {key}: {getattr(self, key)}: allowed: {allowed}")
        if self.also:
            self._check_also()
        if self.change is not None:
            self._check_change(self.change)

    def _check_change(self, change: Change) -> None:
        """Check that the field can be changed in this way; the error names the field."""
        where = f"fault in {self.site}"
        operation = change.operation
        spec = find_state(self.where.state)
        if operation.name not in VALUE_OPERATIONS:
            raise BadInputError(f"{where}: {operation.name}: of whole publications; allowed: message:{spec.name}:...")
        if self.of_length:
            raise BadInputError(f"{where}: {operation.name}: is the length of a list; allowed: flips of a bit")
        if self.times != 1 or self.share != 1.0 or self.width != 1 or self.also or change.when.start_s > 0.0:
            raise BadInputError(f"{where}: times, share, width, also: allowed: those of the change {operation}")
        has_bit = self.bit is not None
        is_flip = operation.name == "flip"
        if has_bit is not is_flip or operation.bit is not None:
            raise BadInputError(f"{where}: bit: {self.bit}: allowed: of a flip, and none of another operation")
        if operation.name != "freeze":
            dtype = spec.find(self.where.field).dtype
            try:
                check_number_operation(replace(operation, bit=self.bit), dtype)
            except BadInputError as error:
                raise BadInputError(f"{where}: {error}") from None
        if change.when.condition is not None:
            find_field(spec, change.when.condition.field)

    def _check_also(self) -> None:
        """Check that further fields are in the same list element or header, and changed once; see `StateFault`."""
        where = f"fault in {self.site}: also"
        if self.bit is None or any(getattr(self, key) != default for key, default in LIFETIME.items()):
            raise BadInputError(f"{where}: {len(self.also)} further fields: allowed: in one bit of one publication")
        # The fields of the same container, by name.
        spec = find_state(self.where.state)
        in_elements = spec.in_elements(self.where.field)
        others = {field.name: field for field in spec.fields if spec.in_elements(field.name) == in_elements}
        others.pop(self.where.field, None)
        if self.of_length:
            others = {}
        for name, bit in self.also:
            if name not in others:
                allowed = ", ".join(others) or "none"
                raise BadInputError(f"{where}: {name!r}: no other field, or named twice; allowed: {allowed}")
            bits = strata.WORD_BITS[others.pop(name).dtype]
            if not 0 <= bit < bits:
                raise BadInputError(f"{where}: {name}: bit {bit}; allowed: 0 to {bits - 1}")

    @property
    def lasting(self) -> bool:
        """Whether more than one publication is changed."""
        if self.change is not None:
            return self.change.when.times != 1
        return self.times > 1 or self.lasts_s > 0.0

    @property
    def is_null(self) -> bool:
        """Whether nothing is changed: a null fault."""
        return self.bit is None and self.change is None

    @property
    def counts_publications(self) -> bool:
        """Whether it depends on the number of publications since the start of the flight."""
        return self.change is not None and self.change.when.counts_messages

    @property
    def of_length(self) -> bool:
        """Whether it changes the length of a list in the serialized state, and so may lose it."""
        return is_length(STATES[self.where.state], self.where.field)

    @property
    def changed_state(self) -> str:
        """See `Fault.changed_state`."""
        return self.where.state

    @property
    def site(self) -> str:
        """State, field and element as text."""
        return str(self.where)

    @property
    def dtype(self) -> str:
        """NumPy's name of the field's type."""
        return STATES[self.where.state].find(self.where.field).dtype

    @property
    def bit_class(self) -> str:
        """Class of the bit in the field's type; "" for a null fault."""
        if self.bit is None:
            return ""
        return strata.bit_class(self, self.bit)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; an unknown field or bit is a BadInputError."""
        fault = super(StateFault, cls).from_json(data)  # `super()` alone finds no class: slots make another one
        find_state(fault.where.state).find(fault.where.field)  # refuses an unknown field
        bits = strata.WORD_BITS[fault.dtype]
        if fault.bit is not None and not 0 <= fault.bit <= bits - fault.width:
            raise BadInputError(f"fault in {fault.site}: bit {fault.bit}; allowed: 0 to {bits - fault.width}")
        return fault
