"""A flight in progress that reuses parts of known flights of its mission: simulated only where it differs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.faults.acted_on import CounterWatch
from mavfi.faults.injector import RewindableInjector
from mavfi.flight.checkpoints import Checkpoint, Instant, is_at, put, take
from mavfi.flight.compose import install
from mavfi.flight.known_flights import FlownArm, KnownFlight
from mavfi.flight.loop import Loop
from mavfi.record import Event, FlightLog
from mavfi.states import State


@dataclass(slots=True)
class SimulatedShare:
    """Share of the flights that was simulated.

    Attributes:
        ticks: Control periods of all flights.
        simulated: Those of them that were simulated.
        replayed: Those in which a detector only checked the publications of a known flight.
        converged: Number of flights that converged to another one before their end.
    """

    ticks: int = 0
    simulated: int = 0
    replayed: int = 0
    converged: int = 0


class BranchedLoop:
    """The loop that flies all flights of a mission.

    Attributes:
        loop: The loop.
        pitch: Control periods between two checkpoints.
        scratch: Whether golden checkpoints contain the work arrays of kernels, so that faults in instructions can be
            injected after them: if that is requested, and all of these can be saved.
        share: Counts the simulated part of the flights.
    """

    loop: Loop
    pitch: int
    scratch: bool
    share: SimulatedShare


class FlightBranch:
    """A flight that begins with the record of a known flight up to a checkpoint, and so does its detector.

    The loop itself does not move: `put` it to the checkpoint, or `follow` a known flight.

    Args:
        forward: What flies it.
        arm: Detector and recovery policy of this flight.
        start: The checkpoint.
        before: The known flight; None = the checkpoint is before take-off.
        others: Known flights that it may follow: the golden flight without a detector, and those with the same fault.
        own_golden: The golden flight of its arm; None = this one is it.
        keeps_checkpoints: Whether it takes checkpoints, and so records publications: other flights may follow it.
        keeps_publications: Whether it records publications.

    Attributes:
        loop: The loop that flies it.
        keeps_checkpoints: As above.
        publications: Recorded publications, with their instants (us).
        comparable: Whether checkpoints contain everything in which it may differ from the known flights.
    """

    def __init__(
        self,
        forward: BranchedLoop,
        arm: FlownArm,
        start: Checkpoint,
        before: KnownFlight | None,
        others: Sequence[KnownFlight] = (),
        own_golden: KnownFlight | None = None,
        *,
        keeps_checkpoints: bool = False,
        keeps_publications: bool = False,
    ) -> None:
        self.loop = forward.loop
        self.keeps_checkpoints = keeps_checkpoints
        self.comparable: Callable[[], bool] = lambda: True
        self._forward = forward
        self._arm = arm
        self._others = others
        self._own_golden = own_golden
        self._keeps_publications = keeps_checkpoints or keeps_publications
        self._checkpoints: dict[int, Checkpoint] = {}
        self._has_simulated = False
        self._log: FlightLog | None = None

        # The record so far.
        rows: list[np.ndarray] = []
        events: list[Event] = []
        self.publications: list[tuple[State, int]] = []
        if before is not None:
            rows = before.rows[: start.rows]
            events = before.log.events[: start.events]
            self.publications = before.publications[: start.publications]
        record = self.loop.record
        record.rows = rows
        record.events = events
        record.alarms = list(start.alarms)
        record.set_counts(start.counts)

        # The taps: nothing is left of the previous flight.
        self.loop.reset()
        self.loop.watch_losses()
        self.loop.taps.injector = start.injector.copy()
        if self._keeps_publications:
            self.loop.taps.recorders.append(lambda state, now: self.publications.append((state, now)))
        self._detector = arm.detector
        self._tap: Any = None
        if arm.detector is None:
            return
        self._tap = install(self.loop, arm.detector, arm.recovery, self.publications)
        if start.detector is None:  # that of a flight without one
            arm.detector.start()
        else:
            self._restore_detector(start.detector)

    # ---- the detector -----------------------------------------------------------------------------------------------
    def _detector_memory(self) -> Any:  # noqa: ANN401
        """The memory of detector and recovery; None = there is no detector."""
        if self._detector is None:
            return None
        return self._detector.memory(), self._tap.memory.copy()

    def _restore_detector(self, saved: Any) -> None:  # noqa: ANN401
        """Restore the memory of detector and recovery."""
        assert self._detector is not None  # precondition
        detector_memory, recovery_memory = saved
        self._detector.restore(detector_memory)
        self._tap.memory = recovery_memory.copy()

    def _has_detector_memory(self, checkpoint: Checkpoint) -> bool:
        """Whether detector and recovery remember the same as at a checkpoint of a flight of this arm."""
        if self._detector is None:
            return True
        detector_memory, recovery_memory = checkpoint.detector
        return bool(self._detector.memory() == detector_memory and self._tap.memory.same(recovery_memory))

    # ---- checkpoints of this flight ---------------------------------------------------------------------------------
    def store_checkpoint(self, instant: Instant) -> None:
        """Store a checkpoint at the current number of rows."""
        self._checkpoints[len(self.loop.record.rows)] = self._new_checkpoint(instant)

    def _new_checkpoint(self, instant: Instant | None) -> Checkpoint:
        """A checkpoint of the record so far, with the state of the loop at it; None = the flight has ended."""
        record = self.loop.record
        injector = self.loop.taps.injector
        assert isinstance(injector, (CounterWatch, RewindableInjector))  # installed in every flight of this class
        return Checkpoint(
            instant,
            len(record.rows),
            len(record.events),
            len(self.publications),
            tuple(record.alarms),
            record.counts(),
            injector.copy(),
            self._detector_memory(),
        )

    # ---- reuse of known flights -------------------------------------------------------------------------------------
    def _append(self, known_flight: KnownFlight, piece_start: Checkpoint, piece_end: Checkpoint) -> None:
        """Append another flight's record between two of its checkpoints; the loop itself does not move."""
        record = self.loop.record
        log = known_flight.log
        record.rows += known_flight.rows[piece_start.rows : piece_end.rows]
        record.events += log.events[piece_start.events : piece_end.events]
        record.alarms += log.alarms[len(piece_start.alarms) : len(piece_end.alarms)]
        if self._keeps_publications:
            self.publications += known_flight.publications[piece_start.publications : piece_end.publications]
        counts = zip(record.counts(), piece_start.counts, piece_end.counts, strict=True)
        record.set_counts(count + after - before for count, before, after in counts)
        if piece_end is known_flight.end:
            self._log = self.loop.log(log.status, log.meta["rejected_commands"])
        elif self.keeps_checkpoints:
            self.store_checkpoint(piece_end.here)

    def append_rest(self, known_flight: KnownFlight, rows: int) -> None:
        """Reuse the remainder of another flight."""
        self._forward.share.converged += 1
        if self.keeps_checkpoints:
            for piece_start, piece_end in known_flight.pieces(rows):
                self._append(known_flight, piece_start, piece_end)
        else:
            self._append(known_flight, known_flight.checkpoints[rows], known_flight.end)

    def follow(self, known_flight: KnownFlight, rows: int, *, loop_is_there: bool = False) -> None:
        """Reuse another flight, to its end, to an alarm of its own detector, or to the first one on its publications.

        `loop_is_there`: the loop is at the checkpoint at `rows`.
        """
        for piece_start, piece_end in known_flight.pieces(rows):
            # Without a detector nothing can happen any more, nor if the golden flight of this arm continues from here.
            if self._detector is None:
                self.append_rest(known_flight, piece_start.rows)
                return
            if self._own_golden is not None and self._continues_as_golden(self._own_golden, piece_start):
                self.append_rest(self._own_golden, piece_start.rows)
                return

            # Else the detector checks the publications of one piece after the other.
            memory = self._detector_memory()
            if self.append_unless_alarm(known_flight, piece_start, piece_end):
                continue

            # An alarm changes the flight: simulate this piece, from its start.
            self._restore_detector(memory)
            if not (loop_is_there and piece_start.rows == rows):
                put(self.loop, piece_start.here)
            return

    def append_unless_alarm(self, known_flight: KnownFlight, piece_start: Checkpoint, piece_end: Checkpoint) -> bool:
        """Reuse a flight between two of its checkpoints; False, without effect on the record, at an alarm."""
        if len(piece_end.alarms) > len(piece_start.alarms):  # of its own detector
            return False
        if self._raises_alarm(known_flight, piece_start, piece_end):
            return False
        self._forward.share.replayed += piece_end.rows - piece_start.rows
        if not self._has_simulated or isinstance(self.loop.taps.injector, CounterWatch):
            self.loop.taps.injector = piece_end.injector.copy()  # else it has the record of this flight's injection
        self._append(known_flight, piece_start, piece_end)
        return True

    def _raises_alarm(self, known_flight: KnownFlight, piece_start: Checkpoint, piece_end: Checkpoint) -> bool:
        """Whether the detector raises an alarm on publications of another flight, or fails on one.

        In the latter case it is called again in the simulated flight, which may disable it.
        """
        assert self._detector is not None  # precondition
        if self._tap.memory.crashed:
            return False
        watched_states = self.loop.taps.watched
        for state, now in known_flight.publications[piece_start.publications : piece_end.publications]:
            if watched_states is not None and state.spec.name not in watched_states:
                continue
            try:
                if self._detector.check(state, now) is not None:
                    return True
                self._detector.accept(state, now)
            except Exception:  # noqa: BLE001 - any exception of a user's detector
                return True
        return False

    def _continues_as_golden(self, own_golden: KnownFlight, checkpoint: Checkpoint) -> bool:
        """Whether the remainder from a checkpoint of another flight equals that of the golden flight of this arm."""
        golden_checkpoint = own_golden.checkpoints.get(checkpoint.rows)
        if golden_checkpoint is None or golden_checkpoint.instant is not checkpoint.instant:
            return False
        return self._is_settled() and self._has_detector_memory(golden_checkpoint)

    # ---- simulation -------------------------------------------------------------------------------------------------
    def fly(self) -> KnownFlight:
        """Continue to the end; simulate where no known flight can be reused."""
        loop = self.loop
        record = loop.record
        pitch = self._forward.pitch
        while self._log is None:
            # Simulate up to the next checkpoint, or the end.
            self._has_simulated = True
            rows = len(record.rows)
            loop.run((rows // pitch + 1) * pitch)
            self._forward.share.simulated += len(record.rows) - rows
            if loop.status is None:
                self._arrive_at_checkpoint()
            else:
                self._log = loop.flight().log
        loop.taps.recorders.clear()
        return KnownFlight(self._log, record.rows, self.publications, self._checkpoints, self._new_checkpoint(None))

    def _arrive_at_checkpoint(self) -> None:
        """Reuse a known flight to which the state has converged; else take a checkpoint if others may need it."""
        rows = len(self.loop.record.rows)
        known_flight = None
        if self._is_settled() and self.comparable():
            known_flight = self._find_converged()
        if known_flight is None:
            if self.keeps_checkpoints:
                # Instruction faults are injected after golden checkpoints: these need the work arrays of kernels, too.
                self.store_checkpoint(take(self.loop, scratch=self._forward.scratch and self._own_golden is None))
            return
        if self.keeps_checkpoints:
            # the same object, by which flights recognize that they share a state
            self.store_checkpoint(known_flight.checkpoints[rows].here)
        if known_flight is self._own_golden:
            self.append_rest(known_flight, rows)
        elif not self._arm.takes_part:
            self.follow(known_flight, rows, loop_is_there=True)

    def _is_settled(self) -> bool:
        """Whether injector and recovery have no further effect."""
        flight = self.loop.state
        injector = self.loop.taps.injector
        return not flight.awaited and not flight.requests and injector is not None and injector.spent

    def _find_converged(self) -> KnownFlight | None:
        """A known flight in the current state that can be followed from here; None = none."""
        loop = self.loop
        rows = len(loop.record.rows)
        # Whether the loop is at an instant, by its identity: the comparison takes long, and several flights share one.
        is_here: dict[int, bool] = {}
        known_flights = list(self._others)
        if self._own_golden is not None:
            known_flights.append(self._own_golden)
        for known_flight in known_flights:
            checkpoint = known_flight.checkpoints.get(rows)
            if checkpoint is None or not checkpoint.injector.spent:
                continue  # the other flight's injection is still pending
            if known_flight is self._own_golden:
                if not self._has_detector_memory(checkpoint):
                    continue  # the detector remembers something else, and may act otherwise
            else:
                _, piece_end = next(known_flight.pieces(rows))
                if len(piece_end.alarms) > len(checkpoint.alarms):
                    continue  # its own detector raises an alarm at once: nothing of it could be followed
            if isinstance(loop.taps.injector, CounterWatch) and not loop.taps.injector.same(checkpoint.injector):
                continue  # a later injector would count publications otherwise
            instant = checkpoint.here
            if id(instant) not in is_here:
                is_here[id(instant)] = is_at(loop, instant)
            if is_here[id(instant)]:
                return known_flight
        return None
