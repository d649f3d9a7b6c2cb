"""Faults and a detector at the RPC boundary: in the arguments that the server receives, and in its return values.

A fault is text, `CALL.PATH[:bit=B][@SECONDS]` or `CALL.PATH:bit=B#N`: a bit of one number in the first call of this
name at or after an instant, or in its N-th.  PATH leads through the arguments by name (`moveByVelocity.vx`,
`moveOnPath.path.0.x_val`) or, after `return`, through the returned value (`simGetVehiclePose.return.position.z_val`);
`arguments#K` and `return#K` are the K-th number of all.  A bit is one of the type in AirSim's signature: an argument
that the program gives as 2 is flipped as the double 2.0.

Other operations follow the site, `CALL.PATH:set=nan@10..12`, or the call alone, `CALL:drop:times=3@10` (see
`mavfi.faults.operations`).  A dropped call is not executed and has the answer of the last one; a delayed one is
executed later in simulated time; a duplicated one is executed again; a frozen one has the arguments of the first one,
and its answer, unless it is a task.  Calls are answered in the order in which they come, so none is reordered.

A failure of the vehicle's sensors or motors, `sensor:UNIT:TYPE@SECONDS`, changes what calls measure and do.
"""

import random
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TextIO

from mavfi.errors import BadInputError, not_known
from mavfi.extras.airsim import cameras, flying, scene, sensing
from mavfi.extras.airsim.calls import RecordedCall
from mavfi.extras.airsim.table import CALLS
from mavfi.extras.shared.foreign import Monitor, NamedNumbers, train
from mavfi.faults.fault import MessageFault
from mavfi.faults.levels.sensor.failures import Failure
from mavfi.faults.levels.sensor.fault import SensorFault
from mavfi.faults.levels.state_injector import schedule_of
from mavfi.faults.operations import MessageSchedule, Operation, PlannedChange, changed_number, parse_text
from mavfi.levels.sensor import parse_sensor
from mavfi.record import AlarmRecord, Injection

# ---- numbers in arguments and return values --------------------------------------------------------------------------
Path = tuple[str | int, ...]
_WORD = 64


def count(value: Any) -> int:
    """Number of numbers in a value."""
    if isinstance(value, (bool, int, float)):
        return 1
    if isinstance(value, bytes):
        return len(value)
    if isinstance(value, dict):
        return sum(map(count, value.values()))
    if isinstance(value, list):
        return sum(map(count, value))
    return 0


def path_of(value: Any, number: int) -> Path | None:
    """Path of the n-th number, from 0; None if there are fewer."""
    if isinstance(value, (bool, int, float)):
        if number == 0:
            return ()
        return None
    if isinstance(value, bytes):
        if number < len(value):
            return (number,)
        return None
    for key, item in _items(value):
        inside = count(item)
        if number < inside:
            path = path_of(item, number)
            if path is None:
                return None
            return (key, *path)
        number -= inside
    return None


def leaves(value: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a value with its path; bytes are left out."""
    if isinstance(value, (bool, int, float)):
        yield prefix, float(value)
        return
    for key, item in _items(value):
        path = str(key)
        if prefix:
            path = f"{prefix}.{key}"
        yield from leaves(item, path)


def _items(value: Any) -> Iterable[tuple[Any, Any]]:
    """Keys and members of a map or a list; none of anything else."""
    if isinstance(value, dict):
        return value.items()
    if isinstance(value, list):
        return enumerate(value)
    return ()


def keys_of(text: str) -> Path:
    """A path from text, e.g. "0.x_val"."""
    return tuple(int(part) if part.isdecimal() else part for part in text.split(".") if part)


def make_double(holder: Any, path: Path) -> None:
    """Turn the integer at a path, if there is one, into a double of the same value; in place."""
    *outer, last = path
    try:
        for key in outer:
            holder = holder[key]
        if type(holder[last]) is int:  # a boolean stays one
            holder[last] = float(holder[last])
    except (KeyError, IndexError, TypeError):
        pass


_WIDTHS = {"?": 1, "i8": _WORD, "f8": _WORD, "u1": 8}
"""Number of bits by NumPy's name of a type."""


def dtype_of(value: Any) -> str:
    """NumPy's name of the type of a number; a number of bytes is "u1"."""
    if isinstance(value, bool):
        return "?"
    if isinstance(value, int):
        return "i8"
    return "f8"


def flipped(value: Any, bit: int) -> Any:
    """A number with one bit flipped."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        (word,) = struct.unpack("<q", struct.pack("<Q", (value & (2**_WORD - 1)) ^ (1 << bit)))
        return word
    (raw,) = struct.unpack("<Q", struct.pack("<d", value))
    return struct.unpack("<d", struct.pack("<Q", raw ^ (1 << bit)))[0]


class ReplacedNumber(NamedTuple):
    """A value in which one number was replaced.

    Attributes:
        holder: The value that holds the number, changed; lists and maps are changed in place.
        before: The number before.
        after: The number after.
    """

    holder: Any
    before: Any
    after: Any


Replace = Callable[[Any, str], Any]
"""The number in the place of another one, given that and NumPy's name of its type."""


def replace_number(holder: Any, path: Path, replacement: Replace) -> ReplacedNumber:
    """Replace the number at a path.

    Raises:
        BadInputError: There is no number at this path, or it cannot be replaced so.
    """
    if not path:
        if not isinstance(holder, (bool, int, float)):
            raise BadInputError("not a number")
        after = replacement(holder, dtype_of(holder))
        return ReplacedNumber(after, holder, after)
    key, *rest = path
    if isinstance(holder, bytes) and isinstance(key, int) and key < len(holder):
        changed = bytearray(holder)
        changed[key] = replacement(holder[key], "u1")
        return ReplacedNumber(bytes(changed), holder[key], changed[key])
    try:
        inner = holder[key]
    except (KeyError, IndexError, TypeError):
        raise BadInputError(f"no number at {key!r}") from None
    replaced = replace_number(inner, tuple(rest), replacement)
    holder[key] = replaced.holder
    return replaced._replace(holder=holder)


class BoundaryFlip(NamedTuple):
    """What a flipped bit has done.

    Attributes:
        holder: The value that holds the number, changed; lists and maps are changed in place.
        before: The number before.
        after: The number after.
        bit: The flipped bit: the requested one modulo the width of the number.
    """

    holder: Any
    before: Any
    after: Any
    bit: int


def flip(holder: Any, path: Path, bit: int) -> BoundaryFlip:
    """Flip a bit of the number at a path.

    Raises:
        BadInputError: There is no number at this path.
    """
    bits: list[int] = []

    def flip_one(number: Any, dtype: str) -> Any:
        bits.append(bit % _WIDTHS[dtype])
        if dtype == "u1":
            return number ^ (1 << bits[0])
        return flipped(number, bits[0])

    replaced = replace_number(holder, path, flip_one)
    return BoundaryFlip(*replaced, bits[0])


_MODULES = cameras, flying, scene, sensing  # register the calls that faults name


# ---- the boundary ----------------------------------------------------------------------------------------------------
ARGUMENTS = "arguments"
RETURN = "return"
_PATH = rf"(?:{ARGUMENTS}|{RETURN})#\d+|\w+(?:\.\w+)*"
_TEXT = re.compile(
    rf"(?P<call>\w+)\.(?P<path>{_PATH})(?::bit=(?P<bit>\d+))?(?:@(?P<at>[\d.eE+-]+)|#(?P<nth>[1-9]\d*))?"
)
_CHANGE = re.compile(rf"(?P<call>\w+)(?:\.(?P<path>{_PATH}))?:(?P<change>[a-z][^#]*)")
"""Another operation than the flip of one bit, or another trigger."""
_BITS = 64
_FORM = (
    "CALL.PATH[:bit=B][@SECONDS] or CALL[.PATH]:OPERATION[@INSTANT], e.g. moveByVelocity.vx:bit=62@10, "
    "simGetVehiclePose.return.position.z_val, moveByVelocity.vx:set=nan@10..12 or moveByVelocity:drop:times=3@10"
)
_MAX_OBSERVED_NUMBERS = 16
"""Values with more numbers (images, point clouds) are not observed."""


@dataclass(frozen=True, slots=True)
class BoundaryFault:
    """A fault in calls, or in a number that passes in them."""

    fault: MessageFault

    @property
    def in_return(self) -> bool:
        """Whether it is in a returned value, not in an argument or in the whole call."""
        return re.match(rf"{RETURN}\b", self.fault.field) is not None

    def path_in(self, value: Any) -> Path | None:
        """Path of its number in the arguments or in the returned value; None if there is none."""
        head, _, rest = self.fault.field.partition(".")
        side, _, number = head.partition("#")
        if number:
            return path_of(value, int(number))
        if side == RETURN:
            return keys_of(rest)
        return (CALLS[self.fault.topic].arguments.index(side), *keys_of(rest))

    def named(self, path: Path) -> str:
        """A path as text, which names the argument, not its number."""
        if self.in_return:
            names: tuple[str | int, ...] = (RETURN, *path)
        else:
            names = (CALLS[self.fault.topic].arguments[int(path[0])], *path[1:])
        return ".".join(map(str, names))


def parse_fault(text: str, seed: int = 0) -> BoundaryFault | SensorFault:
    """Read a fault; a bit that is not given is drawn from the seed.

    Raises:
        BadInputError: It has another form, or names a call, argument or bit that does not exist.
    """
    if text.startswith(f"{SensorFault.level}:"):
        return parse_sensor(text, seed)
    match = _TEXT.fullmatch(text)
    if match is None:
        return _parse_change(text, seed)

    # check each part
    name = match["call"]
    path = match["path"]
    bit = match["bit"]
    at = match["at"]
    _check_site(text, name, path)
    try:
        since_s = float(at or 0.0)
    except ValueError:
        since_s = -1.0
    if not 0.0 <= since_s < 1e6:
        raise BadInputError(f"--fault: {text!r}: @{at}: allowed: 0 to 1e6 s")
    if bit is not None and int(bit) >= _BITS:
        raise BadInputError(f"--fault: {text!r}: bit {bit}: allowed: 0 to {_BITS - 1}")

    # what the text leaves out: a bit drawn from the seed, in the first call
    if bit is None:
        bit_number = random.Random(seed).randrange(_BITS)
    else:
        bit_number = int(bit)
    nth = int(match["nth"] or 1)
    return BoundaryFault(MessageFault(name, path, bit_number, nth, seed=seed, time_us=round(1e6 * since_s)))


def _check_site(text: str, name: str, path: str) -> None:
    """Refuse a call or argument that does not exist; `path`: "" = the whole call."""
    if name not in CALLS:
        raise BadInputError(f"--fault: {text!r}: call {name!r}: not known; allowed: calls of docs/how-to/airsim.md")
    head = path.partition(".")[0]
    arguments = CALLS[name].arguments
    if head and "#" not in head and head not in (*arguments, RETURN):
        raise BadInputError(f"--fault: {text!r}: {not_known(head, [*arguments, RETURN])}")


def _parse_change(text: str, seed: int) -> BoundaryFault:
    """Read a fault with another operation than one flip of a bit, or with another trigger."""
    match = _CHANGE.fullmatch(text)
    if match is None:
        raise BadInputError(f"--fault: {text!r}: allowed: {_FORM}")
    path = match["path"] or ""
    _check_site(text, match["call"], path)
    try:
        change = parse_text(match["change"])
        operation, when = change
        if operation.name == "reorder":
            raise BadInputError("reorder: calls are answered in order; allowed: drop, delay, duplicate, freeze")
        if operation.name == "flip" and operation.bit is None:
            operation = replace(operation, bit=random.Random(seed).randrange(_BITS))
        if operation.bit is not None and operation.bit >= _BITS:
            raise BadInputError(f"bit {operation.bit}: allowed: 0 to {_BITS - 1}")
        planned = PlannedChange(operation, replace(when, start_s=0.0))
        fault = MessageFault(match["call"], path, seed=seed, time_us=round(1e6 * when.start_s), change=planned)
    except BadInputError as error:
        raise BadInputError(f"--fault: {text!r}: {error}") from None
    return BoundaryFault(fault)


@dataclass(frozen=True, slots=True)
class PassedCall:
    """A call that passed the boundary: its name, and the numbers in its arguments and its return value."""

    name: str
    arguments: int
    returned: int


@dataclass
class Boundary:
    """The RPC boundary, which every call passes.

    Attributes:
        planned: The fault; None = none.
        keeps: Whether calls are recorded.
        watch: A detector; None = none.
        recording: Keeps the numbers that pass, e.g. to train a detector; None = none.
        failure: The failure of a sensor or motor of the vehicle; None = none.
        vehicle: The vehicle whose calls are changed and watched; "" = the first one.
        injection: The injection into a call that happened; None = none so far.
        passed: Every call so far, if `keeps`.
    """

    planned: BoundaryFault | None = None
    keeps: bool = False
    watch: "BoundaryWatch | None" = None
    recording: "ApiRecording | None" = None
    failure: Failure | None = None
    vehicle: str = ""
    injection: Injection | None = None
    passed: list[PassedCall] = field(default_factory=list)
    _count: int = 0
    _schedule: MessageSchedule | None = field(init=False, default=None)
    _frozen: dict[str, Any] = field(init=False, default_factory=dict)  # first value of what is frozen, by side
    _last_answer: Any = field(init=False, default=None)

    def __post_init__(self) -> None:
        planned = self.planned
        if planned is not None and planned.fault.change is not None:
            fault = planned.fault
            self._schedule = schedule_of(fault.planned.when, fault.time_us, fault.seed)

    @property
    def delays(self) -> bool:
        """Whether calls are delayed, for which simulated time must be able to pass."""
        return self.planned is not None and self.planned.fault.planned.operation.name == "delay"

    @classmethod
    def of(
        cls,
        fault: BoundaryFault | MessageFault | SensorFault | None,
        watch: "BoundaryWatch | None" = None,
        recording: "ApiRecording | None" = None,
    ) -> "Boundary":
        """The boundary with a fault, in a call or in the vehicle behind it."""
        if isinstance(fault, SensorFault):
            return cls(watch=watch, recording=recording, failure=Failure(fault))
        if isinstance(fault, MessageFault):
            fault = BoundaryFault(fault)
        return cls(fault, watch=watch, recording=recording)

    @property
    def faulty(self) -> bool:
        """Whether there is a fault."""
        return self.planned is not None or self.failure is not None

    @property
    def injected(self) -> Injection | None:
        """The injection that happened, into a call or the vehicle."""
        if self.failure is None:
            return self.injection
        return self.failure.injection

    def arguments(self, name: str, values: list[Any], now_us: int) -> list[Any]:
        """Arguments of a call, perhaps changed, in place."""
        self._inject(name, values, now_us, in_return=False)
        self._observe(f"{name}({ARGUMENTS})", dict(zip(CALLS[name].arguments, values, strict=False)), now_us)
        return values

    def returned(self, name: str, arguments: Sequence[Any], value: Any, now_us: int) -> Any:
        """Return value of a call, perhaps changed."""
        if self.keeps:
            self.passed.append(PassedCall(name, sum(map(count, arguments)), count(value)))
        value = self._inject(name, value, now_us, in_return=True)
        if self.planned is not None and name == self.planned.fault.topic:
            self._last_answer = value
        self._observe(f"{name}({RETURN})", value, now_us)
        return value

    # ---- whole calls ------------------------------------------------------------------------------------------------
    def operation_on(self, name: str, arguments: Sequence[Any], now_us: int) -> Operation | None:
        """What happens to a call as a whole; None = it is served as usual."""
        planned = self.planned
        if planned is None or planned.fault.field or self._schedule is None or name != planned.fault.topic:
            return None
        values = dict(zip(CALLS[name].arguments, arguments, strict=False))
        if not self._is_due(values, now_us):
            return None
        operation = planned.fault.planned.operation
        self._record(now_us, None, None, None, operation, {})
        return operation

    @property
    def last_answer(self) -> Any:
        """What the last call with the name of the fault was answered; None = there was none."""
        return self._last_answer

    def freeze(self, side: str, value: Any) -> Any:
        """What a frozen call has in the place of its arguments or its answer: those of the first one.

        Args:
            side: `ARGUMENTS` or `RETURN`.
            value: Those of this call.
        """
        return deepcopy(self._frozen.setdefault(side, deepcopy(value)))

    # ---- numbers in calls -------------------------------------------------------------------------------------------

    def _observe(self, source: str, value: Any, now_us: int) -> None:
        for observer in (self.recording, self.watch):
            if observer is not None:
                observer.check(source, value, now_us)

    def _inject(self, name: str, value: Any, now_us: int, *, in_return: bool) -> Any:
        """Flip the planned bit (a null fault: twice) in its call; without such a number the fault is not activated."""
        # whether this is the call of the fault, and has its number
        planned = self.planned
        if planned is None or in_return != planned.in_return:
            return value
        if self._schedule is not None:
            return self._change(planned, name, value, now_us)
        if self.injection is not None:
            return value
        fault = planned.fault
        if name != fault.topic or now_us < fault.time_us or not fault.field:
            return value
        self._count += 1
        if self._count < fault.at:
            return value
        path = planned.path_in(value)
        if path is None:
            return value

        # flip; a client may send a whole number where AirSim's signature has a double
        if not in_return and CALLS[name].is_double(path):
            make_double(value, path)
        try:
            flipped_once = flip(value, path, fault.bit or 0)
            after = flipped_once.after
            value = flipped_once.holder
            if fault.bit is None:
                flipped_back = flip(value, path, flipped_once.bit)
                after = flipped_back.after
                value = flipped_back.holder
        except BadInputError:
            return value

        # the injection of a null fault has no bit
        bit = None
        if fault.bit is not None:
            bit = flipped_once.bit
        self.injection = Injection(
            "message",
            fault.site,
            1e-6 * now_us,
            bit,
            flipped_once.before,
            after,
            True,
            details={"call": fault.topic, "number": self._count, "path": planned.named(path)},
        )
        return value

    def _change(self, planned: BoundaryFault, name: str, value: Any, now_us: int) -> Any:
        """The value with another number where the fault is due; without such a number it is as it was."""
        fault = planned.fault
        assert self._schedule is not None  # precondition
        if name != fault.topic or not fault.field:
            return value
        values = value
        if not planned.in_return:
            values = dict(zip(CALLS[name].arguments, value, strict=False))
        if not self._is_due(values, now_us):
            return value
        path = planned.path_in(value)
        if path is None:
            self._schedule.take_back()
            return value
        if not planned.in_return and CALLS[name].is_double(path):
            make_double(value, path)
        operation = fault.planned.operation

        def replacement(number: Any, dtype: str) -> Any:
            if operation.name == "freeze":
                return self._frozen.setdefault(fault.field, number)
            if operation.name == "flip":
                assert operation.bit is not None  # drawn before
                return changed_number(replace(operation, bit=operation.bit % _WIDTHS[dtype]), number, dtype)
            return changed_number(operation, number, dtype)

        try:
            replaced = replace_number(value, path, replacement)
        except BadInputError:
            self._schedule.take_back()
            return value
        details = {"path": planned.named(path)}
        self._record(now_us, operation.bit, replaced.before, replaced.after, operation, details)
        return replaced.holder

    def _is_due(self, values: Any, now_us: int) -> bool:
        """Whether the fault changes this call, whose numbers a condition may read."""
        assert self._schedule is not None  # precondition
        self._count += 1
        return self._schedule.due(now_us / 1e6, lambda path: dict(leaves(values)).get(path, float("nan")))

    def _record(
        self, now_us: int, bit: int | None, before: Any, after: Any, operation: Operation, details: dict[str, Any]
    ) -> None:
        """Record the first changed call, and the number of changed ones."""
        assert self.planned is not None and self._schedule is not None  # precondition
        fault = self.planned.fault
        if self.injection is None:
            details = {"call": fault.topic, "number": self._count, "operation": str(operation), **details}
            self.injection = Injection(
                "message", fault.site, 1e-6 * now_us, bit, before, after, activated=True, details=details
            )
        changed = {**self.injection.details, "calls": self._schedule.changed}
        self.injection = replace(self.injection, details=changed)


class BoundaryWatch:
    """A detector that observes the numbers at the boundary, without effect on them.

    Args:
        name: Name of the detector.
        monitor: Trained on error-free calls, see `ApiRecording.train`.

    Attributes:
        alarms: So far.
    """

    def __init__(self, name: str, monitor: Monitor) -> None:
        self._name = name
        self._monitor = monitor
        self.alarms: list[AlarmRecord] = []
        monitor.start()

    def check(self, source: str, value: Any, now_us: int) -> None:
        """Check one value."""
        alarm = self._monitor.judge(NamedNumbers(source, now_us, dict(leaves(value))))
        if alarm is not None:
            self.alarms.append(
                AlarmRecord(1e-6 * now_us, self._name, source, "", alarm.score, alarm.fields, "none", "observed")
            )


class ApiRecording:
    """Values at the boundary, e.g. error-free ones to train a detector.

    Args:
        file: Each call is written to it as it comes; None = to none.
    """

    def __init__(self, file: TextIO | None = None) -> None:
        self._calls: list[RecordedCall] = []
        self._file = file

    def check(self, source: str, value: Any, now_us: int) -> None:
        """Record one value."""
        numbers = dict(leaves(value))
        if 0 < len(numbers) <= _MAX_OBSERVED_NUMBERS:
            call = RecordedCall.of(now_us, source, numbers)
            self._calls.append(call)
            if self._file is not None:
                self._file.write(call.line())

    def train(self, kind: str, profile: str) -> BoundaryWatch:
        """A detector trained on the calls that were made often enough; `BadInputError` if there is none."""
        calls = [NamedNumbers(call.topic, call.time_us, call.values) for call in self._calls]
        return BoundaryWatch(kind, train(kind, profile, [calls]))
