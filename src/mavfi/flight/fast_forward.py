"""Fast-forward: flies the injected runs of one mission, under several detectors, and simulates common parts once.

`FastForward.fly` returns bit for bit the results of `mavfi.flight.fly.fly`.  Four steps save work:

1. Golden checkpoint: an injected run starts from the golden flight's last checkpoint before the fault.
2. Convergence: at each checkpoint where plant, kernels and queue are those of a known flight, its remainder is reused.
3. Replay to the first alarm: a detector without alarms has no effect.  Where the flight without it is known, the
   detector only checks the publications of that flight; at its first alarm, simulation continues from the preceding
   checkpoint.
4. Shared flights after alarms: after an alarm, a flight may converge to one with the same fault under another detector,
   and follows it between that detector's alarms.

The last two are not done for a detector that takes part in flights without an alarm, see `takes_part`, or that checks
corrupted publications before the fault, see `checks_before`.
Instruction faults use the same golden flights and the same convergence, see `flight.forks`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.errors import MavfiError
from mavfi.faults.fault import Fault, find_level
from mavfi.faults.injector import RewindableInjector
from mavfi.flight.acted_on import CounterWatch
from mavfi.flight.checkpoints import (
    Checkpoint,
    Instant,
    can_save_kernels,
    has_scratch,
    is_at,
    put,
    take,
)
from mavfi.flight.compose import install, new_loop, restarts_for
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.host import Flight
from mavfi.flight.loop import CONTROL_PERIOD_US, Listener, Loop
from mavfi.flight.taps import CHECKED_AT_PRODUCER
from mavfi.ir.injection.variant import Resolving
from mavfi.mission import Scenario
from mavfi.pipeline.functions import ENTRIES, PLAIN
from mavfi.record import FlightLog, Profile
from mavfi.sim.controller import is_rewindable
from mavfi.states import STATES, State

TICKS = {"dense": 50, "octree": 200}
"""Control periods between two checkpoints, by map kind: an octree is copied whole each time."""


# ---- golden flights stopped early -----------------------------------------------------------------------------------
def fly_until(loop: Loop, may_stop: Callable[[], bool]) -> Flight | None:
    """Fly a loop from its start until `may_stop`, called after each control period, is true; None = it was stopped."""
    loop.begin()
    while loop.status is None and not may_stop():
        loop.run(len(loop.record.rows) + 1)
    if loop.status is None:
        return None
    return loop.flight()


def check_prefix(loop: Loop, golden: FlightLog) -> None:
    """Check that a loop has flown the start of a golden flight, bit for bit, and the whole if it has ended.

    Raises:
        MavfiError: The flights differ.
    """
    rows = np.asarray(loop.record.rows)
    same = rows.tobytes() == golden.rows[: len(rows)].tobytes()
    if loop.status is not None:
        same = same and loop.status is golden.status and len(rows) == len(golden.rows)
    if not same:
        raise MavfiError("two golden flights of one mission differ: no fault can be addressed")


# ---- functions whose calls are counted ------------------------------------------------------------------------------
class CallResult(NamedTuple):
    """A call that was made by somebody else, with its result."""

    result: Any


Intercept = Callable[[str, int, Callable[..., Any], tuple[Any, ...]], CallResult | None]
"""Called before each call with name, number of the call, function and arguments; None = the call is made as usual."""


class CountedFunction:
    """A compiled function, called in its place; calls are counted in the record of a flight.

    Calls that repeat others for verification are not counted: faults address calls of first executions, as in flights
    without a detector.

    Attributes:
        intercept: May take calls over; None = no call is.
    """

    def __init__(self, name: str, function: Callable[..., Any]) -> None:
        self.intercept: Intercept | None = None
        self._name = name
        self._function = function
        self._loop: Loop | None = None

    def attach(self, loop: Loop) -> None:
        """Count calls in the record of a loop."""
        self._loop = loop
        loop.record.calls[self._name] = 0

    @contextmanager
    def replaced(self, function: Callable[..., Any]) -> Iterator[None]:
        """Call another function, which returns the same."""
        original = self._function
        self._function = function
        try:
            yield
        finally:
            self._function = original

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        loop = self._loop
        if loop is None or loop.repeating:
            return self._function(*args)
        call = loop.record.calls[self._name]
        loop.record.calls[self._name] = call + 1
        if self.intercept is not None:
            intercepted = self.intercept(self._name, call, self._function, args)
            if intercepted is not None:
                return intercepted.result
        return self._function(*args)


# ---- known flights --------------------------------------------------------------------------------------------------
@dataclass(slots=True)
class SimulatedShare:
    """Share of the flights that was simulated.

    Attributes:
        flights: Number of flights.
        ticks: Control periods of all flights.
        flown: Those of them that were simulated.
        shown: Those in which a detector only checked the publications of a known flight.
        converged: Number of flights that converged to another one before their end.
    """

    flights: int = 0
    ticks: int = 0
    flown: int = 0
    shown: int = 0
    converged: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class FlownArm:
    """Detector (None = none) and recovery policy of a flight; a name always stands for the same two."""

    name: str = ""
    detector: Detector | None = None
    recovery: RecoveryPolicy = INLINE


NO_DETECTOR = FlownArm()


def takes_part(detector: Detector | None, recovery: RecoveryPolicy) -> bool:
    """Whether a detector acts without an alarm, or answers one depending on earlier events other than its alarms.

    It seals values before they are published, has unreadable ones sent again, has steps computed twice, or waits for
    answers and restarts nodes.  Otherwise it has no effect up to its first alarm, and the publications of a flight are
    all that it needs.
    """
    if detector is None:
        return False
    if recovery.remembers or recovery.resends:
        return True
    return detector.seals or bool(detector.duplicates)


def checks_before(arm: FlownArm, fault: Fault) -> bool:
    """Whether an arm's detector checks the corrupted state before the fault: it does not see what flights publish."""
    if arm.detector is None:
        return False
    return STATES[fault.changed_state].stage in CHECKED_AT_PRODUCER[arm.recovery.detector_place]


@dataclass(frozen=True, slots=True, eq=False)
class KnownFlight:
    """A completed flight, which others may follow.

    Attributes:
        log: Its log.
        rows: Rows of the log.
        publications: Publications with their instants (us), in order; empty if it has no checkpoints.
        checkpoints: Checkpoints by number of rows before them.
        end: Its end.
    """

    log: FlightLog
    rows: list[np.ndarray]
    publications: list[tuple[State, int]]
    checkpoints: dict[int, Checkpoint]
    end: Checkpoint

    def before(self, time_us: int) -> int:
        """Number of rows of the last checkpoint before an instant (us); 0 if there is none."""
        return max((rows for rows in self.checkpoints if rows * CONTROL_PERIOD_US < time_us), default=0)

    def pieces(self, rows: int) -> Iterator[tuple[Checkpoint, Checkpoint]]:
        """Pairs of consecutive checkpoints from `rows` on, up to the end."""
        later = [self.checkpoints[number] for number in sorted(self.checkpoints) if number >= rows]
        return pairwise([*later, self.end])

    def is_silent(self, rows: int) -> bool:
        """Whether its own detector, if there is one, raises no alarm before the checkpoint after the one at `rows`."""
        piece_start, piece_end = next(self.pieces(rows))
        return len(piece_start.alarms) == len(piece_end.alarms)


class FlightBranch:
    """A flight in progress that reuses parts of known flights of its mission.

    Args:
        forward: All flights of the mission.
        arm: Detector and recovery policy of this flight.
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
        forward: "FastForward",
        arm: FlownArm,
        others: Sequence[KnownFlight] = (),
        own_golden: KnownFlight | None = None,
        *,
        keeps_checkpoints: bool = False,
        keeps_publications: bool = False,
    ) -> None:
        self.loop: Loop = forward.loop
        self.publications: list[tuple[State, int]] = []
        self.comparable: Callable[[], bool] = lambda: True
        self._forward = forward
        self._arm = arm
        self._others = others
        self._own_golden = own_golden
        self.keeps_checkpoints = keeps_checkpoints
        self._keeps_publications = keeps_checkpoints or keeps_publications
        self._checkpoints: dict[int, Checkpoint] = {}
        self._has_simulated = False
        self._log: FlightLog | None = None

        # Remove what the previous flight has left in the loop.
        self.loop.status = None
        self.loop.verify = None
        self.loop.single_image = False
        self.loop.taps.loses_unnoticed = False
        self.loop.taps.detector = None
        self.loop.taps.checked_at_producer = frozenset()
        self.loop.taps.seal = None
        self.loop.taps.answer_loss = None
        self.loop.taps.recorders.clear()
        if self._keeps_publications:
            self.loop.taps.recorders.append(lambda state, now: self.publications.append((state, now)))

        # Attach the detector.
        self._detector = arm.detector
        self._restarts = None
        if arm.detector is not None:
            self._restarts = restarts_for(self.loop, arm.recovery)
        self._tap = self._new_tap()

    def _new_tap(self) -> Any:  # noqa: ANN401 - the tap of the detector; None = there is no detector
        if self._detector is None:
            return None
        return install(self.loop, self._detector, self._arm.recovery, self._restarts)

    def _detector_memory(self) -> Any:  # noqa: ANN401
        """The memory of detector and recovery; None = there is no detector."""
        if self._detector is None:
            return None
        return self._detector.memory(), self._tap.memory.copy()

    def restore_detector(self, saved: Any) -> None:  # noqa: ANN401
        """Restore the memory of detector and recovery, if there is a detector, from a checkpoint."""
        if self._detector is None:
            return
        detector_memory, recovery_memory = saved
        self._detector.restore(detector_memory)
        self._tap = self._new_tap()  # a new one asks a detector that has been disabled
        self._tap.memory = recovery_memory.copy()

    def _has_detector_memory(self, checkpoint: Checkpoint) -> bool:
        """Whether detector and recovery remember the same as at a checkpoint of a flight of this arm."""
        if self._detector is None:
            return True
        detector_memory, recovery_memory = checkpoint.detector
        return bool(self._detector.memory() == detector_memory and self._tap.memory.same(recovery_memory))

    # ---- the record -------------------------------------------------------------------------------------------------
    def begin_empty(self) -> None:
        """Start with the record of a flight before take-off."""
        record = self.loop.record
        record.rows = []
        record.events = []
        record.alarms = []
        record.set_counts([0] * len(record.counts()))

    def begin(self, known_flight: KnownFlight, start: Checkpoint) -> None:
        """Start with another flight's record up to a checkpoint; the loop itself does not move."""
        record = self.loop.record
        record.rows = known_flight.rows[: start.rows]
        record.events = known_flight.log.events[: start.events]
        record.alarms = list(start.alarms)
        record.set_counts(start.counts)
        self.publications = known_flight.publications[: start.publications]
        if self._restarts is not None:
            for state, now in self.publications:
                self._restarts.keep(state, now)

    def store_checkpoint(self, instant: Instant) -> None:
        """Store a checkpoint at the current number of rows."""
        self._checkpoints[len(self.loop.record.rows)] = self._new_checkpoint(instant)

    def store_checkpoints_from_now_on(self) -> None:
        """Take checkpoints at all further instants for them."""
        self.keeps_checkpoints = True

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

    # ---- replay -----------------------------------------------------------------------------------------------------
    def follow(self, known_flight: KnownFlight, rows: int, *, loop_is_there: bool = False) -> None:
        """Reuse another flight, to its end, to an alarm of its own detector, or to the first one on its publications.

        `loop_is_there`: the loop is at the checkpoint at `rows`.
        """
        for piece_start, piece_end in known_flight.pieces(rows):
            if self._detector is None:
                self.append_rest(known_flight, piece_start.rows)
                return
            if self._own_golden is not None and self._continues_as_golden(self._own_golden, piece_start):
                self.append_rest(self._own_golden, piece_start.rows)
                return
            memory = self._detector_memory()
            if len(piece_end.alarms) > len(piece_start.alarms) or self._raises_alarm(
                known_flight, piece_start, piece_end
            ):
                # Simulate this piece again, from its start: the alarm changes the flight.
                self.restore_detector(memory)
                if not (loop_is_there and piece_start.rows == rows):
                    put(self.loop, piece_start.here)
                return
            self._forward.share.shown += piece_end.rows - piece_start.rows
            if not self._has_simulated or isinstance(self.loop.taps.injector, CounterWatch):
                self.loop.taps.injector = piece_end.injector.copy()  # else it has the record of this flight's injection
            self._append(known_flight, piece_start, piece_end)

    def append_unless_alarm(self, known_flight: KnownFlight, piece_start: Checkpoint, piece_end: Checkpoint) -> bool:
        """Reuse a flight without a detector between two of its checkpoints; False, without effect, at an alarm."""
        if self._detector is None or self._raises_alarm(known_flight, piece_start, piece_end):
            return False
        self._append(known_flight, piece_start, piece_end)
        return True

    def _raises_alarm(self, known_flight: KnownFlight, piece_start: Checkpoint, piece_end: Checkpoint) -> bool:
        """Whether the detector raises an alarm on publications of another flight, or fails on one.

        In the latter case it is called again in the simulated flight, which may disable it.
        """
        assert self._detector is not None  # precondition
        if self._tap.gave_up:
            return False
        detector = self._detector
        watched_states = self.loop.taps.watched
        for state, now in known_flight.publications[piece_start.publications : piece_end.publications]:
            if watched_states is not None and state.spec.name not in watched_states:
                continue
            try:
                if detector.check(state, now) is not None:
                    return True
                detector.accept(state, now)
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
        record = self.loop.record
        pitch = self._forward.pitch
        while self._log is None:
            self._has_simulated = True
            rows = len(record.rows)
            loop.run((rows // pitch + 1) * pitch)
            self._forward.share.flown += len(record.rows) - rows
            if loop.status is None:
                self._arrive_at_checkpoint()
            else:
                self._log = loop.flight().log
        loop.taps.recorders.clear()
        return KnownFlight(self._log, record.rows, self.publications, self._checkpoints, self._new_checkpoint(None))

    def _arrive_at_checkpoint(self) -> None:
        """Take a checkpoint if others may start here; reuse a known flight if the current state has converged to it."""
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
        elif not takes_part(self._arm.detector, self._arm.recovery):
            self.follow(known_flight, rows, loop_is_there=True)

    def _is_settled(self) -> bool:
        """Whether injector and recovery have no further effect."""
        injector = self.loop.taps.injector
        return not self.loop.awaited and not self.loop.requests and injector is not None and injector.spent

    def _find_converged(self) -> KnownFlight | None:
        """A known flight in the current state that can be followed from here; None = none."""
        loop = self.loop
        rows = len(self.loop.record.rows)
        # Whether the loop is at an instant, by its identity: the comparison takes long, and several flights share one.
        is_here: dict[int, bool] = {}
        known_flights = list(self._others)
        if self._own_golden is not None:
            known_flights.append(self._own_golden)
        for known_flight in known_flights:
            checkpoint = known_flight.checkpoints.get(rows)
            if checkpoint is None or not checkpoint.injector.spent:
                continue  # the other flight's injection is still pending
            if known_flight is self._own_golden and not self._has_detector_memory(checkpoint):
                continue  # the detector remembers something else, and may act otherwise
            if known_flight is not self._own_golden and not known_flight.is_silent(rows):
                continue  # nothing of it could be followed
            if isinstance(loop.taps.injector, CounterWatch) and not loop.taps.injector.same(checkpoint.injector):
                continue  # a later injector would count publications otherwise
            key = id(checkpoint.instant)
            if key not in is_here:
                is_here[key] = is_at(loop, checkpoint.here)
            if is_here[key]:
                return known_flight
        return None


class FastForward:
    """All flights of one mission; `share` counts the simulated part.

    Attributes:
        loop: The loop of all flights; its record counts the calls of `functions`, and checkpoints contain the counts.
        functions: The functions of its kernels, at whose calls flights can fork, by name.
        supported: Whether checkpoints can contain the mission's kernels.
        scratch: Whether checkpoints contain the work arrays of kernels, so that faults in instructions can be injected
            after them: if that is requested, and all of these can be saved.
        watched: Whether injected runs are flown with detectors as well: these continue from checkpoints of injected
            runs without one, which otherwise have none.
        pitch: Control periods between two checkpoints.

    Raises:
        BadInputError: The scenario cannot be flown.
        MavfiError: It uses a flight controller whose state is not part of a checkpoint.
    """

    def __init__(self, scenario: Scenario, *, scratch: bool = False) -> None:
        if not is_rewindable(scenario.flight_controller):
            raise MavfiError(f"flights with the flight controller {scenario.flight_controller} are not fast-forwarded")
        self.functions = {name: CountedFunction(name, getattr(PLAIN, name)) for name in ENTRIES}
        table = PLAIN.instrumented(ENTRIES, lambda name, _: self.functions[name])
        self.loop = new_loop(scenario, rewindable=True, functions=table)
        self.loop.watch_losses()
        for function in self.functions.values():
            function.attach(self.loop)
        self.supported = can_save_kernels(self.loop)
        self.scratch = scratch and has_scratch(self.loop)
        self.watched = True
        self.pitch = TICKS.get(scenario.map.kind, TICKS["octree"])
        self.share = SimulatedShare()
        self._take_off: Instant | None = None
        self._golden: dict[str, KnownFlight] = {}
        self._profile: Profile | None = None
        self._latest_fault: Fault | None = None
        self._flights_with_fault: dict[str, KnownFlight] = {}

    def fly(
        self,
        fault: Fault | None = None,
        detector: Detector | None = None,
        arm: str = "",
        recovery: RecoveryPolicy = INLINE,
    ) -> Flight:
        """Fly, reusing known parts; only the golden flight without a detector has a profile.

        Args:
            fault: The fault; None = golden flight.
            detector: The detector, initialized at the start of each flight; None = none.
            arm: Name of the detector's arm; each name must always denote the same detector and recovery policy.
            recovery: The recovery policy.
        """
        flown_arm = FlownArm(arm, detector, recovery)
        with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
            if fault is None:
                known_flight = self.golden(flown_arm)
            else:
                known_flight = self._with_fault(fault, flown_arm)
        self.share.flights += 1
        self.share.ticks += len(known_flight.rows)
        if fault is None and detector is None:
            return Flight(known_flight.log, self._profile)
        return Flight(known_flight.log)

    # ---- golden flights ---------------------------------------------------------------------------------------------
    def golden(self, arm: FlownArm = NO_DETECTOR) -> KnownFlight:
        """The golden flight of an arm, flown on first use."""
        if arm.name not in self._golden:
            if arm.detector is None or takes_part(arm.detector, arm.recovery):
                self._golden[arm.name] = self._simulate_golden(arm)
            else:
                self._golden[arm.name] = self._replay_golden(arm)
        return self._golden[arm.name]

    def _simulate_golden(self, arm: FlownArm) -> KnownFlight:
        """A golden flight from take-off; the one without a detector leaves the profile."""
        loop = self.loop
        others = [self._golden[""]] if "" in self._golden else []
        branch = FlightBranch(self, arm, others, keeps_checkpoints=True)
        loop.taps.injector = CounterWatch()
        if self._take_off is None:
            loop.begin()
            self._take_off = take(loop, scratch=self.scratch)
        put(loop, self._take_off)
        branch.begin_empty()
        if arm.detector is not None:
            arm.detector.start()
        branch.store_checkpoint(self._take_off)
        loop.record.publications.want_profile = arm.detector is None
        known_flight = branch.fly()
        self._profile = loop.record.publications.profile() or self._profile  # None with a detector
        loop.record.publications.want_profile = False
        return known_flight

    def _replay_golden(self, arm: FlownArm) -> KnownFlight:
        """The golden flight with a detector that acts on alarms alone."""
        assert arm.detector is not None  # the other one is simulated
        plain = self.golden()
        branch = FlightBranch(self, arm, [plain], keeps_checkpoints=True)
        arm.detector.start()
        branch.begin(plain, plain.checkpoints[0])
        self.loop.taps.injector = CounterWatch()
        branch.store_checkpoint(plain.checkpoints[0].here)
        branch.follow(plain, 0)
        return branch.fly()

    # ---- flights with faults in publications -------------------------------------------------------------------------
    def _with_fault(self, fault: Fault, arm: FlownArm) -> KnownFlight:
        """The injected run; the one without a detector is kept for the other arms."""
        if arm.detector is None and "" in self._known_flights(fault):
            return self._known_flights(fault)[""]
        return self._fly_injected(fault, arm)

    def _known_flights(self, fault: Fault) -> dict[str, KnownFlight]:
        """The injected runs that others may follow, by arm; those of the latest fault are kept."""
        if self._latest_fault != fault:
            self._latest_fault = fault
            self._flights_with_fault = {}
        return self._flights_with_fault

    def _fly_injected(self, fault: Fault, arm: FlownArm) -> KnownFlight:
        """The injected run of an arm, flown with as much of the known flights as possible."""
        # Start from the golden flight of the arm at its last checkpoint before the fault.
        own_golden = self.golden(arm)
        rows = own_golden.before(fault.time_us)
        start = own_golden.checkpoints[rows]
        if takes_part(arm.detector, arm.recovery) or checks_before(arm, fault):
            branch = FlightBranch(self, arm, own_golden=own_golden)
            return self._fly_on(branch, own_golden, rows, fault)

        # If nothing has happened so far, the run without a detector is identical up to the first alarm.
        plain_golden = self.golden()
        without_detector = None
        is_plain_start = rows in plain_golden.checkpoints and start.instant is plain_golden.checkpoints[rows].instant
        if arm.detector is not None and is_plain_start and fault.has_site:
            without_detector = self._with_fault(fault, NO_DETECTOR)
        others = [plain_golden]
        if arm.detector is not None:
            others = [
                known_flight
                for known_flight in (*self._known_flights(fault).values(), plain_golden)
                if known_flight.checkpoints
            ]
        branch = FlightBranch(self, arm, others, own_golden, keeps_checkpoints=self.watched)
        known_flight = self._fly_on(branch, own_golden, rows, fault, without_detector)
        self._known_flights(fault)[arm.name] = known_flight
        return known_flight

    def _fly_on(
        self,
        branch: FlightBranch,
        own_golden: KnownFlight,
        rows: int,
        fault: Fault,
        without_detector: KnownFlight | None = None,
    ) -> KnownFlight:
        """Fly from a golden checkpoint, along the run without a detector as far as that is the same."""
        start = own_golden.checkpoints[rows]
        branch.begin(own_golden, start)
        injector = self._inject(fault, start)
        branch.restore_detector(start.detector)
        if injector.spent:  # the fault has no site
            branch.append_rest(own_golden, rows)
        elif without_detector is not None:
            branch.follow(without_detector, rows)
        else:
            put(self.loop, start.here)
            if branch.keeps_checkpoints:
                branch.store_checkpoint(start.here)
        return branch.fly()

    def _inject(self, fault: Fault, start: Checkpoint) -> RewindableInjector:
        """Attach a fault to the loop, which is about to continue from a golden checkpoint."""
        self.loop.taps.injector = start.injector
        injector: RewindableInjector = find_level(fault.level).inject(self.loop, fault, None)
        return injector

    # ---- counting and resolving of instructions ---------------------------------------------------------------------
    @contextmanager
    def instrumented(
        self, functions: Mapping[str, Callable[..., Any]], listeners: Sequence[Listener] = ()
    ) -> Iterator[None]:
        """Call these in the place of functions of the kernels; results must be the same, bit for bit.

        `listeners` are called after each step of a kernel.
        """
        with ExitStack() as stack:
            for name, function in functions.items():
                stack.enter_context(self.functions[name].replaced(function))
            for listener in listeners:
                self.loop.listeners.append(listener)
                stack.callback(self.loop.listeners.remove, listener)
            yield

    def resolve(self, functions: Mapping[str, Resolving]) -> None:
        """Repeat the golden flight without a detector from the checkpoints before wanted calls to these.

        Raises:
            MavfiError: Two golden flights differ.
        """
        golden = self.golden()
        loop = self.loop
        counted = list(loop.record.calls)  # these come first in the counts of a checkpoint
        with self.instrumented(functions), np.errstate(all="ignore"):
            for piece_start, piece_end in golden.pieces(0):
                # Skip pieces of the flight without wanted calls.
                calls = {}
                for name in functions:
                    index = counted.index(name)
                    calls[name] = range(piece_start.counts[index], piece_end.counts[index])
                if not any(function.is_wanted(calls[name]) for name, function in functions.items()):
                    continue

                # Fly the others again, as long as wanted calls are to come.
                FlightBranch(self, NO_DETECTOR).begin(golden, piece_start)
                loop.taps.injector = piece_start.injector.copy()
                put(loop, piece_start.here)
                for name, function in functions.items():
                    function.continue_at(calls[name].start)
                while loop.status is None and any(
                    function.is_wanted(calls[name]) for name, function in functions.items()
                ):
                    loop.run(len(loop.record.rows) + 1)
                check_prefix(loop, golden.log)
