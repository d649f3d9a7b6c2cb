"""Faults in registers during a flight: the world starts the tracer, and continues until the bit is flipped."""

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
"""Why a node was lost, as events say it: killed by `--kill`; ended because it hung.  All else is a crash."""
_LAST_WORDS_S = 2.0
_TIMEOUT_S = 30.0
_POLL_S, _ARMING_S = 0.01, 0.05
_SYMBOLS = {NODELET: "_ZN16depth_image_proc7convertIfEE"}
"""Part of the mangled name of the injected function: `depth_image_proc::convert<float>`, the back-projection."""
_WALKS = {NODELET: 2_000}
"""Instructions from its begin within which it is injected: what it sets up, and the first pixels.  It executes some
50,000 for 64 x 48 pixels, but each that is walked takes 30 us, and a hundred times as much on a busy machine."""
_WALK = 64


def fault_in_node(node: str, time_us: int, registers: str = "all", seed: int = 0) -> RegisterFault:
    """A fault in a register of a node, at the node's most interesting function if that is known."""
    return RegisterFault(
        registers, symbol=_SYMBOLS.get(node, ""), walk=_WALKS.get(node, _WALK), timeout=_TIMEOUT_S, node=node,
        time_us=time_us, seed=seed,
    )  # fmt: skip


class RegisterInjector:
    """The faults in registers of one flight, in order of time; `injections` are those so far, also the failed ones.

    Args:
        faults: All.
        pid_of: Process of a node.
        hold: Whether the flight may stand still until the tracer is ready, so that the injected call is the first one
            after the instant, independent of wall-clock time.
    """

    def __init__(self, faults: Sequence[RegisterFault], pid_of: Callable[[str], int], hold: bool) -> None:
        self.injections: list[Injection] = []
        self._planned = sorted(faults, key=lambda fault: fault.time_us)
        self._pid_of, self._hold = pid_of, hold
        self._begun: list[tuple[threading.Thread, RegisterFault, list[Injection | Exception]]] = []

    def __call__(self, now: int) -> None:
        """Start those that are due, and record those that are done."""
        while self._planned and self._planned[0].time_us <= now:
            self._begin(self._planned.pop(0))
        for thread, fault, done in list(self._begun):
            if not thread.is_alive():
                self._begun.remove((thread, fault, done))
                self._note(fault, done, now)

    def finish(self, now: int) -> None:
        """End of the flight: whatever still waits for its node will not come any more."""
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
    """What happened to the injected nodes, given injections and events of the flight.

    Returns:
        "crash": one has ended; "hang": one was ended as it did not answer; "alive": neither; None: no injection.
    """
    nodes = {one.details["node"] for one in injections if one.level == RegisterFault.level and one.activated}
    if not nodes:
        return None
    lost = [event.data for event in events if event.kind == "node_lost" and event.data["node"] in nodes]
    causes = [data["why"] for data in lost if data["why"] != PLANNED]
    if not causes:
        return "alive"
    return "hang" if causes[0] in SILENT else "crash"
