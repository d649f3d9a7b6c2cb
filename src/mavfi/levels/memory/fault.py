"""The planned change of a word in the memory of a kernel, plug-in or detector."""

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from mavfi.errors import BadInputError, not_known
from mavfi.faults import strata
from mavfi.faults.changes import Change
from mavfi.faults.fault import Fault, is_detector
from mavfi.faults.operations import VALUE_OPERATIONS, check_number_operation
from mavfi.states import KERNELS, PLUG_INS, WATCHING


@dataclass(frozen=True, slots=True)
class MemoryFault(Fault):
    """One bit of a word in a kernel's memory, at an instant or for some time; or another change of the word.

    Attributes:
        kernel: As in `states.KERNELS`, or in `states.WATCHING`: a detector; or the name of a plug-in.
        field: Name of the word, e.g. "decisions.acted_seq" (see `pipeline.words`).
        index: Index of the word if several share the name.
        dtype: Type of the word: "f8", "f4", "i8", "i4", "i2", "u8", "u1" or "?".
        time_us: Injected before the steps of this instant; `NO_SITE` = the golden run had no such word.
        bit: Bit to flip; None = null fault: the whole path through the injector with an empty mask, unless there is a
            `change`.
        stratum: Stratum of the draw, e.g. "sign_exponent" (see faults/strata.py), "" = whole words.
        weight: Probability that a bit drawn from the whole words of its target falls in the stratum.
        seed: Seed of the draw.
        lasts_s: Time for which the word is changed before the steps of every control period, also after restarts of
            its node: the bit is stuck at its flipped value (s); "inf" = for ever.
        change: What is done to the word instead, and in which control periods from `time_us` on; stored as text, e.g.
            "set=nan:times=3@0"; None = the bit is flipped.
        role: Kind of the plug-in, as in `states.PLUG_INS`; "" = a kernel or detector of mavfi.

    Raises:
        BadInputError: Unknown kernel, type or bit, or a change that the word does not allow.
    """

    level: ClassVar[Literal["memory"]] = "memory"
    later_fields: ClassVar[tuple[str, ...]] = ("lasts_s", "change", "role")
    kernel: str
    field: str
    index: int | None = None
    dtype: str = "f8"
    time_us: int = 0
    bit: int | None = None
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0
    lasts_s: float = 0.0
    change: Change | None = None
    role: str = ""

    def __post_init__(self) -> None:
        owner = self.kernel
        owners = (*KERNELS, *WATCHING)
        if self.role:
            owner = self.role
            owners = tuple(PLUG_INS)
        for value, allowed in ((owner, owners), (self.dtype, strata.WORD_BITS)):
            if value not in allowed:
                raise BadInputError(f"fault in {self.site}: {not_known(value, allowed)}")
        bits = strata.WORD_BITS[self.dtype]
        if self.bit is not None and not 0 <= self.bit < bits:
            raise BadInputError(f"fault in {self.site}: bit {self.bit}; allowed: 0 to {bits - 1}")
        if not self.lasts_s >= 0.0:
            raise BadInputError(f"fault in {self.site}: lasts_s: {self.lasts_s}: allowed: 0 or more")
        if self.change is not None:
            self._check_change(self.change)

    def _check_change(self, change: Change) -> None:
        """Check that the word can be changed in this way."""
        where = f"fault in {self.site}"
        operation = change.operation
        when = change.when
        if operation.name not in VALUE_OPERATIONS:
            raise BadInputError(f"{where}: {operation.name}: of whole messages; allowed: {', '.join(VALUE_OPERATIONS)}")
        if (self.bit is None) is (operation.name == "flip") or operation.bit is not None:
            raise BadInputError(f"{where}: bit: {self.bit}: allowed: of a flip, and none of another operation")
        if when.condition is not None or when.first > 1:
            raise BadInputError(f"{where}: @{when}: no message arrives in memory; allowed: instants (s)")
        if operation.name != "freeze":
            try:
                check_number_operation(replace(operation, bit=self.bit), self.dtype)
            except BadInputError as error:
                raise BadInputError(f"{where}: {error}") from None

    @property
    def is_lasting(self) -> bool:
        """Whether the word may be changed in more than one control period."""
        return self.lasts_s > 0.0 or (self.change is not None and self.change.when.times != 1)

    @property
    def site(self) -> str:
        """Kernel, field and index as text."""
        if self.index is None:
            return f"memory:{self.kernel}.{self.field}"
        return f"memory:{self.kernel}.{self.field}[{self.index}]"

    @property
    def bit_class(self) -> str:
        """Class of the bit in the word's type; "" for a null fault."""
        if self.bit is None:
            return ""
        return strata.bit_class(self, self.bit)

    @property
    def in_detector(self) -> bool:
        """See `Fault.in_detector`."""
        return is_detector(self.kernel, self.role)
