"""Recorder of error-free flights for training."""

from dataclasses import dataclass, field

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.detector import Detector
from mavfi.states import MONITORED_SETS, ODOMETRY, STATES, State

WATCHED = tuple(dict.fromkeys(state for fields in MONITORED_SETS.values() for state, _ in fields))
"""States with a field in a monitored set."""
_WAYPOINT = "planning.waypoint"
_ODOMETRY_SIZE = STATES[ODOMETRY["truth"]].header_dtype.itemsize


@dataclass(frozen=True, slots=True)
class Recording:
    """Every publication of a watched state in one flight, and the vehicle's odometry at each new trajectory.

    Attributes:
        kinds: Index in WATCHED, or features.ODOMETRY. Shape (m,), int8.
        times_us: Publication times (us). Shape (m,), int64.
        content: The published headers, concatenated. Shape (total,), uint8.
        slots, regimes, codes: See `field_codes.Codes`, whose `own` is `codes`; empty if only monitored states were
            recorded.
    """

    kinds: np.ndarray
    times_us: np.ndarray
    content: np.ndarray
    slots: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int8))
    regimes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int8))
    codes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int16))

    @property
    def ends(self) -> np.ndarray:
        """End of each header in `content`. Shape (m,), int64."""
        sizes = [*(STATES[name].header_dtype.itemsize for name in WATCHED), _ODOMETRY_SIZE]
        return np.cumsum(np.array(sizes, np.int64)[self.kinds])

    def headers(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Publications of one watched state: times (us), shape (k,), and headers, shape (k,), structured."""
        spec = STATES[name]
        chosen = np.flatnonzero(self.kinds == WATCHED.index(name))
        size = spec.header_dtype.itemsize
        rows = self.ends[chosen, None] - size + np.arange(size)
        return self.times_us[chosen], self.content[rows].reshape(-1).view(spec.header_dtype)


class Recorder(Detector):
    """A detector that never raises an alarm and records publications."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self._kinds: list[int] = []
        self._times: list[int] = []
        self._content: list[bytes] = []
        self._odometry = b""
        self._trajectory: int | None = None

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""
        name = state.spec.name
        if name in ODOMETRY.values():
            self._odometry = state.header.tobytes()[:_ODOMETRY_SIZE]
        elif name in _KINDS:
            if name == _WAYPOINT:
                self._note_trajectory(int(state.header["trajectory_seq"][0]), time_us)
            self._append(_KINDS[name], time_us, state.header.tobytes())

    def recording(self) -> Recording:
        """All publications since `start`."""
        content = np.frombuffer(b"".join(self._content), np.uint8)
        return Recording(np.array(self._kinds, np.int8), np.array(self._times, np.int64), content)

    def _note_trajectory(self, trajectory: int, time_us: int) -> None:
        if trajectory != self._trajectory and self._odometry:
            self._append(features.ODOMETRY, time_us, self._odometry)
        self._trajectory = trajectory

    def _append(self, kind: int, time_us: int, content: bytes) -> None:
        self._kinds.append(kind)
        self._times.append(time_us)
        self._content.append(content)


_KINDS = {name: kind for kind, name in enumerate(WATCHED)}
