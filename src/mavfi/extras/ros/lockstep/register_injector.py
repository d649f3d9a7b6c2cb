"""Register faults during a flight: the world starts a tracer, which injects during the flight."""

import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace

from mavfi.errors import MavfiError
from mavfi.extras.registers import inject
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.ros.lockstep.ports import SILENT
from mavfi.extras.ros.processes import is_traced
from mavfi.record import Event, Injection

PLANNED = "killed as planned"
"""Cause of a lost node, as in events: killed by `--kill`."""
_LAST_WORDS_S = 2.0
_POLL_S = 0.01
_TIMEOUT_S = 30.0
_WALK = 64


def fault_in_node(node: str, time_us: int, registers: str = "all", seed: int = 0) -> RegisterFault:
    """A register fault in a node, wherever it is at that instant."""
    return RegisterFault(registers, walk=_WALK, timeout=_TIMEOUT_S, node=node, time_us=time_us, seed=seed)


class RegisterInjector:
    """Register faults of one flight, in order of time; `injections` are those so far, including failed ones.

    Args:
        faults: All faults of the flight.
        pid_of: Returns the process id of a node.
    """

    def __init__(self, faults: Sequence[RegisterFault], pid_of: Callable[[str], int]) -> None:
        self.injections: list[Injection] = []
        self._pending_faults = sorted(faults, key=lambda fault: fault.time_us)
        self._pid_of = pid_of
        self._tracings: list[tuple[RegisterFault, Future[list[Injection]]]] = []

    def __call__(self, now: int) -> None:
        """Start the faults that are due, and record the completed ones."""
        while self._pending_faults and self._pending_faults[0].time_us <= now:
            self._begin(self._pending_faults.pop(0))
        for fault, tracing in list(self._tracings):
            if tracing.done():
                self._tracings.remove((fault, tracing))
                self._note(fault, tracing, now)

    def finish(self, now: int) -> None:
        """End of the flight: record pending faults as not injected."""
        for fault, tracing in self._tracings:
            self._note(fault, tracing, now)
        for fault in self._pending_faults:
            self._miss(fault, "the flight was over first", now)
        self._tracings = []
        self._pending_faults = []

    def _begin(self, fault: RegisterFault) -> None:
        """Start a tracer, and wait until it is attached: a node computes only during the flight."""
        pid = self._pid_of(fault.node)
        tracing: Future[list[Injection]] = Future()
        threading.Thread(target=_trace, args=(pid, fault, tracing), daemon=True).start()
        self._tracings.append((fault, tracing))
        end = time.monotonic() + _TIMEOUT_S
        while not is_traced(pid) and not tracing.done() and time.monotonic() < end:
            time.sleep(_POLL_S)

    def _note(self, fault: RegisterFault, tracing: Future[list[Injection]], now: int) -> None:
        try:
            injection = tracing.result(_LAST_WORDS_S)[0]
        except TimeoutError:
            self._miss(fault, "the flight was over first", now)
        except (MavfiError, OSError, subprocess.SubprocessError) as error:
            self._miss(fault, str(error), now)
        else:
            details = {"node": fault.node, **injection.details}
            self.injections.append(replace(injection, time_s=1e-6 * now, details=details))

    def _miss(self, fault: RegisterFault, why: str, now: int) -> None:
        details = {"node": fault.node, "why": why}
        self.injections.append(Injection(fault.level, fault.site, 1e-6 * now, None, None, None, False, details=details))


def _trace(pid: int, fault: RegisterFault, tracing: Future[list[Injection]]) -> None:
    """Inject, and pass on the injection or the exception."""
    try:
        tracing.set_result(inject(pid, fault))
    except Exception as error:  # noqa: BLE001 - raised again where the result is read
        tracing.set_exception(error)


def end_of_nodes(injections: Sequence[Injection], events: Sequence[Event]) -> str | None:
    """End of the injected nodes, given injections and events of the flight.

    Returns:
        "crash": a node terminated; "hang": a node was killed as unresponsive; "alive": neither; None: no injection.
    """
    nodes = {
        injection.details["node"]
        for injection in injections
        if injection.level == RegisterFault.level and injection.activated
    }
    if not nodes:
        return None
    lost = [event.data for event in events if event.kind == "node_lost" and event.data["node"] in nodes]
    causes = [data["why"] for data in lost if data["why"] != PLANNED]
    if not causes:
        return "alive"
    if causes[0] == SILENT:
        return "hang"
    return "crash"
