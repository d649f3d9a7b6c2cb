"""Nodes that die and start again: pending results are lost, and the node comes back with fresh memory."""

from weakref import proxy

from mavfi.hosts.loop.scheduler import Loop
from mavfi.pipeline.kernel import Kernel
from mavfi.states import PERIODIC, STATES, State, in_node

_MAP = "perception.map_update"


class Restarts:
    """Lets nodes of a flight die, and start again under the restart policy `fresh`; the flight has not begun.

    A restarted node gets the whole map and the last message of each state that it reads from other nodes.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = proxy(loop)  # which owns this
        self._latest: dict[str, State] = {}
        self._updates: list[State] = []
        loop.taps.recorders.append(self._keep)
        loop.actions["restart"] = self._restart

    def _keep(self, state: State, now: int) -> None:
        self._latest[state.spec.name] = state
        if state.spec.name == _MAP:
            self._updates.append(state)

    def die(self, kernel: str, now: int, after_us: int) -> None:
        """Let the node of a kernel die now, and start again `after_us` later (us)."""
        loop, names = self._loop, in_node(kernel)
        loop.down.update(names)
        for name in names:
            loop.busy[name] = None
            loop.requests.pop(name, None)
        for state in list(loop.awaited):
            if STATES[state].writer in names:
                del loop.awaited[state]  # the recomputation died with the node: what it publishes next is judged anew
        loop.at(now + after_us, "restart", kernel)

    def _restart(self, now: int, kernel: str) -> None:
        loop, names = self._loop, in_node(kernel)
        fresh = loop.make_kernels()
        for name in names:
            loop.kernels[name] = fresh[name]
            loop.down.discard(name)
            loop.busy.pop(name, None)
        for state, readers in loop.readers.items():
            loop.readers[state] = [loop.kernels[reader.name] for reader in readers]
        for name in names:
            self._resume(loop.kernels[name], now)

    def _resume(self, kernel: Kernel, now: int) -> None:
        due, node = False, in_node(kernel.name)
        for name in kernel.reads:
            if STATES[name].writer in node:
                continue  # its own outputs, or what passed within the node: a path planned long ago is not flown anew
            messages = self._updates if name == _MAP else [self._latest.get(name)]
            for state in messages:
                due = (state is not None and kernel.receive(state, now)) or due
        if self._loop.marks:
            kernel.mark()  # what it was sent is not taken back by a recomputation of the step under way
        if due and kernel.name not in PERIODIC:
            self._loop.start(kernel, now)
