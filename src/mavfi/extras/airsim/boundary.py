"""Faults and a detector at the RPC boundary: in the arguments that the server receives, and in its return values.

A fault in a number is text, `CALL.PATH[:CHANGE]`, one in whole calls `CALL:CHANGE`.  PATH leads through the arguments
by name (`moveByVelocity.vx`, `moveOnPath.path.0.x_val`) or, after `return`, through the returned value
(`simGetVehiclePose.return.position.z_val`); `arguments#K` and `return#K` are the K-th number of all.  CHANGE is what
`mavfi.faults.changes` describes, `set=nan@10..12` or `bit=62#3` (`#N` is short for `@n=N`); without one, a bit that is
drawn flips in the first call.  A bit is one of the type in AirSim's signature, modulo its width: an argument that the
program gives as 2 is changed as the double 2.0.

A dropped call is not executed and has the answer of the last one; a delayed one is executed later in simulated time; a
duplicated one is executed again; a frozen one has the arguments of the first one, and its answer, unless it is a task.
Calls are answered in the order in which they come, so none is reordered.

A failure of the vehicle's sensors or motors, `sensor:UNIT:TYPE@SECONDS`, changes what calls measure and do.
"""

import random
import re
from collections.abc import Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, TextIO

import numpy as np

from mavfi.errors import BadInputError, not_known
from mavfi.extras.airsim import cameras, flying, scene, sensing
from mavfi.extras.airsim.calls import RecordedCall
from mavfi.extras.airsim.table import CALLS
from mavfi.extras.shared.foreign import Monitor, NamedNumbers, train
from mavfi.faults.changes import LATEST_S, Change, ChangeInjector, ValueChange, When, parse_change
from mavfi.faults.operations import Operation
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.sensor import parse_sensor
from mavfi.levels.sensor.failures import Failure
from mavfi.levels.sensor.fault import SensorFault
from mavfi.record import AlarmRecord, Injection

# ---- numbers in arguments and return values --------------------------------------------------------------------------
Path = tuple[str | int, ...]


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


def dtype_of(number: Any) -> str:
    """NumPy's name of the type of a number."""
    if isinstance(number, bool):
        return "?"
    if isinstance(number, int):
        return "i8"
    return "f8"


class CallNumber:
    """A number in the arguments or the returned value of a call: what a change reads and writes.

    Args:
        container: A list with the value, which is changed in place; bytes in it are replaced.
        path: Of the number in the list.
        is_double: Whether AirSim's signature has a double there, which a client may send as a whole number.

    Raises:
        BadInputError: There is no number at this path.
    """

    def __init__(self, container: Any, path: Path, *, is_double: bool) -> None:
        self._key: Any
        *outer, self._key = path
        self._holders = [container]
        self._outer = outer
        try:
            for key in outer:
                self._holders.append(self._holders[-1][key])
            number = self._holders[-1][self._key]
        except (KeyError, IndexError, TypeError):
            raise BadInputError("no number at this path") from None
        if not isinstance(number, (bool, int, float)):
            raise BadInputError("not a number")
        self._number = number
        self.dtype = dtype_of(number)
        if isinstance(self._holders[-1], bytes):
            self.dtype = "u1"
        elif is_double and self.dtype == "i8":
            self.dtype = "f8"

    @property
    def bits(self) -> int:
        """Number of its bits; a flag has one."""
        if self.dtype == "?":
            return 1
        return 8 * np.dtype(self.dtype).itemsize

    def read(self) -> np.ndarray:
        """The number. Shape (1,)."""
        return np.array([self._number]).astype(self.dtype)

    def write(self, word: np.ndarray) -> None:
        """Replace it. Shape (1,)."""
        number = word[0].item()
        holder = self._holders[-1]
        if isinstance(holder, bytes):
            changed = bytearray(holder)
            changed[self._key] = number
            self._holders[-2][self._outer[-1]] = bytes(changed)
        else:
            holder[self._key] = number


_MODULES = cameras, flying, scene, sensing  # register the calls that faults name


# ---- the boundary ----------------------------------------------------------------------------------------------------
ARGUMENTS = "arguments"
RETURN = "return"
_PATH = rf"(?:{ARGUMENTS}|{RETURN})#\d+|\w+(?:\.\w+)*"
_TEXT = re.compile(
    rf"(?P<call>\w+)(?:\.(?P<path>{_PATH}))?(?::(?P<operations>[a-z][^@#]*))?(?:@(?P<instant>.+)|#(?P<nth>[1-9]\d*))?"
)
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
    try:
        return BoundaryFault(_parse(text, seed))
    except BadInputError as error:
        raise BadInputError(f"--fault: {text!r}: {error}") from None


def _parse(text: str, seed: int) -> MessageFault:
    """The fault of a text, in a number or in whole calls."""
    # the site: a call, an argument or the returned value
    match = _TEXT.fullmatch(text)
    if match is None or not (match["path"] or match["operations"]):
        raise BadInputError(f"allowed: {_FORM}")
    name = match["call"]
    path = match["path"] or ""
    if name not in CALLS:
        raise BadInputError(f"call {name!r}: not known; allowed: calls of docs/how-to/airsim.md")
    head = path.partition(".")[0]
    sides = [*CALLS[name].arguments, RETURN]
    if head and "#" not in head and head not in sides:
        raise BadInputError(not_known(head, sides))

    # the change; a bit that is not given is drawn
    instant = match["instant"] or ""
    if match["nth"]:
        instant = f"n={match['nth']}"
    change = parse_change((match["operations"] or "flip").split(":"), instant)
    operation = change.operation
    when = change.when
    if operation.name == "reorder":
        raise BadInputError("reorder: calls are answered in order; allowed: drop, delay, duplicate, freeze")
    if operation.name == "flip" and operation.bit is None:
        operation = replace(operation, bit=random.Random(seed).randrange(_BITS))
    if operation.bit is not None and operation.bit >= _BITS:
        raise BadInputError(f"bit {operation.bit}: allowed: 0 to {_BITS - 1}")
    if when.start_s > LATEST_S:
        raise BadInputError(f"@{instant}: allowed: 0 to {LATEST_S:g} s")
    time_us = round(1e6 * when.start_s)

    # one flip of one bit is a fault without a change, as those that campaigns draw
    is_one_flip = operation.name == "flip" and change == Change(change.operation, When(when.first, when.start_s))
    if is_one_flip and (when.first == 1 or match["nth"]):
        return MessageFault(name, path, operation.bit, when.first, seed=seed, time_us=time_us)
    planned = change._replace(operation=operation, when=replace(when, start_s=0.0))
    return MessageFault(name, path, seed=seed, time_us=time_us, change=planned)


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
    _injector: ChangeInjector = field(init=False)
    _frozen: dict[str, Any] = field(init=False, default_factory=dict)  # first value of what is frozen, by side
    _last_answer: Any = field(init=False, default=None)

    def __post_init__(self) -> None:
        if self.planned is not None:
            fault = self.planned.fault
            change = fault.planned
            self._injector = ChangeInjector.of(change._replace(when=change.when.starting_at(fault.time_us)), fault.seed)

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
        if fault is None or isinstance(fault, BoundaryFault):
            return cls(fault, watch=watch, recording=recording)
        if fault.level == SensorFault.level:
            return cls(watch=watch, recording=recording, failure=Failure(fault))
        return cls(BoundaryFault(fault), watch=watch, recording=recording)

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
        if planned is None or planned.fault.field or name != planned.fault.topic:
            return None
        if not self._is_due(dict(zip(CALLS[name].arguments, arguments, strict=False)), now_us):
            return None
        self._record(now_us, None, (None, None), {})
        return planned.fault.planned.operation

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
        """The value, with another number where the fault is due; without such a number it is as it was."""
        # whether this is a call of the fault
        planned = self.planned
        if planned is None or in_return != planned.in_return or name != planned.fault.topic or not planned.fault.field:
            return value
        numbers = value
        if not in_return:
            numbers = dict(zip(CALLS[name].arguments, value, strict=False))
        if not self._is_due(numbers, now_us):
            return value

        # change its number; a null fault, a flip without a bit, changes it to itself
        path = planned.path_in(value)
        operation = planned.fault.planned.operation
        bit = operation.bit
        container = [value]
        try:
            if path is None:
                raise BadInputError("no such number")
            is_double = not in_return and CALLS[name].is_double(path)
            number = CallNumber(container, (0, *path), is_double=is_double)
            if bit is not None:
                bit %= number.bits
                self._injector.value = ValueChange(replace(operation, bit=bit))
            values = self._injector.change(number)
        except BadInputError:  # this call has no such number, or one of a type that cannot be changed so
            self._injector.take_back()
            return value
        self._record(now_us, bit, values, {"path": planned.named(path)})
        return container[0]

    def _is_due(self, values: Any, now_us: int) -> bool:
        """Whether the fault changes this call, whose numbers a condition may read."""
        self._count += 1
        return self._injector.due(now_us, lambda path: dict(leaves(values)).get(path, float("nan")))

    def _record(self, now_us: int, bit: int | None, values: tuple[Any, Any], details: dict[str, Any]) -> None:
        """Record the first changed call and, unless it is the only one, the number of changed ones."""
        assert self.planned is not None  # precondition
        fault = self.planned.fault
        if fault.change is not None:
            details = {"operation": str(fault.change.operation), **details}
        if self.injection is None:
            details = {"call": fault.topic, "number": self._count, **details}
            self.injection = Injection("message", fault.site, 1e-6 * now_us, bit, *values, True, details=details)
        if fault.change is not None:
            changed = {**self.injection.details, "calls": self._injector.changed}
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
