"""Register faults during a flight: the world starts the tracer, and continues until the bit is flipped."""

import os
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from mavfi.errors import MavfiError
from mavfi.faults.fault import RegisterFault
from mavfi.faults.register import inject
from mavfi.flight_log import Event, Injection
from mavfi.hosts.ros1.graph import NODELET
from mavfi.hosts.ros1.roll_call import HUNG, is_traced

PLANNED = "killed as planned"
SILENT = ("does not answer", HUNG)
"""Causes of a lost node, as in events: killed by `--kill`; killed after a hang.  Any other cause is a crash."""
_LAST_WORDS_S = 2.0
_TIMEOUT_S = 30.0
_POLL_S, _ARMING_S = 0.01, 0.05
_SYMBOLS = {NODELET: "_ZN16depth_image_proc7convertIfEE"}
"""Part of the mangled name of the injected function: `depth_image_proc::convert<float>`, the back-projection."""
_WALKS = {NODELET: 2_000}
"""Number of instructions from function entry within which the fault is injected: set-up and the first pixels.  Of some
50,000 for 64 x 48 pixels; but single-stepping takes 30 us per instruction, 100 times as much on a busy machine."""
_WALK = 64


def fault_in_node(node: str, time_us: int, registers: str = "all", seed: int = 0) -> RegisterFault:
    """A register fault in a node, in the node's characteristic function if one is known."""
    return RegisterFault(
        registers, symbol=_SYMBOLS.get(node, ""), walk=_WALKS.get(node, _WALK), timeout=_TIMEOUT_S, node=node,
        time_us=time_us, seed=seed,
    )  # fmt: skip


class RegisterInjector:
    """Register faults of one flight, in order of time; `injections` are those so far, including failed ones.

    Args:
        faults: All faults of the flight.
        pid_of: Returns the process id of a node.
        hold: Whether the flight waits until the tracer is attached, so that the injected call is the first one after
            the instant, independent of wall-clock time.
    """

    def __init__(self, faults: Sequence[RegisterFault], pid_of: Callable[[str], int], hold: bool) -> None:
        self.injections: list[Injection] = []
        self._planned = sorted(faults, key=lambda fault: fault.time_us)
        self._pid_of, self._hold = pid_of, hold
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
        end = time.monotonic() + _TIMEOUT_S
        while self._hold and fault.symbol and thread.is_alive() and time.monotonic() < end:
            if is_armed(pid):
                time.sleep(_ARMING_S)
                break
            time.sleep(_POLL_S)

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


def is_armed(pid: int) -> bool:
    """Whether a tracer is attached to all threads of a process."""
    try:
        threads = os.listdir(f"/proc/{pid}/task")
    except OSError:
        return False
    return all(is_traced(int(thread)) for thread in threads)


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
    return "hang" if causes[0] in SILENT else "crash"
