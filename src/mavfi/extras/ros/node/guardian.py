"""Restores the ROS graph when mavfi detaches from it, even if mavfi is killed.

A separate process, immune to keyboard interrupts, waits for the end of its standard input, and then undoes the changes
listed in the last line.  `Guardian` is the writing end of this pipe.
"""

import json
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass

from mavfi.errors import MavfiError
from mavfi.extras.ros.node.master import CALLER, MASTER_CALLER, call

_LAST_WORDS_S = 10.0
_BACK_S = 2.0
_POLL_S = 0.005


@dataclass(frozen=True, slots=True)
class RedirectedSubscriber:
    """A subscriber redirected to mavfi: its name and address, and the addresses of its original publishers."""

    topic: str
    node: str
    uri: str
    publishers: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Registration:
    """A publisher or subscriber (`role`) registered by mavfi, with the node name and address used."""

    topic: str
    node: str
    uri: str
    role: str = "Publisher"


class Guardian:
    """Starts the process, and sends it the changes to undo; `master`: address of the master."""

    def __init__(self, master: str) -> None:
        self._master = master
        self._turned: dict[tuple[str, str], RedirectedSubscriber] = {}
        self._registered: list[Registration] = []
        self._process = subprocess.Popen(
            [sys.executable, "-m", "mavfi.extras.ros.node.guardian"], stdin=subprocess.PIPE, start_new_session=True
        )

    def remember(self, what: RedirectedSubscriber | Registration) -> None:
        """Add a change to be undone; to be called before the change is made."""
        if isinstance(what, RedirectedSubscriber):
            self._turned[what.topic, what.uri] = what
        else:
            self._registered.append(what)
        task = {
            "master": self._master,
            "turned": [asdict(turned) for turned in self._turned.values()],
            "registered": [asdict(registered) for registered in self._registered],
        }
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(task).encode() + b"\n")
        self._process.stdin.flush()

    def undo(self) -> None:
        """Undo all changes, and wait for completion; `MavfiError` on timeout."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(_LAST_WORDS_S)
        except subprocess.TimeoutExpired:
            raise MavfiError(f"the ROS graph: is not put back after {_LAST_WORDS_S:g} s, still trying") from None


def publishers_of(master: str, topic: str) -> list[str]:
    """Addresses of a topic's publishers according to the master, without unreachable ones."""
    addresses = []
    for name, nodes in call(master, "getSystemState", CALLER)[0]:
        if name != topic:
            continue
        for node in nodes:
            with suppress(MavfiError):
                addresses.append(call(master, "lookupNode", CALLER, node))
    return addresses


def undo(task: dict) -> None:
    """Undo the changes that a line lists; nodes that have terminated are skipped."""
    for registered in task["registered"]:
        with suppress(MavfiError):
            method = f"unregister{registered['role']}"
            call(task["master"], method, registered["node"], registered["topic"], registered["uri"])
    for turned in task["turned"]:
        publishers = turned["publishers"]
        with suppress(MavfiError):
            publishers = publishers_of(task["master"], turned["topic"])
        with suppress(MavfiError):
            call(turned["uri"], "publisherUpdate", MASTER_CALLER, turned["topic"], publishers)
            _wait_until_back(turned, len(publishers))


def _wait_until_back(turned: dict, publishers: int) -> None:
    """Wait until a subscriber has its connections back; it establishes them after its response."""
    end = time.monotonic() + _BACK_S
    while time.monotonic() < end:
        rows = call(turned["uri"], "getBusInfo", CALLER)
        if sum(row[2] == "i" and row[4] == turned["topic"] for row in rows) >= publishers:
            return
        time.sleep(_POLL_S)


def main() -> None:
    """Wait for the end of the input, and undo the changes listed in its last line."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    last = ""
    for line in sys.stdin:
        if line.endswith("\n"):
            last = line
    if last:
        undo(json.loads(last))


if __name__ == "__main__":
    main()
