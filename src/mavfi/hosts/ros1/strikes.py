"""Strikes at register level during a flight: the world starts the tracer, and goes on until the node is struck."""

import os
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from mavfi.errors import MavfiError
from mavfi.faults.register import RegisterInjection, Request, inject
from mavfi.flight_log import Event
from mavfi.hosts.ros1.foreign import HUNG
from mavfi.hosts.ros1.graph import NODELET
from mavfi.hosts.ros1.plan import Strike
from mavfi.hosts.ros1.roll_call import is_traced

STRUCK, FAILED = "register_strike", "register_strike_failed"
PLANNED = "killed as planned"
SILENT = ("does not answer", HUNG)
"""Why a node was lost, as events say it: killed by `--kill`; ended because it hung.  All else is a crash."""
_LAST_WORDS_S = 2.0
_TIMEOUT_S = 30.0
_POLL_S, _ARMING_S = 0.01, 0.05
_SYMBOLS = {NODELET: "_ZN16depth_image_proc7convertIfEE"}
"""Part of the mangled name of the function that is struck: `depth_image_proc::convert<float>`, the back-projection."""
_WALKS = {NODELET: 2_000}
"""Instructions from its begin within which it is struck: what it sets up, and the first pixels.  It executes some
50,000 for 64 x 48 pixels, but each that is walked takes 30 us, and a hundred times as much on a busy machine."""


class Strikes:
    """The strikes of one flight, in order of time."""

    def __init__(
        self, planned: Sequence[Strike], pid_of: Callable[[str], int], note: Callable[[str, dict[str, Any]], None],
        hold: bool,
    ) -> None:  # fmt: skip
        """Wait for their instants.

        Args:
            planned: All.
            pid_of: Process of a node.
            note: Writes an event into the flight's record.
            hold: Whether the flight may stand still until the tracer is ready, so that the call which is struck is
                the first one after the instant, whatever time it is on the wall.
        """
        self._planned = sorted(planned, key=lambda strike: strike.time_us)
        self._pid_of, self._note, self._hold = pid_of, note, hold
        self._begun: list[tuple[threading.Thread, Strike, list[RegisterInjection | Exception]]] = []

    def strike(self, now: int) -> None:
        """Begin those that are due, and write down those that are done."""
        while self._planned and self._planned[0].time_us <= now:
            self._begin(self._planned.pop(0))
        for thread, strike, done in list(self._begun):
            if not thread.is_alive():
                self._begun.remove((thread, strike, done))
                self._tell(strike, done)

    def finish(self) -> None:
        """The flight is over."""
        for thread, strike, done in self._begun:
            thread.join(_LAST_WORDS_S)
            self._tell(strike, done)
        for strike in self._planned:
            self._tell(strike, [])
        self._begun, self._planned = [], []

    def _begin(self, strike: Strike) -> None:
        done: list[RegisterInjection | Exception] = []
        request = Request(
            self._pid_of(strike.node), strike.seed, strike.registers, symbol=_SYMBOLS.get(strike.node, ""),
            walk=_WALKS.get(strike.node, 64), timeout=_TIMEOUT_S,
        )  # fmt: skip
        thread = threading.Thread(target=_run, args=(request, done), daemon=True)
        thread.start()
        self._begun.append((thread, strike, done))
        end = time.monotonic() + _TIMEOUT_S
        while self._hold and request.symbol and thread.is_alive() and time.monotonic() < end:
            if is_armed(request.pid):
                time.sleep(_ARMING_S)
                break
            time.sleep(_POLL_S)

    def _tell(self, strike: Strike, done: Sequence[RegisterInjection | Exception]) -> None:
        if done and isinstance(done[0], RegisterInjection):
            self._note(STRUCK, {"node": strike.node, **done[0].to_json()})
            return
        why = str(done[0]) if done else "the flight was over first"
        self._note(FAILED, {"node": strike.node, "why": why})


def _run(request: Request, done: list[RegisterInjection | Exception]) -> None:
    try:
        done.append(inject(request)[0])
    except (MavfiError, OSError, subprocess.SubprocessError) as error:
        done.append(error)


def is_armed(pid: int) -> bool:
    """Whether a tracer holds on to all threads of a process."""
    try:
        threads = os.listdir(f"/proc/{pid}/task")
    except OSError:
        return False
    return all(is_traced(int(thread)) for thread in threads)


def fate(events: Sequence[Event]) -> str | None:
    """What became of the nodes that were struck.

    Args:
        events: Of the flight.

    Returns:
        "crash": one has ended; "hang": one was ended as it did not answer; "alive": neither; None: nothing was struck.
    """
    struck = {event.data["node"] for event in events if event.kind == STRUCK and event.data["hit"]}
    if not struck:
        return None
    lost = [event.data for event in events if event.kind == "node_lost" and event.data["node"] in struck]
    causes = [data["why"] for data in lost if data["why"] != PLANNED]
    if not causes:
        return "alive"
    return "hang" if causes[0] in SILENT else "crash"
