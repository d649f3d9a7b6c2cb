"""Fast-forward: flies the injected runs of one mission, under several detectors, and simulates common parts once.

`FastForward.fly` returns bit for bit the results of `mavfi.hosts.local.fly`.  It saves work in three ways:

- An injected run starts from the golden run's last checkpoint before the fault.
- At each checkpoint where plant, kernels and queue have converged to those of a known flight, its remainder is reused.
- A detector without alarms has no effect.  Where the flight without a detector is known, the detector only checks the
  publications of that flight; at its first alarm, simulation continues from the preceding checkpoint.  After an alarm
  it may follow flights with the same fault under other detectors, between their alarms.  This is not done for a
  detector that takes part in flights without an alarm, see `branch.takes_part`.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.errors import MavfiError
from mavfi.faults.fault import StateFault
from mavfi.faults.instruction import Resolving
from mavfi.faults.state import CounterWatch, StateInjector
from mavfi.flight_log import Profile
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.forking import ForkingFunction
from mavfi.hosts.local.branch import Branch, Share, Track, takes_part
from mavfi.hosts.local.checkpoints import Instant, has_scratch, put, take
from mavfi.hosts.loop.assemble import new_loop
from mavfi.hosts.loop.golden_prefix import prefix_of
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.sim.controller import is_rewindable

TICKS = {"dense": 50, "octree": 200}
"""Control periods between two checkpoints, by map kind: an octree is copied whole each time."""


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
        MavfiError: It uses a flight controller whose state is not part of a checkpoint.
    """

    def __init__(self, scenario: Scenario, *, scratch: bool = False) -> None:
        if not is_rewindable(scenario.flight_controller):
            raise MavfiError(f"flights with the flight controller {scenario.flight_controller} are not fast-forwarded")
        self.functions = {
            field.name: ForkingFunction(field.name, getattr(PLAIN, field.name)) for field in fields(PLAIN)
        }
        table = PLAIN.instrumented(tuple(self.functions), lambda name, _: self.functions[name])
        self.loop = new_loop(scenario, rewindable=True, functions=table)
        self.loop.watch_losses()
        for function in self.functions.values():
            function.attach(self.loop)
        self.scratch = scratch and has_scratch(self.loop)
        self.watched = True
        self.pitch = TICKS.get(scenario.map.kind, TICKS["octree"])
        self.share = Share()
        self._golden: dict[str, Track] = {}
        self._profile: Profile | None = None
        self._fault: StateFault | None = None
        self._same_fault: dict[str, Track] = {}
        self.recovery = INLINE
        self._take_off: Instant | None = None

    def fly(
        self, fault: StateFault | None = None, detector: Detector | None = None, arm: str = "",
        recovery: Recovery = INLINE,
    ) -> Flight:  # fmt: skip
        """Fly, reusing known parts; only the golden flight without a detector has a profile.

        Args:
            fault: The fault; None = golden flight.
            detector: The detector, initialized at the start of each flight; None = none.
            arm: Name of the detector's arm; each name must always denote the same detector and recovery policy.
            recovery: The recovery policy.
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
            if detector is None or takes_part(detector, self.recovery):
                self._golden[arm] = self._simulated(detector)
            else:
                self._golden[arm] = self._watched(detector)
        return self._golden[arm]

    def _simulated(self, detector: Detector | None) -> Track:
        """A golden flight from take-off; the one without a detector leaves the profile."""
        loop, plain = self.loop, self._golden.get("")
        branch = Branch(self, detector, [] if plain is None else [plain], keeps=True)
        loop.taps.injector = CounterWatch()
        if self._take_off is None:
            loop.begin()
            self._take_off = take(loop, scratch=self.scratch)
        put(loop, self._take_off)
        branch.begin_empty()
        if detector is not None:
            detector.start()
        branch.keep(self._take_off)
        loop.record.publications.wanted = detector is None
        track = branch.fly()
        self._profile = loop.record.publications.profile() or self._profile
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
        """The injected run without a detector; the one of the latest fault is cached."""
        return self._tracks(fault).get("") or self._injected(fault, None, "")

    def _tracks(self, fault: StateFault) -> dict[str, Track]:
        """The injected runs that others may follow, by arm; those of the latest fault are kept."""
        if self._fault != fault:
            self._fault, self._same_fault = fault, {}
        return self._same_fault

    def _injected(self, fault: StateFault, detector: Detector | None, arm: str) -> Track:
        own = self.golden(detector, arm)
        rows = own.before(fault.time_us)
        start = own.checkpoints[rows]
        assert isinstance(start.injector, CounterWatch)  # a golden flight's tap
        injector = StateInjector(fault, start.injector)
        derived = not takes_part(detector, self.recovery)
        plain = self.golden() if derived else None
        as_plain = plain is not None and rows in plain.checkpoints and start.instant is plain.checkpoints[rows].instant
        # if the prefix has no alarms, the run without a detector is identical up to the first alarm
        along = self._unwatched(fault) if detector is not None and as_plain and not injector.spent else None
        keeps = self.watched and derived
        others = self._tracks(fault).values() if detector is not None and derived else ()
        known = [track for track in (*others, plain) if track is not None and track.checkpoints]
        branch = Branch(self, detector, known, own, keeps=keeps)
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
        track = branch.fly()
        if derived:
            self._tracks(fault)[arm] = track
        return track
