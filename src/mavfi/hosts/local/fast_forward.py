"""Fast-forward: the flights of one mission, with faults and under several detectors, without flying equal parts twice.

`FastForward.fly` answers what `mavfi.hosts.local.fly` answers, bit for bit.  It saves work in three ways:

- A flight with a fault begins at the golden run's last checkpoint before the fault.
- At each checkpoint at which plant, kernels and queue have converged to those of a known flight, the rest is known.
- A detector without alarms changes nothing.  So where a flight without a detector is known, a detector is only shown
  its publications; at its first alarm the flight continues from the checkpoint before.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.errors import MavfiError
from mavfi.faults.fault import StateFault
from mavfi.faults.state import CounterWatch, StateInjector
from mavfi.flight_log import FlightLog, Profile
from mavfi.hosts.host import Flight
from mavfi.hosts.local.checkpoints import Checkpoint, Instant, is_at, keeper_of, put, take
from mavfi.hosts.loop.assemble import new_loop
from mavfi.hosts.loop.recovery import INLINE, Recovery, Watch
from mavfi.hosts.loop.scheduler import CONTROL_PERIOD_US
from mavfi.mission import Scenario
from mavfi.states import State

TICKS = {"dense": 50, "octree": 200}
"""Control ticks between two checkpoints, by the kind of map: an octree is copied whole each time."""


@dataclass(slots=True)
class Share:
    """How much of the flights was simulated.

    Attributes:
        ticks: Control ticks of all flights; those `flown` were simulated, in those `shown` a detector was only shown
            the publications of a known flight.
        converged: Flights that converged to another one before their end.
    """

    flights: int = 0
    ticks: int = 0
    flown: int = 0
    shown: int = 0
    converged: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A flight that is over, with its publications (if it has no detector) and its checkpoints by number of rows."""

    log: FlightLog
    rows: list[np.ndarray]
    shown: list[tuple[State, int]]
    checkpoints: dict[int, Checkpoint]
    end: Checkpoint

    def before(self, time_us: int) -> int:
        """Number of rows of the last checkpoint before an instant; the first one, if there is none."""
        return max((rows for rows in self.checkpoints if rows * CONTROL_PERIOD_US < time_us), default=0)

    def pieces(self, rows: int) -> Iterator[tuple[Checkpoint, Checkpoint]]:
        """The checkpoints from one on, each with the next one, to the end."""
        chosen = [self.checkpoints[place] for place in sorted(self.checkpoints) if place >= rows]
        return pairwise([*chosen, self.end])


class FastForward:
    """All flights of one mission; `share` says how much of them was simulated.

    Raises:
        BadInputError: The scenario cannot be flown.
        MavfiError: It has an estimator, whose sensors are not part of a checkpoint.
    """

    def __init__(self, scenario: Scenario) -> None:
        if scenario.localization.kind != "truth":
            raise MavfiError("flights with an estimator are not fast-forwarded")
        self.loop = new_loop(scenario, profile=True, rewindable=True)
        self.pitch = TICKS.get(scenario.map.kind, TICKS["octree"])
        self.share = Share()
        self._golden: dict[str, Track] = {}
        self._profile: Profile | None = None
        self._last: tuple[StateFault, Track] | None = None
        self.recovery = INLINE

    def fly(
        self, fault: StateFault | None = None, detector: Detector | None = None, arm: str = "",
        recovery: Recovery = INLINE,
    ) -> Flight:  # fmt: skip
        """Fly, as far as it is not known yet; only the golden flight without a detector has a profile.

        Args:
            fault: What to inject; None = golden flight.
            detector: None = none.  It is started where its flights begin.
            arm: Name of the detector: the same name always comes with the same detector and recovery.
            recovery: Answer to its alarms; it `remembers` nothing, since a checkpoint would not know of it.
        """
        self.recovery = recovery
        with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
            if fault is None:
                track = self.golden(detector, arm)
            else:
                track = self._unwatched(fault) if detector is None else self._injected(fault, detector, arm)
        self.share.flights += 1
        self.share.ticks += len(track.rows)
        return Flight(track.log, self._profile if fault is None and detector is None else None)

    def golden(self, detector: Detector | None = None, arm: str = "") -> Track:
        """The golden flight, flown when it is first wanted."""
        if arm not in self._golden:
            self._golden[arm] = self._first() if detector is None else self._watched(detector)
        return self._golden[arm]

    def _first(self) -> Track:
        """The golden flight without a detector, from take-off."""
        loop = self.loop
        branch = _Branch(self, None, keeps=True)
        loop.taps.injector = CounterWatch()
        loop.begin()
        branch.keep(take(loop))
        track = branch.fly()
        self._profile = loop.record.publications.profile()
        loop.record.publications.wanted = False
        return track

    def _watched(self, detector: Detector) -> Track:
        """The golden flight with a detector."""
        plain = self.golden()
        branch = _Branch(self, detector, [plain], keeps=True)
        detector.start()
        branch.begin(plain, plain.checkpoints[0])
        branch.loop.taps.injector = CounterWatch()
        branch.keep(plain.checkpoints[0].here)
        branch.follow(plain, 0)
        return branch.fly()

    def _unwatched(self, fault: StateFault) -> Track:
        """The flight with a fault and no detector; of the last fault it is known."""
        if self._last is None or self._last[0] != fault:
            self._last = fault, self._injected(fault, None, "")
        return self._last[1]

    def _injected(self, fault: StateFault, detector: Detector | None, arm: str) -> Track:
        own, plain = self.golden(detector, arm), self.golden()
        rows = own.before(fault.time_us)
        start = own.checkpoints[rows]
        assert isinstance(start.injector, CounterWatch)  # it is of a flight without a fault
        injector = StateInjector(fault, start.injector)
        as_plain = rows in plain.checkpoints and start.instant is plain.checkpoints[rows].instant
        # where nothing has alarmed yet, the flight without a detector shows what happens until it does
        along = self._unwatched(fault) if detector is not None and as_plain and not injector.spent else None
        branch = _Branch(self, detector, [plain] if along is None else [along, plain], own, keeps=detector is None)
        branch.begin(own, start)
        branch.loop.taps.injector = injector
        branch.remember(start.detector)
        if injector.spent:
            branch.converge(own, rows)
        elif along is not None:
            branch.follow(along, rows)
        else:
            put(branch.loop, start.here)
            if detector is None:
                branch.keep(start.here)
        return branch.fly()


class _Branch:
    """A flight under construction; it may converge to `known` flights or to `own`, the golden one with its detector."""

    def __init__(
        self, forward: FastForward, detector: Detector | None, known: Sequence[Track] = (), own: Track | None = None,
        keeps: bool = False,
    ) -> None:  # fmt: skip
        self.loop = forward.loop
        self._share, self._pitch = forward.share, forward.pitch
        self._detector = None if detector is None else keeper_of(detector)
        self._known, self._own, self._keeps = known, own, keeps
        self._checkpoints: dict[int, Checkpoint] = {}
        self._shown: list[tuple[State, int]] = []
        self._flown = False
        self._log: FlightLog | None = None
        self._recovery = forward.recovery
        self.loop.status, self.loop.taps.detector, self.loop.taps.seal = None, None, None
        self._watch()
        shows = keeps and detector is None
        self.loop.taps.recorders[:] = [lambda state, now: self._shown.append((state, now))] if shows else []

    def _watch(self) -> None:
        if self._detector is not None:
            tap = Watch(self.loop, self._detector.content, self._recovery)
            taps = self.loop.taps
            taps.detector, taps.watched, taps.seal = tap, tap.states, tap.seal if tap.seals else None

    def remember(self, saved: Any) -> None:  # noqa: ANN401
        """Restore the memory of the detector, if there is one, from a checkpoint."""
        if self._detector is not None:
            self._detector.restore(saved)
            self._watch()  # it may be another object

    # ---- the record -------------------------------------------------------------------------------------------------
    def begin(self, track: Track, start: Checkpoint) -> None:
        """Take over the record of a flight up to a checkpoint."""
        record = self.loop.record
        record.rows, record.events = track.rows[: start.rows], track.log.events[: start.events]
        record.alarms, self._shown = list(start.alarms), track.shown[: start.shown]
        record.set_counts(start.counts)

    def keep(self, instant: Instant) -> None:
        """Note a checkpoint here."""
        self._checkpoints[len(self.loop.record.rows)] = self._checkpoint(instant)

    def _checkpoint(self, instant: Instant | None = None) -> Checkpoint:
        record, injector = self.loop.record, self.loop.taps.injector
        assert isinstance(injector, (CounterWatch, StateInjector))  # whatever is flown here has one
        return Checkpoint(
            instant, len(record.rows), len(record.events), len(self._shown), tuple(record.alarms), record.counts(),
            injector.copy(), None if self._detector is None else self._detector.save(),
        )  # fmt: skip

    def _append(self, track: Track, here: Checkpoint, there: Checkpoint) -> None:
        """Continue as another flight did from one of its checkpoints to another one."""
        record, log = self.loop.record, track.log
        record.rows += track.rows[here.rows : there.rows]
        record.events += log.events[here.events : there.events]
        record.alarms += log.alarms[len(here.alarms) : len(there.alarms)]
        if self._keeps and self._detector is None:
            self._shown += track.shown[here.shown : there.shown]
        so_far = record.counts()
        record.set_counts(n + b - a for n, a, b in zip(so_far, here.counts, there.counts, strict=True))
        if there is track.end:
            self._log = self.loop.log(log.status, log.meta["rejected_commands"])
        elif self._keeps:
            self.keep(there.here)

    # ---- continuing as another flight --------------------------------------------------------------------------------
    def converge(self, track: Track, rows: int) -> None:
        """Continue as another flight to the end."""
        self._share.converged += 1
        if not self._keeps:
            self._append(track, track.checkpoints[rows], track.end)
            return
        for here, there in track.pieces(rows):
            self._append(track, here, there)

    def follow(self, track: Track, rows: int) -> None:
        """Continue as a flight without a detector, to the end or to the first alarm at its publications."""
        for here, there in track.pieces(rows):
            if self._detector is None:
                return self.converge(track, here.rows)
            if self._own is not None and self._is_own(here):
                return self.converge(self._own, here.rows)
            known = self._detector.save()
            if self._alarms(track.shown[here.shown : there.shown], self._detector.content):
                self.remember(known)
                return put(self.loop, here.here)
            self._share.shown += there.rows - here.rows
            if not self._flown or isinstance(self.loop.taps.injector, CounterWatch):
                self.loop.taps.injector = there.injector.copy()
            self._append(track, here, there)

    def _is_own(self, here: Checkpoint) -> bool:
        """Whether the rest is that of the golden flight with the same detector."""
        known = None if self._own is None else self._own.checkpoints.get(here.rows)
        return known is not None and known.instant is here.instant and self._is_through() and self._same_detector(known)

    def _is_through(self) -> bool:
        """Whether the injector and the last alarm have no further effect."""
        injector = self.loop.taps.injector
        return not self.loop.awaited and not self.loop.requests and injector is not None and injector.spent

    def _same_detector(self, known: Checkpoint) -> bool:
        return self._detector is None or self._detector.same(known.detector)

    def _alarms(self, shown: list[tuple[State, int]], detector: Detector) -> bool:
        watched = self.loop.taps.watched
        for state, now in shown:
            if watched is not None and state.spec.name not in watched:
                continue
            if detector.check(state, now) is not None:
                return True
            detector.accept(state, now)
        return False

    # ---- flying -----------------------------------------------------------------------------------------------------
    def fly(self) -> Track:
        """Continue to the end, by simulation where nothing else will do."""
        loop, record = self.loop, self.loop.record
        while self._log is None:
            self._flown = True
            before = len(record.rows)
            loop.run((before // self._pitch + 1) * self._pitch)
            self._share.flown += len(record.rows) - before
            if loop.status is None:
                self._arrive()
            else:
                self._log = loop.flight().log
        loop.taps.recorders.clear()
        return Track(self._log, record.rows, self._shown, self._checkpoints, self._checkpoint())

    def _arrive(self) -> None:
        """At the instant of a checkpoint: continue as another flight, if one is in the same state."""
        rows = len(self.loop.record.rows)
        other = self._converged() if self._is_through() else None
        if self._keeps:
            self.keep(take(self.loop) if other is None else other.checkpoints[rows].here)
        if other is not None and other is self._own:
            self.converge(other, rows)
        elif other is not None:
            self.follow(other, rows)

    def _converged(self) -> Track | None:
        """A flight that is in the same state now."""
        loop, seen = self.loop, set()
        for track in (*self._known, self._own):
            here = None if track is None else track.checkpoints.get(len(loop.record.rows))
            if track is None or here is None or not here.injector.spent or id(here.instant) in seen:
                continue  # the other flight has its fault still before it
            seen.add(id(here.instant))
            if track is self._own and not self._same_detector(here):
                continue
            if isinstance(loop.taps.injector, CounterWatch) and not loop.taps.injector.same(here.injector):
                continue
            if is_at(loop, here.here):
                return track
        return None
