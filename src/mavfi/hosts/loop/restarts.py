"""Nodes that die: what becomes of them, and of the mission, is a policy of the mission (`dead_node`).

- `end`: the mission ends there, and has failed.
- `fresh`: what the node was computing is lost; after a time it is there again without memory, and is sent the whole map
  and the last message of each state that it reads from other nodes.
- `latched`: as `fresh`, and it is sent the last alarm again if the way-point in force does not answer that yet.
- `readback`: as `latched`, and it reads its own last outputs back (`Kernel.resume`), as consumers saw them.
- `recompute`: the step is computed again at once, from the memory before it; its result comes one latency later.
"""

from collections.abc import Sequence
from weakref import proxy

from mavfi.detectors.detector import Detector
from mavfi.faults.state import ActedOn
from mavfi.hosts.loop.recovery import WAYPOINT
from mavfi.hosts.loop.scheduler import Loop
from mavfi.hosts.loop.taps import Tap
from mavfi.mission import DeadNode, MissionStatus
from mavfi.pipeline.kernel import Kernel
from mavfi.states import PERIODIC, STATES, State, in_node

CHANGES = "perception.map_update"
"""State of changes instead of whole values: a node that begins again is sent all of them."""


class Restarts:
    """Lets nodes of a flight die under a policy; the flight has not begun."""

    def __init__(self, loop: Loop, policy: DeadNode = "fresh") -> None:
        self._loop = proxy(loop)  # which owns this
        self._policy = policy
        self._latest: dict[str, State] = {}
        self._updates: list[State] = []
        self._acted_on = {spec.name: ActedOn(spec) for spec in STATES.values() if spec.acted_on}
        self._alarms: dict[str, State] = {}
        loop.taps.recorders.append(self._keep)
        self._back = f"restart {policy}"  # a detector may restart nodes under another policy than that of their deaths
        loop.actions[self._back] = self._restart
        loop.actions["again"] = self._again

    def _keep(self, state: State, now: int) -> None:
        name = state.spec.name
        self._latest[name] = state
        if name == CHANGES:
            self._updates.append(state)
        if name in self._acted_on and self._acted_on[name](state):
            self._alarms[name] = state

    def die(self, kernel: str, now: int, after_us: int, lost: Sequence[State] = ()) -> None:
        """Let the node of a kernel die now.

        Args:
            kernel: The kernel in whose step it dies.
            now: us.
            after_us: Time until it is there again (us).
            lost: What the step would have published: the result of its recomputation.
        """
        if self._policy == "end":
            self._loop.status = MissionStatus.NODE_DIED
        elif kernel in self._loop.down:
            return  # it is away already, and comes back as its own death says
        elif self._policy == "recompute":
            self._recompute(kernel, now, lost)
        else:
            self._lose(kernel, now, after_us)

    def detector_dies(self, detector: Detector, now: int, after_us: int) -> None:
        """Let the detector die now: what is published passes, and the flight goes on.

        Under the policy `end` for good; under `recompute` its call is simply made again.  Else it is there again after
        a time without memory, and is sent the last publication of each state, as a restarted node is.
        """
        if self._policy == "recompute":
            return
        taps = self._loop.taps
        tap, taps.detector = taps.detector, None
        if self._policy != "end":
            self._loop.actions["detector back"] = lambda now: self._watch_again(detector, tap, now)
            self._loop.at(now + after_us, "detector back")

    def _watch_again(self, detector: Detector, tap: Tap | None, now: int) -> None:
        detector.start()
        for name in STATES:  # in the order of the data flow
            if name in self._latest:
                detector.accept(self._latest[name], now)
        self._loop.awaited.clear()  # recomputed meanwhile
        self._loop.taps.detector = tap

    def _lose(self, kernel: str, now: int, after_us: int) -> None:
        loop, names = self._loop, in_node(kernel)
        loop.down.update(names)
        for name in names:
            loop.busy[name] = None
            loop.requests.pop(name, None)
        for state in list(loop.awaited):
            if STATES[state].writer in names:
                del loop.awaited[state]  # the recomputation died with the node: what it publishes next is judged anew
        loop.at(now + after_us, self._back, kernel)

    # ---- the step again ---------------------------------------------------------------------------------------------
    def _recompute(self, name: str, now: int, states: Sequence[State]) -> None:
        loop = self._loop
        cost = loop.latency[name]
        if cost == 0:
            return  # the result comes as without the fault
        loop.record.recompute_us[loop.kernels[name].stage.value] += cost
        loop.down.add(name)
        loop.busy[name] = None
        loop.at(now + cost, "again", name, list(states))

    def _again(self, now: int, name: str, states: list[State]) -> None:
        loop = self._loop
        loop.down.discard(name)
        waiting = loop.busy.pop(name)
        loop.finish(loop.kernels[name], states, now, loop.latency[name])
        loop.busy[name] = waiting

    # ---- back again -------------------------------------------------------------------------------------------------
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
                continue  # its own outputs, or what passed within the node: a path planned long ago is not flown anew
            for state in self._messages(name):
                due = kernel.receive(state, now) or due
        if self._loop.marks:
            kernel.mark()  # what it was sent is not taken back by a recomputation of the step under way
        if due and kernel.name not in PERIODIC:
            self._loop.start(kernel, now)

    def _messages(self, name: str) -> list[State]:
        """What a restarted node is sent of a state."""
        if name == CHANGES:
            return self._updates
        latest, alarm = self._latest.get(name), self._alarms.get(name)
        messages = [] if latest is None else [latest]
        if self._policy != "fresh" and alarm is not None and alarm is not latest and self._unanswered(alarm):
            messages.insert(0, alarm)
        return messages

    def _unanswered(self, alarm: State) -> bool:
        """Whether the way-point in force carries a lower number than an alarm."""
        waypoint, counter = self._latest.get(WAYPOINT), alarm.spec.acted_on
        return waypoint is None or int(waypoint.header[counter][0]) < int(alarm.header[counter][0])
