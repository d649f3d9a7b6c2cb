"""Fast-forward: flies the injected runs of one mission, under several detectors, and simulates common parts once.

`FastForward.fly` returns bit for bit the results of `mavfi.hosts.local.fly`.  It saves work in three ways:

- An injected run starts from the golden run's last checkpoint before the fault.
- At each checkpoint where plant, kernels and queue have converged to those of a known flight, its remainder is reused.
- A detector without alarms has no effect.  Where the flight without a detector is known, the detector only checks the
  publications of that flight; at its first alarm, simulation continues from the preceding checkpoint.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector, admission
from mavfi.errors import MavfiError
from mavfi.faults.fault import StateFault
from mavfi.faults.instruction import Resolving
from mavfi.faults.state import CounterWatch, StateInjector
from mavfi.flight_log import FlightLog, Profile
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.forking import ForkingFunction
from mavfi.hosts.local.checkpoints import Checkpoint, Instant, has_scratch, is_at, keeper_of, put, take
from mavfi.hosts.loop.assemble import new_loop
from mavfi.hosts.loop.golden_prefix import prefix_of
from mavfi.hosts.loop.recovery import INLINE, Recovery, Watch
from mavfi.hosts.loop.scheduler import CONTROL_PERIOD_US
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.sim.controller import is_rewindable
from mavfi.states import State

TICKS = {"dense": 50, "octree": 200}
"""Control periods between two checkpoints, by map kind: an octree is copied whole each time."""


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


class FastForward:
    """All flights of one mission; `share` counts the simulated part.

    Attributes:
        loop: The loop of all flights; its record counts the calls of `functions`, and checkpoints contain the counts.
        functions: The functions of its kernels, at whose calls flights can fork, by name.
        scratch: Whether checkpoints contain the work arrays of kernels, so that faults in instructions can be injected
            after them: if that is requested, and all of these can be saved.
        watched: Whether injected runs are flown with detectors as well: these continue from checkpoints of injected
            runs without one, which otherwise have none.

    Raises:
        BadInputError: The scenario cannot be flown.
        MavfiError: It uses an estimator or a flight controller whose state is not part of a checkpoint.
    """

    def __init__(self, scenario: Scenario, *, scratch: bool = False) -> None:
        if scenario.localization.kind != "truth":
            raise MavfiError("flights with an estimator are not fast-forwarded")
        if not is_rewindable(scenario.flight_controller):
            raise MavfiError(f"flights with the flight controller {scenario.flight_controller} are not fast-forwarded")
        self.functions = {
            field.name: ForkingFunction(field.name, getattr(PLAIN, field.name)) for field in fields(PLAIN)
        }
        table = PLAIN.instrumented(tuple(self.functions), lambda name, _: self.functions[name])
        self.loop = new_loop(scenario, profile=True, rewindable=True, functions=table)
        self.loop.watch_losses()
        for function in self.functions.values():
            function.attach(self.loop)
        self.scratch = scratch and has_scratch(self.loop)
        self.watched = True
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
        """Fly, reusing known parts; only the golden flight without a detector has a profile.

        Args:
            fault: The fault; None = golden flight.
            detector: The detector, initialized at the start of each flight; None = none.
            arm: Name of the detector's arm; each name must always denote the same detector and recovery policy.
            recovery: The recovery policy; it must not `remember`, since checkpoints do not contain its state.
        """
        self.recovery = recovery
        with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
            if fault is None:
                track = self.golden(detector, arm)
            else:
                track = self._unwatched(fault) if detector is None else self._injected(fault, detector, arm)
        self.share.flights += 1
        self.share.ticks += len(track.rows)
        return Flight(track.log, self._profile if fault is None and detector is None else None)

    @contextmanager
    def instrumented(self, functions: Mapping[str, Callable[..., Any]]) -> Iterator[None]:
        """Call these in the place of functions of the kernels; results must be the same, bit for bit."""
        with ExitStack() as stack:
            for name, function in functions.items():
                stack.enter_context(self.functions[name].replaced(function))
            yield

    def resolve(self, functions: Mapping[str, Resolving]) -> None:
        """Repeat the golden flight without a detector from the checkpoints before wanted calls to these.

        Raises:
            MavfiError: Two golden flights differ.
        """
        golden, loop = self.golden(), self.loop
        places = {name: list(loop.record.calls).index(name) for name in functions}
        with self.instrumented(functions), np.errstate(all="ignore"):
            for here, there in golden.pieces(0):
                calls = {name: range(here.counts[place], there.counts[place]) for name, place in places.items()}
                if not any(function.is_wanted(calls[name]) for name, function in functions.items()):
                    continue
                Branch(self, None).begin(golden, here)
                loop.taps.injector = here.injector.copy()
                put(loop, here.here)
                for name, function in functions.items():
                    function.continue_at(calls[name].start)
                while loop.status is None and any(one.is_wanted(calls[name]) for name, one in functions.items()):
                    loop.run(len(loop.record.rows) + 1)
                prefix_of(loop).check(golden.log)

    def golden(self, detector: Detector | None = None, arm: str = "") -> Track:
        """The golden flight, flown on first use."""
        if arm not in self._golden:
            self._golden[arm] = self._first() if detector is None else self._watched(detector)
        return self._golden[arm]

    def _first(self) -> Track:
        """The golden flight without a detector, from take-off."""
        loop = self.loop
        branch = Branch(self, None, keeps=True)
        loop.taps.injector = CounterWatch()
        loop.begin()
        branch.keep(take(loop, scratch=self.scratch))
        track = branch.fly()
        self._profile = loop.record.publications.profile()
        loop.record.publications.wanted = False
        return track

    def _watched(self, detector: Detector) -> Track:
        """The golden flight with a detector."""
        plain = self.golden()
        branch = Branch(self, detector, [plain], keeps=True)
        detector.start()
        branch.begin(plain, plain.checkpoints[0])
        branch.loop.taps.injector = CounterWatch()
        branch.keep(plain.checkpoints[0].here)
        branch.follow(plain, 0)
        return branch.fly()

    def _unwatched(self, fault: StateFault) -> Track:
        """The injected run without a detector; the latest one is cached."""
        if self._last is None or self._last[0] != fault:
            self._last = fault, self._injected(fault, None, "")
        return self._last[1]

    def _injected(self, fault: StateFault, detector: Detector | None, arm: str) -> Track:
        own, plain = self.golden(detector, arm), self.golden()
        rows = own.before(fault.time_us)
        start = own.checkpoints[rows]
        assert isinstance(start.injector, CounterWatch)  # a golden flight's tap
        injector = StateInjector(fault, start.injector)
        as_plain = rows in plain.checkpoints and start.instant is plain.checkpoints[rows].instant
        # if the prefix has no alarms, the run without a detector is identical up to the first alarm
        along = self._unwatched(fault) if detector is not None and as_plain and not injector.spent else None
        keeps = self.watched and detector is None
        branch = Branch(self, detector, [plain] if along is None else [along, plain], own, keeps=keeps)
        branch.begin(own, start)
        branch.loop.taps.injector = injector
        branch.remember(start.detector)
        if injector.spent:
            branch.converge(own, rows)
        elif along is not None:
            branch.follow(along, rows)
        else:
            put(branch.loop, start.here)
            if keeps:
                branch.keep(start.here)
        return branch.fly()


class Branch:
    """A flight in progress; it may converge to the `known` flights or to `own`, the golden flight with its detector.

    With `keeps` it has checkpoints; with `shows`, which `keeps` implies, it records publications in `shown`.
    `comparable` states whether checkpoints contain everything in which it may differ from the known flights.
    """

    def __init__(
        self, forward: FastForward, detector: Detector | None, known: Sequence[Track] = (), own: Track | None = None,
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
        self.loop.status, self.loop.taps.detector, self.loop.taps.seal = None, None, None
        self._watch()
        self._shows = keeps or shows
        self.loop.taps.recorders[:] = [lambda state, now: self.shown.append((state, now))] if self._shows else []

    def _watch(self) -> None:
        if self._detector is not None:
            tap = Watch(self.loop, self._detector.content, self._recovery)
            taps = self.loop.taps
            taps.detector, taps.watched, taps.seal = tap, tap.states, tap.seal if tap.seals else None

    def remember(self, saved: Any) -> None:  # noqa: ANN401
        """Restore the detector's memory, if there is a detector, from a checkpoint."""
        if self._detector is not None:
            self._detector.restore(saved)
            self._watch()  # restoring may have replaced the object

    # ---- the record -------------------------------------------------------------------------------------------------
    def begin(self, track: Track, start: Checkpoint) -> None:
        """Start with another flight's record up to a checkpoint."""
        record = self.loop.record
        record.rows, record.events = track.rows[: start.rows], track.log.events[: start.events]
        record.alarms, self.shown = list(start.alarms), track.shown[: start.shown]
        record.set_counts(start.counts)

    def keep(self, instant: Instant) -> None:
        """Store a checkpoint at the current number of rows."""
        self._checkpoints[len(self.loop.record.rows)] = self._checkpoint(instant)

    def _checkpoint(self, instant: Instant | None = None) -> Checkpoint:
        record, injector = self.loop.record, self.loop.taps.injector
        assert isinstance(injector, (CounterWatch, StateInjector))  # installed in every flight of this class
        return Checkpoint(
            instant, len(record.rows), len(record.events), len(self.shown), tuple(record.alarms), record.counts(),
            injector.copy(), None if self._detector is None else self._detector.save(),
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
        if self._detector is None or self._alarms(track.shown[start.shown : there.shown], self._detector.content):
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

    def follow(self, track: Track, rows: int) -> None:
        """Reuse a flight without a detector, to its end or to the first alarm on its publications."""
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
        """Whether the remainder equals that of the golden flight with the same detector."""
        known = None if self._own is None else self._own.checkpoints.get(here.rows)
        return known is not None and known.instant is here.instant and self._is_through() and self._same_detector(known)

    def _is_through(self) -> bool:
        """Whether injector and recovery have no further effect."""
        injector = self.loop.taps.injector
        return not self.loop.awaited and not self.loop.requests and injector is not None and injector.spent

    def _same_detector(self, known: Checkpoint) -> bool:
        return self._detector is None or self._detector.same(known.detector)

    def _alarms(self, shown: list[tuple[State, int]], detector: Detector) -> bool:
        watched, admit = self.loop.taps.watched, admission(detector)
        seen = (one for one in shown if watched is None or one[0].spec.name in watched)
        return any(admit(state, now) is not None for state, now in seen)

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
        elif other is not None:
            self.follow(other, rows)

    def _converged(self) -> Track | None:
        """A known flight in the current state; None = none."""
        loop, seen = self.loop, set()
        for track in (*self._known, self._own):
            here = None if track is None else track.checkpoints.get(len(loop.record.rows))
            if track is None or here is None or not here.injector.spent or id(here.instant) in seen:
                continue  # the other flight's injection is still pending
            seen.add(id(here.instant))
            if track is self._own and not self._same_detector(here):
                continue
            if isinstance(loop.taps.injector, CounterWatch) and not loop.taps.injector.same(here.injector):
                continue
            if is_at(loop, here.here):
                return track
        return None
