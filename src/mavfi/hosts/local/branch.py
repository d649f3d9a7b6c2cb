"""A flight in progress that reuses parts of known flights of its mission; see `fast_forward`."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mavfi.detectors.bounded import StuckError, limited
from mavfi.detectors.detector import Alarm, Detector
from mavfi.faults.state import CounterWatch, StateInjector
from mavfi.flight_log import FlightLog
from mavfi.hosts.local.checkpoints import Checkpoint, Instant, is_at, keeper_of, put, take
from mavfi.hosts.loop.assemble import install, restarts_for
from mavfi.hosts.loop.policy import Recovery
from mavfi.hosts.loop.scheduler import CONTROL_PERIOD_US
from mavfi.states import State

if TYPE_CHECKING:
    from mavfi.hosts.local.fast_forward import FastForward


@dataclass(slots=True)
class Share:
    """Share of the flights that was simulated.

    Attributes:
        ticks: Control periods of all flights, of which `flown` were simulated; in those `shown`, a detector only
            checked the publications of a known flight.
        converged: Number of flights that converged to another one before their end.
    """

    flights: int = 0
    ticks: int = 0
    flown: int = 0
    shown: int = 0
    converged: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A completed flight, its publications (if it has checkpoints), and its checkpoints by number of rows."""

    log: FlightLog
    rows: list[np.ndarray]
    shown: list[tuple[State, int]]
    checkpoints: dict[int, Checkpoint]
    end: Checkpoint

    def before(self, time_us: int) -> int:
        """Number of rows of the last checkpoint before an instant (us); 0 if there is none."""
        return max((rows for rows in self.checkpoints if rows * CONTROL_PERIOD_US < time_us), default=0)

    def pieces(self, rows: int) -> Iterator[tuple[Checkpoint, Checkpoint]]:
        """Pairs of consecutive checkpoints from `rows` on, up to the end."""
        chosen = [self.checkpoints[place] for place in sorted(self.checkpoints) if place >= rows]
        return pairwise([*chosen, self.end])

    def is_silent(self, rows: int) -> bool:
        """Whether its own detector, if there is one, raises no alarm before the checkpoint after the one at `rows`."""
        here, there = next(self.pieces(rows))
        return len(here.alarms) == len(there.alarms)


def takes_part(detector: Detector | None, recovery: Recovery) -> bool:
    """Whether a detector acts without an alarm, or answers one depending on earlier events other than its alarms.

    It seals values before they are published, has unreadable ones sent again, has steps computed twice, or waits for
    answers and restarts nodes.  Otherwise it has no effect up to its first alarm, and the publications of a flight are
    all that it needs.
    """
    return detector is not None and (
        recovery.remembers or recovery.resends or detector.seals or bool(detector.duplicates)
    )  # fmt: skip


class Branch:
    """A flight in progress; it may converge to the `known` flights or to `own`, the golden flight with its detector.

    With `keeps` it has checkpoints; with `shows`, which `keeps` implies, it records publications in `shown`.
    `comparable` states whether checkpoints contain everything in which it may differ from the known flights.
    A detector that `takes_part` shares checkpoints with the known flights, but its flights are not derived from them.
    """

    def __init__(
        self, forward: "FastForward", detector: Detector | None, known: Sequence[Track] = (), own: Track | None = None,
        keeps: bool = False, shows: bool = False,
    ) -> None:  # fmt: skip
        self.loop = forward.loop
        self.comparable: Callable[[], bool] = lambda: True
        self._share, self._pitch = forward.share, forward.pitch
        self._detector = None if detector is None else keeper_of(detector)
        self._known, self._own, self._keeps = known, own, keeps
        self._scratch = forward.scratch and own is None  # faults in instructions are injected after golden checkpoints
        self._checkpoints: dict[int, Checkpoint] = {}
        self.shown: list[tuple[State, int]] = []
        self._flown = False
        self._log: FlightLog | None = None
        self._recovery = forward.recovery
        self._derived = not takes_part(detector, self._recovery)
        self.loop.status, self.loop.verify = None, None
        self.loop.taps.detector, self.loop.taps.seal, self.loop.taps.again = None, None, None
        self._shows = keeps or shows
        self.loop.taps.recorders[:] = [lambda state, now: self.shown.append((state, now))] if self._shows else []
        self._restarts = None if detector is None else restarts_for(self.loop, self._recovery)
        self._watch()

    def _watch(self) -> None:
        self._tap = None
        if self._detector is not None:
            self._tap = install(self.loop, self._detector.content, self._recovery, self._restarts)

    def remember(self, saved: Any) -> None:  # noqa: ANN401
        """Restore the memory of detector and recovery, if there is a detector, from a checkpoint."""
        if self._detector is not None:
            known, alarms = saved
            self._detector.restore(known)
            self._watch()  # restoring may have replaced the object
            assert self._tap is not None  # there is a detector
            self._tap.memory = alarms.copy()

    def _memory(self) -> Any:  # noqa: ANN401
        """What `remember` restores; None = there is no detector."""
        return None if self._detector is None or self._tap is None else (self._detector.save(), self._tap.memory.copy())

    # ---- the record -------------------------------------------------------------------------------------------------
    def begin_empty(self) -> None:
        """Start with the record of a flight before take-off."""
        record = self.loop.record
        record.rows, record.events, record.alarms = [], [], []
        record.set_counts([0] * len(record.counts()))

    def begin(self, track: Track, start: Checkpoint) -> None:
        """Start with another flight's record up to a checkpoint."""
        record = self.loop.record
        record.rows, record.events = track.rows[: start.rows], track.log.events[: start.events]
        record.alarms, self.shown = list(start.alarms), track.shown[: start.shown]
        record.set_counts(start.counts)
        if self._restarts is not None:
            for state, now in self.shown:
                self._restarts.keep(state, now)

    def keep(self, instant: Instant) -> None:
        """Store a checkpoint at the current number of rows."""
        self._checkpoints[len(self.loop.record.rows)] = self._checkpoint(instant)

    def _checkpoint(self, instant: Instant | None = None) -> Checkpoint:
        record, injector = self.loop.record, self.loop.taps.injector
        assert isinstance(injector, (CounterWatch, StateInjector))  # installed in every flight of this class
        return Checkpoint(
            instant, len(record.rows), len(record.events), len(self.shown), tuple(record.alarms), record.counts(),
            injector.copy(), self._memory(),
        )  # fmt: skip

    def _append(self, track: Track, here: Checkpoint, there: Checkpoint) -> None:
        """Append another flight's record between two of its checkpoints."""
        record, log = self.loop.record, track.log
        record.rows += track.rows[here.rows : there.rows]
        record.events += log.events[here.events : there.events]
        record.alarms += log.alarms[len(here.alarms) : len(there.alarms)]
        if self._shows:
            self.shown += track.shown[here.shown : there.shown]
        so_far = record.counts()
        record.set_counts(n + b - a for n, a, b in zip(so_far, here.counts, there.counts, strict=True))
        if there is track.end:
            self._log = self.loop.log(log.status, log.meta["rejected_commands"])
        elif self._keeps:
            self.keep(there.here)

    def keep_from_now_on(self) -> None:
        """Take checkpoints at all further instants for them."""
        self._keeps = True

    # ---- reuse of another flight ------------------------------------------------------------------------------------
    def append_unless_alarm(self, track: Track, start: Checkpoint, there: Checkpoint) -> bool:
        """Reuse a flight without a detector between two of its checkpoints; False, without effect, at an alarm."""
        if self._detector is None or self._alarms(track, start, there):
            return False
        self._append(track, start, there)
        return True

    def converge(self, track: Track, rows: int) -> None:
        """Reuse the remainder of another flight."""
        self._share.converged += 1
        if not self._keeps:
            self._append(track, track.checkpoints[rows], track.end)
            return
        for here, there in track.pieces(rows):
            self._append(track, here, there)

    def follow(self, track: Track, rows: int, *, is_there: bool = False) -> None:
        """Reuse another flight, to its end, to an alarm of its own detector, or to the first one on its publications.

        `is_there`: the loop is at the checkpoint at `rows`.
        """
        for here, there in track.pieces(rows):
            if self._detector is None:
                return self.converge(track, here.rows)
            if self._own is not None and self._is_own(here):
                return self.converge(self._own, here.rows)
            known = self._memory()
            if len(there.alarms) > len(here.alarms) or self._alarms(track, here, there):
                self.remember(known)
                return None if is_there and here.rows == rows else put(self.loop, here.here)
            self._share.shown += there.rows - here.rows
            if not self._flown or isinstance(self.loop.taps.injector, CounterWatch):
                self.loop.taps.injector = there.injector.copy()
            self._append(track, here, there)

    def _is_own(self, here: Checkpoint) -> bool:
        """Whether the remainder equals that of the golden flight with the same detector."""
        known = None if self._own is None else self._own.checkpoints.get(here.rows)
        return known is not None and known.instant is here.instant and self._is_through() and self._same_detector(known)

    def _is_through(self) -> bool:
        """Whether injector and recovery have no further effect."""
        injector = self.loop.taps.injector
        return not self.loop.awaited and not self.loop.requests and injector is not None and injector.spent

    def _same_detector(self, known: Checkpoint) -> bool:
        if self._detector is None or self._tap is None:
            return True
        saved, alarms = known.detector
        return self._detector.same(saved) and self._tap.memory.same(alarms)

    def _alarms(self, track: Track, here: Checkpoint, there: Checkpoint) -> bool:
        """Whether the detector, which must not be None, raises an alarm on publications of another flight.

        One that fails is asked again in the flight, which may give it up.
        """
        assert self._detector is not None and self._tap is not None  # precondition
        if self._tap.gave_up:
            return False
        watched, check = self.loop.taps.watched, limited(self._detector.content, "check")
        accept = limited(self._detector.content, "accept")

        def admit(state: State, time_us: int) -> Alarm | None:
            alarm: Alarm | None = check(state, time_us)
            if alarm is None:
                accept(state, time_us)
            return alarm

        seen = (one for one in track.shown[here.shown : there.shown] if watched is None or one[0].spec.name in watched)
        try:
            return any(admit(state, now) is not None for state, now in seen)
        except (StuckError, Exception):
            return True

    # ---- flying -----------------------------------------------------------------------------------------------------
    def fly(self) -> Track:
        """Continue to the end; simulate where no known flight can be reused."""
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
        return Track(self._log, record.rows, self.shown, self._checkpoints, self._checkpoint())

    def _arrive(self) -> None:
        """At a checkpoint instant: reuse another flight if the current state has converged to it."""
        rows = len(self.loop.record.rows)
        other = self._converged() if self._is_through() and self.comparable() else None
        if self._keeps:
            self.keep(take(self.loop, scratch=self._scratch) if other is None else other.checkpoints[rows].here)
        if other is not None and other is self._own:
            self.converge(other, rows)
        elif other is not None and self._derived:
            self.follow(other, rows, is_there=True)

    def _converged(self) -> Track | None:
        """A known flight in the current state that can be followed from here; None = none."""
        loop, rows = self.loop, len(self.loop.record.rows)
        equal: dict[int, bool] = {}
        for track in (*self._known, self._own):
            here = None if track is None else track.checkpoints.get(rows)
            if track is None or here is None or not here.injector.spent:
                continue  # the other flight's injection is still pending
            if track is self._own and not self._same_detector(here):
                continue
            if track is not self._own and not track.is_silent(rows):
                continue
            if isinstance(loop.taps.injector, CounterWatch) and not loop.taps.injector.same(here.injector):
                continue
            if id(here.instant) not in equal:
                equal[id(here.instant)] = is_at(loop, here.here)
            if equal[id(here.instant)]:
                return track
        return None
