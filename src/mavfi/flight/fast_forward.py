"""Fast-forward: flies the injected runs of one mission, under several detectors, and simulates common parts once.

`FastForward.fly` returns bit for bit the results of `mavfi.flight.fly.fly`.  Four steps save work:

1. Golden checkpoint: an injected run starts from the golden flight's last checkpoint before the fault.
2. Convergence: at each checkpoint where plant, kernels and queue are those of a known flight, its remainder is reused.
3. Replay to the first alarm: a detector without alarms has no effect.  Where the flight without it is known, the
   detector only checks the publications of that flight; at its first alarm, simulation continues from the preceding
   checkpoint.
4. Shared flights after alarms: after an alarm, a flight may converge to one with the same fault under another detector,
   and follows it between that detector's alarms.

The last two are not done for a detector that takes part in flights without an alarm, or that checks corrupted
publications before the fault, see `known_flights.FlownArm`.
Instruction faults use the same golden flights and the same convergence, see `flight.from_checkpoints`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from mavfi.errors import MavfiError
from mavfi.faults.acted_on import CounterWatch
from mavfi.faults.fault import Fault, find_level
from mavfi.faults.injector import Injector
from mavfi.flight.branches import BranchedLoop, FlightBranch, SimulatedShare
from mavfi.flight.checkpoints import Checkpoint, can_save_kernels, has_scratch, put, take
from mavfi.flight.compose import new_loop
from mavfi.flight.counted_functions import CountedFunction
from mavfi.flight.host import Flight
from mavfi.flight.known_flights import NO_DETECTOR, FlownArm, KnownFlight, check_prefix
from mavfi.flight.loop import Listener, Profiler
from mavfi.ir.injection.variant import Resolving
from mavfi.mission import Scenario
from mavfi.pipeline.functions import ENTRIES, PLAIN
from mavfi.record import Profile
from mavfi.sim.controller import is_rewindable
from mavfi.states import states_with

TICKS = {"dense": 50, "octree": 200}
"""Control periods between two checkpoints, by map kind: an octree is copied whole each time."""


class FastForward(BranchedLoop):
    """All flights of one mission.

    The record of its loop counts the calls of `functions`, and checkpoints contain the counts.

    Attributes:
        functions: The functions of its kernels, at whose calls flights can fork, by name.
        supported: Whether checkpoints can contain the mission's kernels.
        watched: Whether injected runs are flown with detectors as well: these continue from checkpoints of injected
            runs without one, which otherwise have none.

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
        for function in self.functions.values():
            function.attach(self.loop)
        self.supported = can_save_kernels(self.loop)
        self.scratch = scratch and has_scratch(self.loop)
        self.watched = True
        self.pitch = TICKS.get(scenario.map.kind, TICKS["octree"])
        self.share = SimulatedShare()
        self._golden: dict[str, KnownFlight] = {}
        self._profile: Profile | None = None
        self._latest_fault: Fault | None = None
        self._flights_with_fault: dict[str, KnownFlight] = {}  # the latest one, by arm
        self._take_off: Checkpoint | None = None

    def fly(self, fault: Fault | None = None, arm: FlownArm = NO_DETECTOR) -> Flight:
        """Fly, reusing known parts; only the golden flight without a detector has a profile.

        Args:
            fault: The fault; None = golden flight.
            arm: Detector, initialized at the start of each flight, and recovery policy.
        """
        with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
            if fault is None:
                known_flight = self.golden(arm)
            else:
                known_flight = self._with_fault(fault, arm)
        self.share.ticks += len(known_flight.rows)
        if fault is None and arm.detector is None:
            return Flight(known_flight.log, self._profile)
        return Flight(known_flight.log)

    # ---- golden flights ---------------------------------------------------------------------------------------------
    def golden(self, arm: FlownArm = NO_DETECTOR) -> KnownFlight:
        """The golden flight of an arm, flown on first use."""
        if arm.name not in self._golden:
            if arm.detector is None or arm.takes_part:
                self._golden[arm.name] = self._simulate_golden(arm)
            else:
                # A detector that acts on alarms alone follows the flight without one.
                plain = self.golden()
                branch = FlightBranch(self, arm, plain.checkpoints[0], plain, [plain], keeps_checkpoints=True)
                branch.store_checkpoint(plain.checkpoints[0].here)
                branch.follow(plain, 0)
                self._golden[arm.name] = branch.fly()
        return self._golden[arm.name]

    def _simulate_golden(self, arm: FlownArm) -> KnownFlight:
        """A golden flight from take-off; the one without a detector leaves the profile."""
        if self._take_off is None:
            self.loop.begin()
            instant = take(self.loop, scratch=self.scratch)
            counts = (0,) * len(self.loop.record.counts())
            self._take_off = Checkpoint(instant, 0, 0, 0, (), counts, CounterWatch(), None)
        others = [self._golden[""]] if "" in self._golden else []
        branch = FlightBranch(self, arm, self._take_off, None, others, keeps_checkpoints=True)
        branch.store_checkpoint(self._take_off.here)
        put(self.loop, self._take_off.here)
        if arm.detector is not None:
            return branch.fly()
        profiler = Profiler(states_with(self.loop.scenario.localization.kind).values())
        self.loop.taps.recorders.append(profiler)
        known_flight = branch.fly()
        self._profile = profiler.profile()
        return known_flight

    # ---- flights with faults in publications -------------------------------------------------------------------------
    def _with_fault(self, fault: Fault, arm: FlownArm) -> KnownFlight:
        """The injected run of an arm, flown with as much of the known flights as possible."""
        if self._latest_fault != fault:
            self._latest_fault = fault
            self._flights_with_fault = {}
        if arm.detector is None and "" in self._flights_with_fault:
            return self._flights_with_fault[""]

        # A detector that may act before its first alarm has nothing in common with the flights of other arms.
        own_golden = self.golden(arm)
        if arm.takes_part or arm.checks_before_injector(fault.changed_state):
            return self._fly_injected(fault, arm, own_golden, [])

        plain_golden = self.golden()
        without_detector = None
        others = [plain_golden]
        if arm.detector is not None:
            # Up to its first alarm it equals the run without a detector, if no alarm precedes the fault.
            rows = own_golden.before(fault.time_us)
            if fault.has_site and own_golden.shares_instant(plain_golden, rows):
                without_detector = self._with_fault(fault, NO_DETECTOR)
            # After an alarm it may converge to the golden flight, or to one with the fault under another detector.
            with_fault = [flight for flight in self._flights_with_fault.values() if flight.checkpoints]
            others = [*with_fault, plain_golden]
        known_flight = self._fly_injected(
            fault, arm, own_golden, others, without_detector, keeps_checkpoints=self.watched
        )
        self._flights_with_fault[arm.name] = known_flight
        return known_flight

    def _fly_injected(
        self,
        fault: Fault,
        arm: FlownArm,
        own_golden: KnownFlight,
        others: Sequence[KnownFlight],
        without_detector: KnownFlight | None = None,
        *,
        keeps_checkpoints: bool = False,
    ) -> KnownFlight:
        """Fly from the last golden checkpoint before a fault, along the run without a detector while both are equal."""
        rows = own_golden.before(fault.time_us)
        start = own_golden.checkpoints[rows]
        branch = FlightBranch(self, arm, start, own_golden, others, own_golden, keeps_checkpoints=keeps_checkpoints)
        # The injector continues from the counters of the golden flight's tap, which the branch has installed.
        injector: Injector = find_level(fault.level).inject(self.loop, fault, None)
        if injector.spent:  # the fault has no site
            branch.append_rest(own_golden, rows)
        elif without_detector is not None:
            branch.follow(without_detector, rows)
        else:
            put(self.loop, start.here)
            if keeps_checkpoints:
                branch.store_checkpoint(start.here)
        return branch.fly()

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
                FlightBranch(self, NO_DETECTOR, piece_start, golden)
                put(loop, piece_start.here)
                for name, function in functions.items():
                    function.continue_at(calls[name].start)
                while loop.status is None and any(
                    function.is_wanted(calls[name]) for name, function in functions.items()
                ):
                    loop.run(len(loop.record.rows) + 1)
                check_prefix(loop, golden.log)
