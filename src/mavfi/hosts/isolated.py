"""Flights in a child process: a detector that is not part of mavfi cannot block them.

See `mavfi.detectors.bounded`: a flight in which a call never returns, or ends the process, is repeated without that
call.  The detector object of this process does not change.
"""

import io
import pickle
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from mavfi.detectors.bounded import is_foreign, split_again
from mavfi.detectors.detector import Detector
from mavfi.errors import MavfiError
from mavfi.faults.fault import Fault
from mavfi.hosts.host import ArmSetup, Flight, Host, Recorded, one_by_one
from mavfi.ir.forked import Ended, ForkPoint
from mavfi.plugins import portable

_FOREVER_S = 1e9
"""A flight may be paced in real time, and paused."""
T = TypeVar("T")


class RaisedError(Exception):
    """The traceback of an exception of a child, as text."""


def run_again(work: Callable[[], bytes], timeout: float) -> Ended:
    """As `run_in_child`; a child that ends in a call of a detector is repeated without that call."""
    point = ForkPoint()
    with point.guard():
        ended = split_again(point, timeout)
        if ended is None:
            point.finish(work())
    return ended


def in_child(detector: Detector | None, work: Callable[[], T]) -> T:
    """The result of `work`, which flies, in a child process if the detector is not part of mavfi.

    Raises:
        MavfiError: The child ended otherwise than in a call of the detector; or `work` raised it, like any exception.
    """
    if not is_foreign(detector):
        return work()
    ended = run_again(lambda: _report(work), _FOREVER_S)
    if ended.how != "done":
        raise MavfiError(f"the process of the flight ended ({ended.how}: {ended.detail})")
    result, error, lines = pickle.loads(ended.payload)
    if error is not None:
        raise error from RaisedError(lines)
    return result  # type: ignore[no-any-return]


class IsolatedFlights:
    """`MissionFlights` of which each is flown `in_child`, from take-off."""

    def __init__(self, host: Host, arms: Mapping[str, ArmSetup]) -> None:
        self._flights: Any = host.mission(arms, fast_forward=False)  # each host has its own type
        self._detectors = {arm: setup.detector() for arm, setup in arms.items()}

    def golden(self, arm: str, *, profile: bool = False) -> Flight:
        """See `MissionFlights.golden`."""
        flight: Flight = in_child(self._detectors[arm], lambda: self._flights.golden(arm, profile=profile))
        self.know(arm, flight)
        return flight

    def know(self, arm: str, flight: Flight) -> None:
        """See `MissionFlights.know`."""
        self._flights.know(arm, flight)

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `MissionFlights.injected`."""
        return one_by_one(runs, self._injected)

    def _injected(self, arm: str, fault: Fault) -> Recorded:
        def fly() -> Recorded:
            _, flight = next(self._flights.injected([(arm, fault)]))
            if isinstance(flight, Exception):
                raise flight
            return flight  # type: ignore[no-any-return]

        return in_child(self._detectors[arm], fly)


def _report(work: Callable[[], Any]) -> bytes:
    try:
        return _pickled((work(), None, ""))
    except (Exception, SystemExit) as error:  # raised in the parent
        return pickle.dumps((None, portable(error), f"in a child process\n{traceback.format_exc()}"))


class _Pickler(pickle.Pickler):
    """Pickles flights without those of a user's own kernels that cannot be pickled."""

    def reducer_override(self, found: Any) -> Any:
        if not isinstance(found, Flight):
            return NotImplemented
        return _flight, (found.log, found.profile, found.world, _kernels(found.pipeline), found.extra)


def _kernels(pipeline: Mapping[str, Any]) -> dict[str, bytes]:
    found = {}
    for name, kernel in pipeline.items():
        try:
            found[name] = pickle.dumps(kernel)
        except Exception:  # noqa: BLE001, S112, PERF203 - of a user's own
            continue
    return found


def _flight(log: Any, profile: Any, world: Any, kernels: Mapping[str, bytes], extra: Any) -> Flight:
    return Flight(log, profile, world, {name: pickle.loads(kernel) for name, kernel in kernels.items()}, extra)


def _pickled(found: Any) -> bytes:
    written = io.BytesIO()
    _Pickler(written, pickle.HIGHEST_PROTOCOL).dump(found)
    return written.getvalue()
