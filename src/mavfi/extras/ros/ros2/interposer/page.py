"""The page shared with the processes of a graph: arms faults in them, and reads their reports.

The page is memory without a name: the processes open it through the file descriptor of mavfi (`/proc/PID/fd/N`), so
nothing is left behind however mavfi ends.  The layout is that of `control.h`.
"""

import ctypes
import math
import mmap
import os
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.shared_library import shared_library
from mavfi.faults.changes import Change
from mavfi.faults.operations import MESSAGE_OPERATIONS

Side = Literal["publish", "take", "send_request", "take_request", "send_response", "take_response"]
SIDES: tuple[Side, ...] = ("publish", "take", "send_request", "take_request", "send_response", "take_response")
"""Where a message is changed: in the process that sends it, or in one that receives it."""
_WHERE: dict[Side, str] = {
    "publish": "where a message is sent",
    "take": "where a message is received",
    **dict.fromkeys(("send_request", "take_request", "send_response", "take_response"), "in a call of a service"),
}
_OPERATIONS = ("flip", "set", "bias", "scale", "freeze", "drop", "delay", "duplicate", "reorder")
_COMPARISONS = ("", ">=", "<=", ">", "<", "=")
_KINDS = ("changed", "refused", "loaded", "unloaded")
_TYPES = "- f4 f8 f16 u1 u2 ? u1 u1 i1 u2 i2 u4 i4 u8 i8".split()
"""Types of numbers by the code of ROS's introspection tables."""
_FORMATS = {
    "f4": "f",
    "f8": "d",
    "u1": "B",
    "i1": "b",
    "u2": "H",
    "i2": "h",
    "u4": "I",
    "i4": "i",
    "u8": "Q",
    "i8": "q",
}

MAX_FAULTS = 16
"""Largest number of faults at a time."""
_MAX_REPORTS = 4096
_MAX_PROCESSES = 256
_MAGIC = 0x4D415649
_LAYOUT = 1
_DRAWN = -1
_SETTLE_S = 0.002
"""Pause in which calls that have just seen the old faults end (s)."""
PAGE_VARIABLE = "MAVFI_ROS2_PAGE"
"""Environment variable by which a preloaded interposer learns the path of the page."""


class _Fault(ctypes.Structure):
    """fault_t."""

    _fields_ = [
        ("side", ctypes.c_uint8),
        ("operation", ctypes.c_uint8),
        ("comparison", ctypes.c_uint8),
        ("sim_time", ctypes.c_uint8),
        ("bit", ctypes.c_int32),
        ("pid", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("value", ctypes.c_double),
        ("start_s", ctypes.c_double),
        ("end_s", ctypes.c_double),
        ("share", ctypes.c_double),
        ("threshold", ctypes.c_double),
        ("first", ctypes.c_uint64),
        ("times", ctypes.c_uint64),
        ("every", ctypes.c_uint64),
        ("seed", ctypes.c_uint64),
        ("topic", ctypes.c_char * 256),
        ("field", ctypes.c_char * 256),
        ("condition", ctypes.c_char * 256),
        ("type", ctypes.c_char * 128),
        ("seen", ctypes.c_uint64),
        ("begun", ctypes.c_uint64),
        ("changed", ctypes.c_uint64),
        ("refused", ctypes.c_uint64),
    ]


class _Report(ctypes.Structure):
    """report_t."""

    _fields_ = [
        ("ready", ctypes.c_uint64),
        ("pid", ctypes.c_uint32),
        ("fault", ctypes.c_uint32),
        ("message", ctypes.c_uint64),
        ("wall_ns", ctypes.c_int64),
        ("sim_ns", ctypes.c_int64),
        ("kind", ctypes.c_uint8),
        ("type", ctypes.c_uint8),
        ("width", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8),
        ("bit", ctypes.c_int32),
        ("before", ctypes.c_uint8 * 16),
        ("after", ctypes.c_uint8 * 16),
        ("text", ctypes.c_char * 160),
    ]


class _Control(ctypes.Structure):
    """control_t."""

    _fields_ = [
        ("magic", ctypes.c_uint32),
        ("layout", ctypes.c_uint32),
        ("owner", ctypes.c_uint32),
        ("generation", ctypes.c_uint32),
        ("armed", ctypes.c_uint32),
        ("processes", ctypes.c_uint32),
        ("redirected", ctypes.c_uint32),
        ("busy_with", ctypes.c_uint32),
        ("armed_ns", ctypes.c_int64),
        ("sim_ns", ctypes.c_int64),
        ("reports_made", ctypes.c_uint64),
        ("pids", ctypes.c_uint32 * _MAX_PROCESSES),
        ("faults", _Fault * MAX_FAULTS),
        ("reports", _Report * _MAX_REPORTS),
    ]


@dataclass(frozen=True, slots=True)
class InterposedFault:
    """A fault in the messages of a topic or service.

    Attributes:
        topic: Full name of the topic or service.
        field: Path of a number, e.g. `ranges[17]`; "" = the whole message.
        change: What is done, and to which messages.
        side: Where, see `SIDES`.
        seed: Draws the bit, and the messages of a `share`.
        type: Full name of the type, e.g. `sensor_msgs/msg/LaserScan`; needed for what was made before the interposer
            was loaded.
        pid: Only in this process; 0 = in any.

    Raises:
        BadInputError: The operation is not possible there.
    """

    topic: str
    field: str
    change: Change
    side: Side = "publish"
    seed: int = 0
    type: str = ""
    pid: int = 0

    def __post_init__(self) -> None:
        name = self.change.operation.name
        where = f"{self.topic}: {self.change.operation}"
        if self.change.lasts_s > 0.0:
            raise BadInputError(f"{where}: lasts: allowed in flights; here: @START..END")
        if self.field and name in MESSAGE_OPERATIONS and name != "freeze":
            raise BadInputError(f"{where}: changes whole messages; allowed: without a field")
        if not self.field and name not in MESSAGE_OPERATIONS:
            raise BadInputError(f"{where}: changes a number; allowed: with a field")
        possible = {"publish": MESSAGE_OPERATIONS, "take": ("drop", "freeze")}.get(self.side, ("drop",))
        if not self.field and name not in possible:
            raise BadInputError(f"{where}: not possible {_WHERE[self.side]}; allowed: {', '.join(possible)}")
        for text, size in ((self.topic, 255), (self.field, 255), (self.type, 127)):
            if len(text.encode()) > size:
                raise BadInputError(f"{where}: {text[:40]!r}...: allowed: at most {size} bytes")


class Report(NamedTuple):
    """What was done to a message, or why it was not.

    Attributes:
        kind: "changed" or "refused".
        pid: Process in which.
        fault: Index of the fault among the armed ones.
        message: Number of the message of its topic since the faults were armed, counted from 1.
        wall_s: Wall-clock time (s since 1970).
        sim_s: Simulated time (s); 0 without a clock.
        dtype: NumPy's name of the number's type; "" = a whole message.
        bit: Bit that was flipped; None = no flip.
        before: The number before; None = a whole message.
        after: The number after.
        text: Reason of a refusal.
    """

    kind: str
    pid: int
    fault: int
    message: int
    wall_s: float
    sim_s: float
    dtype: str
    bit: int | None
    before: float | int | bool | None
    after: float | int | bool | None
    text: str


class ControlPage:
    """A page; a context manager that disarms the faults at the end."""

    def __init__(self) -> None:
        check_layout()
        self._file = os.memfd_create("mavfi-ros2", os.MFD_CLOEXEC)
        os.ftruncate(self._file, ctypes.sizeof(_Control))
        self._memory = mmap.mmap(self._file, ctypes.sizeof(_Control))
        self._control = _Control.from_buffer(self._memory)
        self._control.layout = _LAYOUT
        self._control.owner = os.getpid()
        self._control.magic = _MAGIC
        self._faults: tuple[InterposedFault, ...] = ()
        self._read = 0
        self.lost_reports = 0
        """Number of reports that were overwritten before they were read."""

    def __enter__(self) -> "ControlPage":
        return self

    def __exit__(self, *_: object) -> None:
        self.disarm()

    @property
    def path(self) -> str:
        """Path by which other processes of this user open the page, while this process lives."""
        return f"/proc/{os.getpid()}/fd/{self._file}"

    def environment(self) -> dict[str, str]:
        """Environment variables that load the interposer into a program and all programs that it starts."""
        preloaded = [str(library())]
        if os.environ.get("LD_PRELOAD"):
            preloaded.append(os.environ["LD_PRELOAD"])
        return {"LD_PRELOAD": ":".join(preloaded), PAGE_VARIABLE: self.path}

    def pids(self) -> tuple[int, ...]:
        """Processes that have loaded the interposer, the first first."""
        count = min(self._control.processes, _MAX_PROCESSES)
        return tuple(self._control.pids[:count])

    def redirected_calls(self) -> int:
        """Number of calls that are redirected in running processes."""
        return int(self._control.redirected)

    def take_busy_with(self) -> int:
        """The mavfi that has refused this page a process since the last call, by its own faults there; 0 = none."""
        owner = int(self._control.busy_with)
        self._control.busy_with = 0
        return owner

    # ---- faults -----------------------------------------------------------------------------------------------------
    def arm(self, faults: Sequence[InterposedFault]) -> None:
        """Arm faults in place of the armed ones; message numbers and times count from now on.

        Raises:
            BadInputError: There are too many.
        """
        if len(faults) > MAX_FAULTS:
            raise BadInputError(f"{len(faults)} faults: allowed: at most {MAX_FAULTS} at a time")
        self.disarm()
        for index, fault in enumerate(faults):
            self._control.faults[index] = _packed(fault)
        self._faults = tuple(faults)
        self._control.generation += 1
        self._control.armed_ns = time.monotonic_ns()
        self._control.armed = len(faults)

    def disarm(self) -> None:
        """Change no more messages; when it returns, all reports have been made."""
        self._control.armed = 0
        time.sleep(_SETTLE_S)

    def set_sim_time(self, seconds: float) -> None:
        """Tell the graph's simulated time (s), on which faults with `sim_time` depend."""
        self._control.sim_ns = int(seconds * 1e9)

    def messages_seen(self, fault: int) -> int:
        """Number of messages that a fault has seen since it was armed."""
        return int(self._control.faults[fault].seen)

    def messages_changed(self, fault: int) -> int:
        """Number of messages that a fault has changed."""
        return int(self._control.faults[fault].changed)

    # ---- reports ----------------------------------------------------------------------------------------------------
    def reports(self) -> list[Report]:
        """Reports since the last call, in their order."""
        return list(self._new_reports())

    def _new_reports(self) -> Iterator[Report]:
        made = self._control.reports_made
        if made - self._read > _MAX_REPORTS:
            self.lost_reports += made - self._read - _MAX_REPORTS
            self._read = made - _MAX_REPORTS
        while self._read < made:
            report = self._control.reports[self._read % _MAX_REPORTS]
            if not report.ready and not self._is_abandoned(report):
                return
            self._read += 1
            if report.ready:
                report.ready = 0
                yield _unpacked(report)

    def _is_abandoned(self, report: Any) -> bool:
        """Whether the process that was writing a report has ended."""
        return report.pid != 0 and not os.path.exists(f"/proc/{report.pid}")


@cache
def library() -> Path:
    """The compiled interposer; see `shared_library`."""
    folder = Path(__file__).parent
    return shared_library(
        folder / "interposer.c",
        "a fault in ROS 2 messages",
        headers=(folder / "control.h", folder / "introspection.h"),
        flags=("-std=gnu11", "-s", "-Wl,-Bsymbolic"),
        libraries=("-lpthread", "-ldl"),
    )


def check_layout() -> None:
    """Check that the compiled interposer has the layout of this module.

    Raises:
        MavfiError: It has not.
    """
    layout = ctypes.CDLL(str(library())).mavfi_layout
    layout.restype = ctypes.c_size_t
    layout.argtypes = [ctypes.c_size_t]
    expected = (
        ctypes.sizeof(_Control),
        ctypes.sizeof(_Fault),
        ctypes.sizeof(_Report),
        _Control.faults.offset,
        _Control.reports.offset,
        _Fault.topic.offset,
        _Fault.seen.offset,
        _Report.text.offset,
    )
    actual = tuple(layout(index) for index in range(len(expected)))
    if actual != expected:
        raise MavfiError(f"the ROS 2 interposer was compiled with another layout: {actual}, here {expected}")


def _packed(fault: InterposedFault) -> _Fault:
    """A fault as the interposer reads it."""
    operation, when, _ = fault.change
    packed = _Fault(
        side=SIDES.index(fault.side),
        operation=_OPERATIONS.index(operation.name),
        sim_time=int(when.sim_time),
        bit=_DRAWN,
        pid=fault.pid,
        value=1.0,
        start_s=when.start_s,
        end_s=when.end_s,
        share=when.share,
        first=when.first,
        times=when.times,
        every=when.every,
        seed=fault.seed,
        topic=fault.topic.encode(),
        field=fault.field.encode(),
        type=fault.type.encode(),
    )
    if operation.value is not None:
        packed.value = operation.value
    if operation.bit is not None:
        packed.bit = operation.bit
    if when.condition is not None:
        packed.comparison = _COMPARISONS.index(when.condition.comparison)
        packed.condition = when.condition.field.encode()
        packed.threshold = when.condition.value
    return packed


def _unpacked(report: Any) -> Report:
    """A report as plain data."""
    dtype = ""
    before = after = None
    if report.width:
        dtype = _TYPES[report.type]
        before = _number(bytes(report.before), dtype)
        after = _number(bytes(report.after), dtype)
    bit = None
    if report.bit >= 0:
        bit = report.bit
    return Report(
        _KINDS[report.kind],
        report.pid,
        report.fault,
        report.message,
        1e-9 * report.wall_ns,
        1e-9 * report.sim_ns,
        dtype,
        bit,
        before,
        after,
        report.text.decode(errors="replace"),
    )


def _number(data: bytes, dtype: str) -> float | int | bool:
    """A number from its bytes."""
    if dtype == "?":
        return bool(data[0])
    if dtype == "f16":  # the 80 bits of x86's long double
        mantissa, exponent = struct.unpack_from("<QH", data)
        if exponent & 0x7FFF == 0x7FFF:
            return math.nan
        magnitude = math.ldexp(mantissa, (exponent & 0x7FFF) - 16383 - 63)
        if exponent >> 15:
            return -magnitude
        return magnitude
    number: float | int = struct.unpack_from("<" + _FORMATS[dtype], data)[0]
    return number
