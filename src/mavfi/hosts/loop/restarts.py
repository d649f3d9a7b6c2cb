"""Node crashes and restarts under the mission's policy (`dead_node`).

- `end`: the mission ends at the crash and counts as failed.
- `fresh`: the step in progress is lost; after a down time the node restarts with initialized memory and receives the
  whole map and the last message of each state that it reads from other nodes.
- `latched`: as `fresh`, and it also receives the last alarm if the way-point in force does not answer that yet.
- `readback`: as `latched`, and it reads back its own last outputs as consumers received them (`Kernel.resume`).
- `recompute`: the step is recomputed at once from the memory before it; its result is published one latency later.
- `checkpoint`: after the down time the node continues from the memory before that step, which is recomputed; its inputs
  are queued meanwhile, and timers run on.
- `standby`: as `checkpoint`, but a replica with the same inputs takes over after `TAKE_OVER_US`.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from weakref import proxy

from mavfi.detectors.bounded import StuckError, limited
from mavfi.detectors.detector import Detector
from mavfi.detectors.replicas import INJECTED, Replicated
from mavfi.faults.state import ActedOn
from mavfi.hosts.loop.recovery import Watch
from mavfi.hosts.loop.scheduler import Loop
from mavfi.hosts.loop.taps import Tap
from mavfi.hosts.loop.waiting import WAYPOINT
from mavfi.mission import DeadNode, MissionStatus
from mavfi.pipeline.kernel import Kernel
from mavfi.states import PERIODIC, STATES, State, in_node

CHANGES = "perception.map_update"
"""State that carries increments instead of whole values: a restarted node receives all of them."""

TAKE_OVER_US = 20_000
"""Time until a standby notices the death of its node: one control period (us)."""


class Restarts:
    """Terminates and restarts the nodes of a flight under a policy; constructed before the flight starts."""

    def __init__(self, loop: Loop, policy: DeadNode = "fresh") -> None:
        self._loop = proxy(loop)  # the loop owns this object
        self._policy = policy
        self._latest: dict[str, State] = {}
        self._updates: list[State] = []
        self._acted_on = {spec.name: ActedOn(spec) for spec in STATES.values() if spec.acted_on}
        self._alarms: dict[str, State] = {}
        loop.taps.recorders.append(self.keep)
        self._back = f"restart {policy}"  # a detector may restart nodes under a policy other than the mission's
        loop.actions[self._back] = self._restart
        loop.actions["again"], loop.actions["continue"] = self._again, self._continue

    def keep(self, state: State, now: int) -> None:
        """Note a publication as consumers receive it: what a restarted node receives depends on all of them."""
        name = state.spec.name
        self._latest[name] = state
        if name == CHANGES:
            self._updates.append(state)
        if name in self._acted_on and self._acted_on[name](state):
            self._alarms[name] = state

    def die(self, kernel: str, now: int, after_us: int, lost: Sequence[State] = ()) -> None:
        """Terminate the node of a kernel at this instant.

        Args:
            kernel: The kernel in whose step the node crashes.
            now: Current instant (us).
            after_us: Down time until the restart (us).
            lost: States that the step would have published, i.e. the result of its recomputation.
        """
        if self._policy == "end":
            self._loop.status = MissionStatus.NODE_DIED
        elif kernel in self._loop.down:
            return  # already down; the restart is scheduled
        elif self._policy == "recompute":
            self.recompute(kernel, now, lost)
        elif self._policy in ("checkpoint", "standby"):
            self._lose(kernel)
            away_us = TAKE_OVER_US if self._policy == "standby" else after_us
            self._loop.at(now + away_us, "continue", kernel, list(lost))
        else:
            self._lose(kernel)
            self._loop.at(now + after_us, self._back, kernel)

    def detector_dies(self, detector: Detector, now: int, after_us: int, *, recovery: bool = False) -> bool:
        """Terminate the detector at this instant; publications pass unchecked and the flight continues.

        Policy `end`: the detector does not return.  `recompute`, `standby`: its call is repeated, without effect on the
        flight.  Otherwise it restarts with initialized memory after the down time and receives the last publication of
        each state, as any restarted node.  Of several copies only the injected one dies; the others go on voting.

        Args:
            detector: The detector.
            now: Instant (us).
            after_us: Down time (us).
            recovery: Whether it dies in recovery, which is in its node: all copies, and what recovery remembers.

        Returns:
            False if its call is repeated.
        """
        if self._policy in ("recompute", "standby"):
            return False
        if isinstance(detector, Replicated) and not recovery:
            detector.lose()
            back: Callable[[int], None] = partial(self._vote_again, detector)
        else:
            taps = self._loop.taps
            if recovery and isinstance(taps.detector, Watch):
                taps.detector.forget()
            back, taps.detector = partial(self._watch_again, detector, taps.detector), None
        if self._policy != "end":
            self._loop.actions["detector back"] = back
            self._loop.at(now + after_us, "detector back")
        return True

    def _vote_again(self, detector: Replicated, now: int) -> None:
        with suppress(StuckError):  # it stays out of service
            self._begin_again(detector.parts[INJECTED], now)
            detector.rejoin()

    def _begin_again(self, detector: Detector, now: int) -> None:
        """Initialize a detector, and pass it the last publication of each state."""
        start, accept = limited(detector, "start"), limited(detector, "accept")
        start()
        for name in STATES:  # in data-flow order
            if name in self._latest:
                accept(self._latest[name], now)

    def _watch_again(self, detector: Detector, tap: Tap | None, now: int) -> None:
        try:
            self._begin_again(detector, now)
        except (StuckError, Exception) as error:
            if not isinstance(tap, Watch):
                raise
            tap.give_up(error, now)
        self._loop.awaited.clear()  # recomputations finished during the down time
        self._loop.taps.detector = tap

    def _lose(self, kernel: str) -> None:
        loop, names = self._loop, in_node(kernel)
        loop.down.update(names)
        for name in names:
            loop.busy[name] = None
            loop.requests.pop(name, None)
        for state in list(loop.awaited):
            if STATES[state].writer in names:
                del loop.awaited[state]  # the recomputation died with the node: its next publication is checked

    # ---- recomputation of the step ----------------------------------------------------------------------------------
    def recompute(self, name: str, now: int, states: Sequence[State]) -> None:
        """Publish the results of a kernel's repeated step one latency later, under any policy."""
        if self._loop.latency[name] > 0:  # a result without latency is published as in the error-free case
            self._loop.busy[name] = None
            self._repeat(name, now, states)

    def _repeat(self, name: str, now: int, states: Sequence[State]) -> None:
        loop, cost = self._loop, self._loop.latency[name]
        loop.record.recompute_us[loop.kernels[name].stage.value] += cost
        loop.down.add(name)
        loop.at(now + cost, "again", name, list(states))

    def _again(self, now: int, name: str, states: list[State]) -> None:
        loop = self._loop
        loop.down.discard(name)
        waiting = loop.busy.pop(name)
        loop.finish(loop.kernels[name], states, now, loop.latency[name])
        if name in loop.busy:
            loop.busy[name] = waiting
        elif waiting is not None:
            self._go_on(name, waiting, now)

    # ---- checkpoint and standby -------------------------------------------------------------------------------------
    def _continue(self, now: int, kernel: str, states: list[State]) -> None:
        """Continue a node from its memory, with the inputs that arrived meanwhile, and repeat the step that died."""
        loop = self._loop
        for name in in_node(kernel):
            loop.down.discard(name)
            if name != kernel and (waiting := loop.busy.pop(name, None)) is not None:
                self._go_on(name, waiting, now)
        self._repeat(kernel, now, states)

    def _go_on(self, name: str, waiting: State, now: int) -> None:
        if self._loop.kernels[name].receive(waiting, now) and name not in PERIODIC:
            self._loop.start(self._loop.kernels[name], now)

    # ---- restart ----------------------------------------------------------------------------------------------------
    def _restart(self, now: int, kernel: str) -> None:
        loop, names = self._loop, in_node(kernel)
        fresh = loop.renew(kernel)
        if not fresh:
            return
        for name in names:
            loop.kernels[name] = fresh[name]
            loop.down.discard(name)
            loop.busy.pop(name, None)
        for state, readers in loop.readers.items():
            loop.readers[state] = [loop.kernels[reader.name] for reader in readers]
        for name in names:
            self._resume(loop.kernels[name], now)

    def _resume(self, kernel: Kernel, now: int) -> None:
        taken = kernel.resume(self._latest, now) if self._policy == "readback" else ()
        due, node = False, in_node(kernel.name)
        for name in kernel.reads:
            if STATES[name].writer in node or name in taken:
                continue  # own outputs and node-internal states: replaying them would execute an outdated path
            for state in self._messages(name):
                due = kernel.receive(state, now) or due
        if self._loop.marks:
            kernel.mark()  # a recomputation of the current step must not undo the retransmitted inputs
        if due and kernel.name not in PERIODIC:
            self._loop.start(kernel, now)

    def _messages(self, name: str) -> list[State]:
        """Messages of a state that a restarted node receives."""
        if name == CHANGES:
            return self._updates
        latest, alarm = self._latest.get(name), self._alarms.get(name)
        messages = [] if latest is None else [latest]
        if self._policy != "fresh" and alarm is not None and alarm is not latest and self._unanswered(alarm):
            messages.insert(0, alarm)
        return messages

    def _unanswered(self, alarm: State) -> bool:
        """Whether the way-point in force carries a lower sequence number than an alarm."""
        waypoint, counter = self._latest.get(WAYPOINT), alarm.spec.acted_on
        return waypoint is None or int(waypoint.header[counter][0]) < int(alarm.header[counter][0])
