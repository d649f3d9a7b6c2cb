"""Node crashes and restarts under the mission's policy (`dead_node`).

- `end`: the mission ends at the crash and counts as failed.
- `fresh`: the step in progress is lost; after a down time the node restarts with initialized memory and receives the
  whole map and the last message of each state that it reads from other nodes.
- `readback`: as `fresh`, and it also receives the last alarm if the way-point in force does not answer that yet, and
  reads back its own last outputs as consumers received them (`Kernel.resume`).
"""

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, cast
from weakref import proxy

from mavfi.detectors.detector import Detector
from mavfi.faults.acted_on import ActedOn
from mavfi.flight.decide import WAYPOINT
from mavfi.flight.loop import Loop
from mavfi.flight.recovery import DetectorTap
from mavfi.flight.state import EventKind
from mavfi.flight.taps import Tap
from mavfi.mission import DeadNode, MissionStatus
from mavfi.pipeline.kernel import Kernel
from mavfi.states import PERIODIC, STATES, State, in_node

if TYPE_CHECKING:
    from mavfi.sim.simulator import Simulator

CHANGES = "perception.map_update"
"""State that carries increments instead of whole values: a restarted node receives all of them."""


class Restarts:
    """Terminates and restarts the nodes of a flight under a policy.

    Args:
        loop: The flight.
        policy: The policy.
        earlier: Publications so far, with their instants (us): a restarted node receives some of them.
    """

    def __init__(self, loop: Loop, policy: DeadNode = "fresh", earlier: Iterable[tuple[State, int]] = ()) -> None:
        self._loop = proxy(loop)  # the loop owns this object
        self._policy = policy
        self._latest: dict[str, State] = {}
        self._updates: list[State] = []
        self._acted_on = {spec.name: ActedOn(spec) for spec in STATES.values() if spec.acted_on}
        self._alarms: dict[str, State] = {}
        for state, now in earlier:
            self.record(state, now)
        loop.taps.recorders.append(self.record)
        loop.restart = self.restart  # also for events of others, which have seen the same publications

    def record(self, state: State, now: int) -> None:
        """Note a publication as consumers receive it: what a restarted node receives depends on all of them."""
        name = state.spec.name
        self._latest[name] = state
        if name == CHANGES:
            self._updates.append(state)
        if name in self._acted_on and self._acted_on[name](state):
            self._alarms[name] = state

    def die(self, kernel: str, now: int, after_us: int) -> None:
        """Terminate the node of a kernel at this instant.

        Args:
            kernel: The kernel in whose step the node crashes.
            now: Current instant (us).
            after_us: Down time until the restart (us).
        """
        loop = self._loop
        if self._policy == "end":
            loop.end(MissionStatus.NODE_DIED)
        elif kernel not in loop.state.down:  # else the restart is scheduled already
            loop.take_down(in_node(kernel))
            # The policy is part of the event: a detector may restart nodes under another one than the mission's.
            loop.state.schedule(now + after_us, EventKind.RESTART, kernel, self._policy)

    def detector_dies(self, detector: Detector, now: int, after_us: int) -> None:
        """Terminate the detector at this instant; publications pass unchecked and the flight continues.

        It restarts with initialized memory after the down time and receives the last publication of each state, as any
        restarted node.  Policy `end`: it does not return.

        Args:
            detector: The detector.
            now: Instant (us).
            after_us: Down time (us).
        """
        taps = self._loop.taps
        tap = taps.detector
        taps.detector = None
        if self._policy != "end":
            self._loop.call_at(now + after_us, partial(self._detector_returns, detector, tap))

    def controller_dies(self, now: int, after_us: int) -> None:
        """Terminate the flight controller at this instant: the rotors stop until it is back, with initialized memory.

        Policy `end`: the mission ends.

        Args:
            now: Instant (us).
            after_us: Down time (us).
        """
        if self._policy == "end":
            self._loop.end(MissionStatus.NODE_DIED)
            return
        plant = cast("Simulator", self._loop.plant)  # the plant of all flights with faults in instructions
        plant.stop_controller()
        self._loop.call_at(now + after_us, lambda _: plant.restart_controller())

    def _detector_returns(self, detector: Detector, tap: Tap | None, now: int) -> None:
        """Initialize a detector, pass it the last publication of each state, and install its tap again."""
        try:
            detector.start()
            for name in STATES:  # in data-flow order
                if name in self._latest:
                    detector.accept(self._latest[name], now)
        except Exception as error:
            if not isinstance(tap, DetectorTap):
                raise
            tap.give_up(error, now)
        self._loop.state.awaited.clear()  # recomputations finished during the down time
        self._loop.taps.detector = tap

    # ---- restart ----------------------------------------------------------------------------------------------------
    def restart(self, now: int, kernel: str, policy: DeadNode) -> None:
        """Start the node of a kernel again, with initialized memory."""
        new_kernels = self._loop.renew(kernel)
        if not new_kernels:
            return  # the node never returns
        # All kernels of the node are in place before one of them publishes to another.
        restarted_kernels = [new_kernels[name] for name in in_node(kernel)]
        self._loop.bring_back(restarted_kernels)
        for restarted in restarted_kernels:
            self._resume(restarted, now, policy)

    def _resume(self, kernel: Kernel, now: int, policy: DeadNode) -> None:
        """Pass a restarted kernel the messages that its policy provides, and start a step that they make due."""
        read_back: tuple[str, ...] = ()
        if policy == "readback":
            read_back = kernel.resume(self._latest, now)
        is_due = False
        node = in_node(kernel.name)
        for name in kernel.reads:
            if STATES[name].writer in node or name in read_back:
                continue  # own outputs and node-internal states: replaying them would execute an outdated path
            for state in self._messages(name, policy):
                is_due = kernel.receive(state, now) or is_due
        if self._loop.marks:
            kernel.mark()  # a recomputation of the current step must not undo the retransmitted inputs
        if is_due and kernel.name not in PERIODIC:
            self._loop.start(kernel, now)

    def _messages(self, name: str, policy: DeadNode) -> list[State]:
        """Messages of a state that a restarted node receives."""
        if name == CHANGES:
            return self._updates
        latest = self._latest.get(name)
        if latest is None:
            return []
        # The last alarm, unless it is the latest message or has been answered.
        alarm = self._alarms.get(name)
        if policy == "readback" and alarm is not None and alarm is not latest and self._is_unanswered(alarm):
            return [alarm, latest]
        return [latest]

    def _is_unanswered(self, alarm: State) -> bool:
        """Whether the way-point in force carries a lower sequence number than an alarm."""
        waypoint = self._latest.get(WAYPOINT)
        counter = alarm.spec.acted_on
        return waypoint is None or int(waypoint.header[counter][0]) < int(alarm.header[counter][0])
