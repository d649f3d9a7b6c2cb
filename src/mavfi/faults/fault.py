"""Planned faults: one type for each level, all pure data.  The resulting event is a `record.Injection`.

Each has `level`, `site` (text), `stratum`, `weight`, `seed`, `bit`, `has_site` and `to_json`; `fault_from_json` reads
all levels.  What a level means (how its faults are written, drawn, injected, made smaller) is in its `mavfi.levels`.
"""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, get_args

from mavfi.config import checked
from mavfi.errors import BadInputError, not_known
from mavfi.faults import DEFAULT_WALK, strata
from mavfi.faults.changes import Change, When, parse_text
from mavfi.faults.levels.transit import is_length
from mavfi.faults.operations import MESSAGE_OPERATIONS, VALUE_OPERATIONS, Operation, check_number_operation
from mavfi.plugins import known, load_object
from mavfi.states import DETECTORS, KERNELS, PLUG_INS, STATES, WATCHING, StateSpec, find_state

GROUP = "mavfi.levels"
"""Entry-point group of fault levels: subclasses of `mavfi.levels.level.Level`."""
SHIPPED = {
    "state": "mavfi.levels.state:StateLevel",
    "memory": "mavfi.levels.memory:MemoryLevel",
    "sensor": "mavfi.levels.sensor:SensorLevel",
    "instruction": "mavfi.levels.instruction:InstructionLevel",
    "message": "mavfi.levels.message:MessageLevel",
    "combined": "mavfi.levels.combined:CombinedLevel",
}
"""Levels of the core, by name."""
NO_SITE = -1
"""`StateFault.time_us` or `InstructionFault.call` of a draw for which the golden run has no site."""
Model = Literal["one_bit", "bits", "random", "zero", "low_byte", "high_bits"]
"""How an instruction fault changes a value, see `plan.plan`."""
MODELS: tuple[Model, ...] = get_args(Model)
"""All of these, the default first."""
RESTART_S = 0.57
"""Restart time of a node after a crash: measured for a ROS 1 node killed and respawned by roslaunch (s)."""
REGISTERS = ("all", "general", "fp")
"""Values of `RegisterFault.registers`."""
ACCESSES = ("either", "read", "write")
"""Values of `RegisterFault.access`."""
LIFETIME: Mapping[str, float | int] = {"lasts_s": 0.0, "share": 1.0, "width": 1, "times": 1}
"""Defaults of the duration and width of a `StateFault`."""
MOST_CALLS = 100
"""Largest `InstructionFault.times`: each of the calls has a process."""
MAX_WALK = 100_000
"""Largest number of instructions in a walk."""
MAX_TIMEOUT_S = 3600.0
"""Longest wait for an injection."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Base of the planned faults of all levels.

    Attributes:
        level: Name of the level.
    """

    level: ClassVar[str]
    if TYPE_CHECKING:  # subclasses have these as fields, each in another order

        @property
        def bit(self) -> int | None:
            """The flipped bit, if there is exactly one that is known before the run."""

        @property
        def stratum(self) -> str:
            """Stratum of the draw; "" = not drawn by stratum."""

        @property
        def weight(self) -> float:
            """Probability that a draw from everything falls in the stratum."""

        @property
        def seed(self) -> int:
            """Seed of the draw."""

    @property
    def site(self) -> str:
        """What is changed, as text."""
        raise NotImplementedError

    @property
    def bit_class(self) -> str:
        """Meaning of the bit, e.g. "exponent"; "" if unknown."""
        return ""

    @property
    def has_site(self) -> bool:
        """Whether there is a value to change, as far as known before the run."""
        return getattr(self, "time_us", 0) != NO_SITE

    @property
    def in_detector(self) -> bool:
        """Whether it is in a detector itself, and so in flights with that detector only."""
        return False

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"level": self.level, **asdict(self)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        return checked(cls, data, f"fault of level {cls.level}")


@dataclass(frozen=True, slots=True)
class FaultSite:
    """A field of an inter-kernel state, and the index of its element if it is in a list."""

    state: str
    field: str
    element: int | None = None

    def __str__(self) -> str:
        if self.element is None:
            return f"{self.state}.{self.field}"
        return f"{self.state}.{self.field}[{self.element}]"


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
        if (self.bit is None) is (operation.name == "flip") or operation.bit is not None:
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
        return self.change is not None and (self.change.when.first > 1 or self.change.when.share < 1.0)

    @property
    def of_length(self) -> bool:
        """Whether it changes the length of a list in the serialized state, and so may lose it."""
        return is_length(STATES[self.where.state], self.where.field)

    @property
    def site(self) -> str:
        """State, field and element as text."""
        return str(self.where)

    @property
    def bit_class(self) -> str:
        """Class of the bit in the field's type; "" for a null fault."""
        field = STATES[self.where.state].find(self.where.field)
        if self.bit is None:
            return ""
        return strata.bit_class(field, self.bit)

    def to_json(self) -> dict[str, Any]:
        """Plain data; keys of `LIFETIME` with default values are omitted, and further fields or a change if none."""
        data = {**Fault.to_json(self), "change": str(self.change)}
        if self.change is None:
            del data["change"]
        data["also"] = [list(flipped) for flipped in self.also]
        if not self.also:
            del data["also"]
        for name, default in LIFETIME.items():
            if data[name] == default:
                del data[name]
        if data.get("lasts_s") == float("inf"):
            data["lasts_s"] = "inf"  # JSON has no infinity
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; an unknown field or bit is a BadInputError."""
        fault = checked(cls, _with_change(data), "fault of level state")
        bits = strata.WORD_BITS[find_state(fault.where.state).find(fault.where.field).dtype]
        if fault.bit is not None and not 0 <= fault.bit <= bits - fault.width:
            raise BadInputError(f"fault in {fault.site}: bit {fault.bit}; allowed: 0 to {bits - fault.width}")
        return fault


def find_field(spec: StateSpec, path: str) -> str:
    """The name of a field in a path such as `vx` or `x[3]`; a BadInputError if the state has none of this name."""
    name, bracket, element = path.partition("[")
    spec.find(name)
    if bracket and not (spec.in_elements(name) and re.fullmatch(r"\d+\]", element)):
        raise BadInputError(f"state {spec.name}: {path!r}: allowed: {name}, or of lists {name}[NUMBER]")
    return name


def _with_change(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Stored data of a fault, with its change read from its text."""
    change = data.get("change")
    if not isinstance(change, str):
        return data
    return {**data, "change": parse_text(change)}


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
        operation, when = change
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
        return _is_in_detector(self.kernel, self.role)

    def to_json(self) -> dict[str, Any]:
        """Plain data; without a duration, a change and a role, if there are none."""
        data = _without_role({**Fault.to_json(self), "change": str(self.change)})
        if self.change is None:
            del data["change"]
        if self.lasts_s == 0.0:
            del data["lasts_s"]
        elif self.lasts_s == float("inf"):
            data["lasts_s"] = "inf"  # JSON has no infinity
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        return checked(cls, _with_change(data), "fault of level memory")


@dataclass(frozen=True, slots=True)
class InstructionFault(Fault):
    """The result of one dynamic instruction in one call of a compiled function, once or in several calls.

    Attributes:
        function: Module and name of a custom function; "" = `kernel` and `entry` name it, wherever its source is.
        ir_sha256: Digest of the IR to which the index refers; other machine code is rejected.
        index: Dynamic index among the values that the call writes, from 0.
        call: Index of the call in the flight, from 0; `NO_SITE` = the kernel executes no such instruction.
        bits: Bits to flip; empty: the whole value is replaced.
        value: Replacement value, as an integer.
        budget: Values that the call may write before it counts as a hang; 0 = three times the fault-free number plus
            10,000.
        which: Class of instructions from which it was drawn.
        model: How the value is changed.
        kernel: Kernel for which it was drawn, as in `states.KERNELS`, or name of a plug-in; "" = a custom function.
        entry: Attribute of `pipeline.functions.KernelFunctions`, or function of the plug-in; "" = a custom function.
        value_class: "floating_point", "integer", "address" or "control".
        restart_s: Time after which a crashed node has restarted (s).
        stratum: Meaning of the bit: "sign", "exponent", "mantissa" or "other"; "" if not drawn.
        weight: Probability of its value class and line in a uniform draw / in this draw; 1 = equal.
        seed: Seed of the draw.
        times: Number of calls, from `call` on, in which the value with this index is changed, also after restarts of
            the node.
        role: Kind of the plug-in, as in `states.PLUG_INS`; "" = a kernel or detector of mavfi.
    """

    level: ClassVar[Literal["instruction"]] = "instruction"
    function: str
    ir_sha256: str
    index: int
    call: int = 0
    bits: tuple[int, ...] = ()
    value: int = 0
    budget: int = 0
    which: str = "all"
    model: Model = "one_bit"
    kernel: str = ""
    entry: str = ""
    value_class: str = ""
    restart_s: float = RESTART_S
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0
    times: int = 1
    role: str = ""

    def __post_init__(self) -> None:
        if not 1 <= self.times <= MOST_CALLS:
            raise BadInputError(f"fault in {self.site}: times: {self.times}: allowed: 1 to {MOST_CALLS}")

    @property
    def site(self) -> str:
        """Kernel and function as text."""
        if self.kernel:
            return f"{self.kernel}.{self.entry}"
        return self.function

    @property
    def bit(self) -> int | None:
        """The flipped bit, if there is exactly one."""
        if len(self.bits) == 1:
            return self.bits[0]
        return None

    @property
    def has_site(self) -> bool:
        """Whether the golden run executed such an instruction."""
        return self.call != NO_SITE

    @property
    def bit_class(self) -> str:
        """Meaning of the bit in the value."""
        return self.stratum

    @property
    def in_detector(self) -> bool:
        """See `Fault.in_detector`."""
        return _is_in_detector(self.kernel, self.role)

    @property
    def counter(self) -> str:
        """Name under which a flight counts the calls of its function."""
        return counter_name(self.kernel, self.role, self.entry)

    @property
    def masks(self) -> tuple[int, int]:
        """Keep and flip masks: the value becomes (value & keep) ^ flip."""
        if self.bits:
            return -1, sum(1 << bit for bit in self.bits)
        return 0, self.value

    def to_json(self) -> dict[str, Any]:
        """Plain data; the value as hexadecimal text, since it may exceed the range of JSON numbers."""
        data = {"level": self.level, **asdict(self), "bits": list(self.bits), "value": hex(self.value)}
        if self.times == 1:
            del data["times"]
        return _without_role(data)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        try:
            value = int(data["value"], 16)
        except (KeyError, TypeError, ValueError):
            raise BadInputError("fault of level instruction: key 'value': allowed: a hexadecimal number") from None
        return checked(cls, {**data, "value": value}, "fault of level instruction")


def counter_name(kernel: str, role: str, entry: str) -> str:
    """Name under which calls of a function are counted; functions of plug-ins may have the names of others."""
    if role:
        return f"{kernel}.{entry}"
    return entry


def _is_in_detector(kernel: str, role: str) -> bool:
    """Whether a kernel, or a plug-in of a role, is a detector."""
    return role == "detector" or (not role and kernel in DETECTORS)


def _without_role(data: dict[str, Any]) -> dict[str, Any]:
    """The plain data of a fault without the key `role`, if it has none, as in ledgers of earlier versions."""
    if not data["role"]:
        del data["role"]
    return data


@dataclass(frozen=True, slots=True)
class MessageFault(Fault):
    """Whole messages, or a number in them: of a state in a flight, a ROS topic, or the calls of a program.

    Attributes:
        topic: Name of the state, topic or call.
        field: Path of a number, e.g. `position[0]`; "" = the whole message.
        bit: 0 = least significant; None = drawn for each injection.
        at: Number of the first message that may be changed, from 1.
        rate: Probability that a message is changed; None = one message, once.
        stratum: Always "": not drawn by stratum.
        weight: Always 1.
        seed: Seed of the choice of messages and bits.
        time_us: Messages before this instant are not changed; `NO_SITE` = the golden run has no such message.
        change: What is done, and to which messages from `time_us` on; stored as text, e.g. "drop:times=3@0"; None =
            `bit` is flipped as `at` and `rate` say.

    Raises:
        BadInputError: A number out of range.
    """

    level: ClassVar[Literal["message"]] = "message"
    topic: str
    field: str = ""
    bit: int | None = None
    at: int = 1
    rate: float | None = None
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0
    time_us: int = 0
    change: Change | None = None

    def __post_init__(self) -> None:
        if self.at < 1:
            raise BadInputError(f"at: {self.at}: allowed: 1 or more")
        if self.rate is not None and not 0.0 < self.rate <= 1.0:
            raise BadInputError(f"rate: {self.rate}: allowed: above 0, to 1")
        if self.change is None:
            return
        operation = self.change.operation
        allowed = MESSAGE_OPERATIONS
        if self.field:
            allowed = VALUE_OPERATIONS
        if operation.name not in allowed:
            raise BadInputError(f"fault in {self.site}: {operation.name}: allowed: {', '.join(allowed)}")
        if self.bit is not None or self.at > 1 or self.rate is not None or self.change.when.start_s > 0.0:
            raise BadInputError(f"fault in {self.site}: bit, at, rate: allowed: those of the change {operation}")

    @property
    def planned(self) -> Change:
        """What is done and when, also of a fault without `change`; a flip without a bit draws one each time."""
        if self.change is not None:
            return self.change
        if self.rate is None:
            return Change(Operation("flip", bit=self.bit), When(first=self.at))
        return Change(Operation("flip", bit=self.bit), When(first=self.at, times=0, share=self.rate))

    @property
    def counts_publications(self) -> bool:
        """Whether it depends on the number of messages since the start."""
        when = self.planned.when
        return when.first > 1 or when.share < 1.0

    @property
    def is_of_flight(self) -> bool:
        """Whether it is in whole messages, as those of flights are."""
        return self.change is not None and not self.field

    @property
    def site(self) -> str:
        """Topic and field as text."""
        if self.field:
            return f"{self.topic}.{self.field}"
        return self.topic

    def to_json(self) -> dict[str, Any]:
        """Plain data; without an instant and a change, if there are none."""
        data = {**Fault.to_json(self), "change": str(self.change)}
        if self.change is None:
            del data["change"]
        if self.time_us == 0:
            del data["time_us"]
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        return checked(cls, _with_change(data), "fault of level message")


@dataclass(frozen=True, slots=True)
class RegisterFault(Fault):
    """One bit of a register that an instruction of a live process reads or writes, once.

    Attributes:
        registers: "general" (including flags), "fp" (XMM and YMM), or "all".
        access: "read": a register that the next instruction reads, injected before it; "write": one that it writes,
            injected after it; or "either".  "" = "either" with a symbol, "read" without.
        symbol: Function at whose next call the target is stopped: its exact name, or a unique part of it.  "" = stop
            at the current instruction.
        thread: Always 0: the busiest thread, or with a symbol the first to call it.
        walk: A random number of instructions below this is single-stepped between stop and injection.  Stops between
            system calls occur at few instructions, always the same (skid); the walk spreads them.  1 = none.
            0 = 16 (`DEFAULT_WALK`) with a symbol, 1 without.
        timeout: Longest wait (s).
        null: Do everything but flip the bit.
        node: ROS node that owns the process; "" = the process is given by its pid.
        time_us: Earliest instant in the flight (us).
        stratum: Always "": not drawn by stratum.
        weight: Always 1.
        seed: Determines all choices but the instant: a free-running process cannot be replayed.

    Raises:
        BadInputError: A value that is not allowed.
    """

    level: ClassVar[Literal["register"]] = "register"
    registers: str = "all"
    access: str = ""
    symbol: str = ""
    thread: int = 0
    walk: int = 0
    timeout: float = 10.0
    null: bool = False
    node: str = ""
    time_us: int = 0
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        # A target that is single-stepped dies with its tracer: no steps unless there is a breakpoint anyway.
        default_access = "read"
        default_walk = 1
        if self.symbol:
            default_access = "either"
            default_walk = DEFAULT_WALK
        object.__setattr__(self, "access", self.access or default_access)
        object.__setattr__(self, "walk", self.walk or default_walk)
        if self.registers not in REGISTERS:
            raise BadInputError(f"registers: {not_known(self.registers, REGISTERS)}")
        if self.access not in ACCESSES:
            raise BadInputError(f"access: {not_known(self.access, ACCESSES)}")
        if not 1 <= self.walk <= MAX_WALK:
            raise BadInputError(f"walk: {self.walk}: allowed: 0 to {MAX_WALK} instructions")
        if not 0.0 < self.timeout <= MAX_TIMEOUT_S:
            raise BadInputError(f"timeout: {self.timeout}: allowed: above 0, to {MAX_TIMEOUT_S:g} s")
        if self.thread:
            raise BadInputError(f"thread: {self.thread}: allowed: 0, the busiest or the first to call the symbol")

    @property
    def steps(self) -> bool:
        """Whether the target is single-stepped."""
        return self.walk > 1 or self.access != "read"

    @property
    def site(self) -> str:
        """Node and kind of register as text."""
        if self.node:
            return f"{self.node}:{self.registers}"
        return self.registers

    @property
    def bit(self) -> None:
        """None: the bit is drawn after the process has stopped."""
        return None


@cache
def find_level(name: str) -> Any:  # noqa: ANN401 - a `mavfi.levels.level.Level`, which imports this module
    """A fault level by name; a BadInputError if there is none."""
    return load_object("level", name, GROUP, SHIPPED)()


@cache
def level_names() -> tuple[str, ...]:
    """Names of all levels, those of the core first."""
    return tuple(dict.fromkeys([*SHIPPED, *sorted(known(GROUP, SHIPPED))]))


def fault_from_json(data: dict[str, Any]) -> Fault:
    """Inverse of `to_json` of any fault; an unknown level is a BadInputError."""
    content: dict[str, Any] = {}
    if isinstance(data, dict):
        content = dict(data)
    level = content.pop("level", None)
    if not isinstance(level, str) or level not in level_names():
        raise BadInputError(f"fault: level {not_known(level, level_names())}")
    fault: Fault = find_level(level).fault.from_json(content)
    return fault
