"""Register faults during a flight: the world starts the tracer, and the flight goes on meanwhile."""

import subprocess
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

from mavfi.errors import MavfiError
from mavfi.faults.fault import RegisterFault
from mavfi.faults.register import inject
from mavfi.flight_log import Event, Injection
from mavfi.hosts.ros1.remote import SILENT

PLANNED = "killed as planned"
"""Cause of a lost node, as in events: killed by `--kill`."""
_LAST_WORDS_S = 2.0
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
        self._planned = sorted(faults, key=lambda fault: fault.time_us)
        self._pid_of = pid_of
        self._begun: list[tuple[threading.Thread, RegisterFault, list[Injection | Exception]]] = []

    def __call__(self, now: int) -> None:
        """Start the faults that are due, and record the completed ones."""
        while self._planned and self._planned[0].time_us <= now:
            self._begin(self._planned.pop(0))
        for thread, fault, done in list(self._begun):
            if not thread.is_alive():
                self._begun.remove((thread, fault, done))
                self._note(fault, done, now)

    def finish(self, now: int) -> None:
        """End of the flight: record pending faults as not injected."""
        for thread, fault, done in self._begun:
            thread.join(_LAST_WORDS_S)
            self._note(fault, done, now)
        for fault in self._planned:
            self._note(fault, [], now)
        self._begun, self._planned = [], []

    def _begin(self, fault: RegisterFault) -> None:
        done: list[Injection | Exception] = []
        pid = self._pid_of(fault.node)
        thread = threading.Thread(target=_run, args=(pid, fault, done), daemon=True)
        thread.start()
        self._begun.append((thread, fault, done))

    def _note(self, fault: RegisterFault, done: Sequence[Injection | Exception], now: int) -> None:
        if done and isinstance(done[0], Injection):
            found = replace(done[0], time_s=1e-6 * now, details={"node": fault.node, **done[0].details})
        else:
            why = str(done[0]) if done else "the flight was over first"
            found = Injection(
                fault.level, fault.site, 1e-6 * now, None, None, None, False, details={"node": fault.node, "why": why}
            )
        self.injections.append(found)


def _run(pid: int, fault: RegisterFault, done: list[Injection | Exception]) -> None:
    try:
        done.append(inject(pid, fault)[0])
    except (MavfiError, OSError, subprocess.SubprocessError) as error:
        done.append(error)


def end_of_nodes(injections: Sequence[Injection], events: Sequence[Event]) -> str | None:
    """End of the injected nodes, given injections and events of the flight.

    Returns:
        "crash": a node terminated; "hang": a node was killed as unresponsive; "alive": neither; None: no injection.
    """
    nodes = {one.details["node"] for one in injections if one.level == RegisterFault.level and one.activated}
    if not nodes:
        return None
    lost = [event.data for event in events if event.kind == "node_lost" and event.data["node"] in nodes]
    causes = [data["why"] for data in lost if data["why"] != PLANNED]
    if not causes:
        return "alive"
    return "hang" if causes[0] == SILENT else "crash"
