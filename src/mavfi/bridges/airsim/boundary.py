"""Faults and a detector at the RPC boundary, on arguments as the server gets them and on values that it returns.

A fault is text, `CALL.PATH[:bit=B][@SECONDS]` or `CALL.PATH:bit=B#N`: a bit of one number in the first call of this
name at or after an instant, or in its N-th.  PATH leads through the arguments by name (`moveByVelocity.vx`,
`moveOnPath.path.0.x_val`) or, after `return`, through the returned value (`simGetVehiclePose.return.position.z_val`);
`arguments#K` and `return#K` are the K-th number of all.

A failure of the vehicle's sensors or motors, `sensor:UNIT:TYPE@SECONDS`, changes what calls measure and do.
"""

import random
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from mavfi.bridges.airsim.table import CALLS, find_call
from mavfi.bridges.airsim.values import Path, count, flip, keys_of, leaves, path_of
from mavfi.detectors.detector import Detector
from mavfi.detectors.foreign import SMALLEST_SAMPLE, foreign_spec, foreign_state, learn
from mavfi.errors import BadInputError
from mavfi.faults.fault import MessageFault
from mavfi.faults.sensor.failures import Failure
from mavfi.faults.sensor.fault import SensorFault
from mavfi.faults.spec import parse_sensor
from mavfi.flight_log import AlarmRecord, Injection

ARGUMENTS, RETURN = "arguments", "return"
_TEXT = re.compile(r"(?P<call>\w+)\.(?P<path>[\w.#]+?)(?::bit=(?P<bit>\d+))?(?:@(?P<at>[\d.eE+-]+)|#(?P<nth>\d+))?")
_BITS = 64
_FORM = "CALL.PATH[:bit=B][@SECONDS], e.g. moveByVelocity.vx:bit=62@10 or simGetVehiclePose.return.position.z_val"
_LONGEST = 16
"""Lists of more numbers (images, point clouds) are not watched."""


@dataclass(frozen=True, slots=True)
class BoundaryFault:
    """A fault and the instant (us) from which it may act."""

    fault: MessageFault
    since_us: int = 0


def parse_fault(text: str, seed: int = 0) -> BoundaryFault | SensorFault:
    """Read a fault; an unnamed bit is drawn by the seed.

    Raises:
        BadInputError: It has another form, or names a call, argument or bit that does not exist.
    """
    if text.startswith(f"{SensorFault.level}:"):
        return parse_sensor(text, seed)
    found = _TEXT.fullmatch(text)
    if found is None:
        raise BadInputError(f"--fault: {text!r}: allowed: {_FORM}")
    name, path, bit, at = found["call"], found["path"], found["bit"], found["at"]
    if name not in CALLS:
        raise BadInputError(f"--fault: {text!r}: call {name!r}: not known; allowed: calls of docs/airsim.md")
    try:
        since_s = float(at or 0.0)
    except ValueError:
        since_s = -1.0
    if not 0.0 <= since_s < 1e6:
        raise BadInputError(f"--fault: {text!r}: @{at}: allowed: 0 to 1e6 s")
    side, _, rest = path.partition(".")
    if side.partition("#")[0] not in (ARGUMENTS, RETURN):
        head = path.partition(".")[0]
        if head not in find_call(name).arguments:
            allowed = ", ".join([*find_call(name).arguments, RETURN])
            raise BadInputError(f"--fault: {text!r}: {head!r}: not known; allowed: {allowed}")
    if bit is not None and int(bit) >= _BITS:
        raise BadInputError(f"--fault: {text!r}: bit {bit}: allowed: 0 to {_BITS - 1}")
    chosen = int(bit) if bit is not None else random.Random(seed).randrange(_BITS)
    nth = int(found["nth"]) if found["nth"] else 1
    return BoundaryFault(MessageFault(name, path, chosen, nth, seed=seed), round(1e6 * since_s))


def text_of(fault: MessageFault) -> str:
    """The text of a fault of a campaign."""
    return f"{fault.topic}.{fault.field}:bit={fault.bit}#{fault.at}"


@dataclass(frozen=True, slots=True)
class Passed:
    """A call that passed the boundary: its name, and the numbers in its arguments and its return value."""

    name: str
    arguments: int
    returned: int


class Watch(Protocol):
    """Sees every value at the boundary; `alarms`: so far."""

    alarms: list[AlarmRecord]

    def check(self, source: str, value: Any, now_us: int) -> None:
        """See one value of a call and side, at an instant (us)."""


@dataclass
class Boundary:
    """What all calls pass.

    Attributes:
        planned: The fault; None = none.
        failure: The failure of a sensor or motor of the vehicle; None = none.
        injection: The injection into a call that happened.
        passed: Every call so far, if `keeps`.
        watch: A detector; None = none.
    """

    planned: BoundaryFault | None = None
    keeps: bool = False
    watch: Watch | None = None
    failure: Failure | None = None
    injection: Injection | None = None
    passed: list[Passed] = field(default_factory=list)
    _given: int = 0
    _returned: int = 0

    @classmethod
    def of(cls, fault: BoundaryFault | MessageFault | SensorFault | None, watch: Watch | None = None) -> "Boundary":
        """The boundary with a fault, in a call or in the vehicle behind it."""
        if isinstance(fault, SensorFault):
            return cls(watch=watch, failure=Failure(fault))
        return cls(BoundaryFault(fault) if isinstance(fault, MessageFault) else fault, watch=watch)

    @property
    def faulty(self) -> bool:
        """Whether there is a fault."""
        return self.planned is not None or self.failure is not None

    @property
    def injected(self) -> Injection | None:
        """The injection that happened, into a call or the vehicle."""
        return self.injection if self.failure is None else self.failure.injection

    def arguments(self, name: str, given: list[Any], now_us: int) -> list[Any]:
        """Arguments of a call, perhaps changed; `given` is changed in place."""
        planned = self.planned
        if planned is not None and name == planned.fault.topic and now_us >= planned.since_us:
            self._given += 1
            side = planned.fault.field.partition(".")[0].partition("#")[0]
            if side != RETURN and self._given >= planned.fault.at:
                self._inject(given, self._path(given), self._given, now_us)
        if self.watch is not None:
            self.watch.check(f"{name}({ARGUMENTS})", dict(zip(CALLS[name].arguments, given, strict=False)), now_us)
        return given

    def returned(self, name: str, given: Sequence[Any], value: Any, now_us: int) -> Any:
        """Return value of a call, perhaps changed."""
        if self.keeps:
            self.passed.append(Passed(name, sum(map(count, given)), count(value)))
        planned = self.planned
        if planned is not None and name == planned.fault.topic and now_us >= planned.since_us:
            self._returned += 1
            side, _, rest = planned.fault.field.partition(".")
            if side.partition("#")[0] == RETURN and self._returned >= planned.fault.at:
                path = path_of(value, int(side.partition("#")[2])) if "#" in side else keys_of(rest)
                value = self._inject(value, path, self._returned, now_us)
        if self.watch is not None:
            self.watch.check(f"{name}({RETURN})", value, now_us)
        return value

    def _path(self, given: list[Any]) -> Path | None:
        """Path of the planned number in the arguments."""
        assert self.planned is not None  # precondition
        text = self.planned.fault.field
        head, _, rest = text.partition(".")
        if head.startswith(f"{ARGUMENTS}#"):
            return path_of(given, int(head.partition("#")[2]))
        names = CALLS[self.planned.fault.topic].arguments
        return (names.index(head), *keys_of(rest)) if head in names else keys_of(rest)

    def _inject(self, value: Any, path: Path | None, number: int, now_us: int) -> Any:
        """Flip the planned bit, once (none: a null fault); without such a number the fault is not activated."""
        planned = self.planned
        assert planned is not None  # precondition
        if self.injection is not None or path is None:
            return value
        fault = planned.fault
        try:
            value, before, after, bit = flip(value, path, fault.bit or 0)
            if fault.bit is None:
                value, _, after, _ = flip(value, path, bit)
        except BadInputError:
            return value
        self.injection = Injection(
            "message", fault.site, 1e-6 * now_us, None if fault.bit is None else bit, before, after, True,
            details={"call": fault.topic, "number": number, "path": ".".join(map(str, path))},
        )  # fmt: skip
        return value


class BoundaryWatch:
    """A detector on the numbers at the boundary: it observes, and withholds nothing.

    Args:
        detector: Trained on error-free calls, see `train`.
        specs: The watched states, by call and side.

    Attributes:
        alarms: So far.
    """

    def __init__(self, name: str, detector: Detector, specs: dict[str, Any]) -> None:
        self._name, self._detector, self._specs = name, detector, specs
        self.alarms: list[AlarmRecord] = []
        detector.start()

    def check(self, source: str, value: Any, now_us: int) -> None:
        """Judge one value."""
        spec = self._specs.get(source)
        if spec is None:
            return
        numbers = dict(leaves(value))
        if list(numbers) != [one.name for one in spec.header]:
            return
        state = foreign_state(spec, list(numbers.values()))
        alarm = self._detector.check(state, now_us)
        if alarm is not None:
            self.alarms.append(
                AlarmRecord(1e-6 * now_us, self._name, source, "", alarm.score, alarm.fields, "none", "observed")
            )
        self._detector.accept(state, now_us)


class Recording:
    """Error-free values at the boundary, from which a detector learns; has the interface of `BoundaryWatch`."""

    def __init__(self) -> None:
        self.alarms: list[AlarmRecord] = []
        self._values: list[tuple[str, dict[str, float]]] = []

    def check(self, source: str, value: Any, now_us: int) -> None:
        """Keep one value."""
        numbers = dict(leaves(value))
        if 0 < len(numbers) <= _LONGEST:
            self._values.append((source, numbers))

    def train(self, kind: str, profile: str) -> BoundaryWatch:
        """A detector of the calls that happened often enough with the same numbers, all finite.

        Raises:
            BadInputError: No call did.
        """
        shapes: dict[str, list[tuple[str, ...]]] = {}
        for source, numbers in self._values:
            shapes.setdefault(source, []).append(tuple(numbers))
        specs = {
            source: foreign_spec(source, every[0])
            for source, every in shapes.items()
            if len(every) >= SMALLEST_SAMPLE and len(set(every)) == 1
        }
        if not specs:
            raise BadInputError(
                f"--detector: no call happened {SMALLEST_SAMPLE} times; allowed: programs that fly longer"
            )
        states = [foreign_state(specs[name], list(numbers.values())) for name, numbers in self._values if name in specs]
        return BoundaryWatch(kind, learn(kind, profile, [states], specs), specs)
