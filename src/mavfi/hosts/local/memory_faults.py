"""Injection of faults into a kernel's persistent memory, as the first action of the loop at the fault's instant.

A kernel that subsequently raises an exception terminates its node, under the mission's policy for dead nodes.
"""

from collections.abc import Callable
from typing import Any, cast
from weakref import proxy

import numpy as np

from mavfi.errors import BadInputError, machine_failure
from mavfi.faults.fault import RESTART_S, MemoryFault
from mavfi.flight_log import Injection, KernelEffect
from mavfi.hosts.loop.restarts import Restarts
from mavfi.hosts.loop.scheduler import Loop
from mavfi.mission import FROM_MEMORY
from mavfi.pipeline.memory import Remembers
from mavfi.pipeline.words import change, words_of
from mavfi.states import State

_ACTION = "memory_fault"
_RESTART_US = round(1e6 * RESTART_S)
_ANSWERS: dict[str, Callable[[], Any]] = {
    "receive": bool, "step": list, "rollback": lambda: None, "again": lambda: None, "stop": list, "abandon": list,
}  # fmt: skip
"""Return value of each method of a kernel that has crashed."""


def flip_bit(word: np.ndarray, bit: int | None) -> None:
    """Flip a bit of a word of shape (1,), in place; bit 0 is the least significant, None leaves it unchanged."""
    if bit is not None:
        raw = word.copy()
        raw.view(np.uint8)[bit // 8] ^= np.uint8(1 << bit % 8)
        word[:] = raw


class MemoryInjector:
    """Injector tap of a flight that has not started; publications pass unchanged.

    Attributes:
        effect: How the kernel crashed after the fault; None = it did not.
    """

    spent = True

    def __init__(self, loop: Loop, fault: MemoryFault) -> None:
        self._loop, self._fault = proxy(loop), fault  # the loop owns this object
        policy = loop.scenario.dead_node
        # not from memory: it is corrupted
        self._restarts = Restarts(loop, "fresh" if policy in FROM_MEMORY else policy)
        self._injection: Injection | None = None
        self.effect: KernelEffect | None = None
        if fault.has_site:
            loop.actions[_ACTION] = self._inject
            loop.at(fault.time_us, _ACTION)

    def __call__(self, state: State, time_us: int) -> State:
        """The unchanged publication."""
        del time_us
        return state

    def _inject(self, now: int) -> None:
        fault, loop = self._fault, self._loop
        if fault.kernel not in loop.kernels or fault.kernel in loop.down:
            return  # the memory does not exist at this instant
        kernel = loop.kernels[fault.kernel]
        types = {words.dtype for words in words_of(cast(Remembers, kernel)) if words.name == fault.field}
        if types - {fault.dtype}:
            raise BadInputError(f"fault in {fault.site}: dtype {fault.dtype!r}; allowed: {', '.join(sorted(types))}")
        values = change(
            cast(Remembers, kernel), fault.field, fault.index or 0, lambda word: flip_bit(word, fault.bit)
        )  # fmt: skip
        if values is not None:
            self._injection = Injection(fault.level, fault.site, now / 1e6, fault.bit, *values, activated=True)
            self._guard(kernel)

    def _guard(self, kernel: Any) -> None:
        """Make exceptions of a kernel terminate its node instead of the flight."""
        for name, answer in _ANSWERS.items():
            if hasattr(kernel, name):
                setattr(kernel, name, self._guarded(kernel.name, getattr(kernel, name), answer))

    def _guarded(self, kernel: str, method: Callable[..., Any], answer: Callable[[], Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            try:
                return method(*arguments)
            except Exception as error:  # any exception type: kernels operate on corrupted memory
                if machine_failure(error):
                    raise
                if kernel not in self._loop.down:
                    self.effect = KernelEffect("exception", f"{type(error).__name__}: {error}", None)
                    self._restarts.die(kernel, self._loop.now, _RESTART_US)
                return answer()

        return call

    @property
    def injections(self) -> list[Injection]:
        """The injection so far."""
        return [] if self._injection is None else [self._injection]

    def finish(self) -> list[Injection]:
        """The injection; if the word did not exist, a record of the missed activation."""
        fault = self._fault
        time_s = fault.time_us / 1e6 if fault.has_site else 0.0
        missed = Injection(fault.level, fault.site, time_s, fault.bit, None, None, activated=False)
        return [self._injection or missed]
