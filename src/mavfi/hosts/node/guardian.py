"""Restores the graph when mavfi lets go of it, also when mavfi is killed.

It is a process of its own, out of reach of the keyboard: it waits for the end of its input, and then undoes what the
last line of it lists.  A `Guardian` is the other end of that pipe.
"""

import json
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass

from mavfi.errors import MavfiError
from mavfi.hosts.node.master import CALLER, MASTER_CALLER, call

_LAST_WORDS_S = 10.0
_BACK_S = 2.0
_POLL_S = 0.005


@dataclass(frozen=True, slots=True)
class Turned:
    """A reader of a topic that was turned to us: its name and address, and those of its publishers before."""

    topic: str
    node: str
    uri: str
    publishers: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Registered:
    """A publisher or reader (`role`) that we registered, as which node and at which address."""

    topic: str
    node: str
    uri: str
    role: str = "Publisher"


class Guardian:
    """Starts the process, and sends it what is to be undone; `master` is the address of the master."""

    def __init__(self, master: str) -> None:
        self._master = master
        self._turned: dict[tuple[str, str], Turned] = {}
        self._registered: list[Registered] = []
        self._process = subprocess.Popen(
            [sys.executable, "-m", "mavfi.hosts.node.guardian"], stdin=subprocess.PIPE, start_new_session=True
        )

    def remember(self, what: Turned | Registered) -> None:
        """Add something to be undone, before it is done."""
        if isinstance(what, Turned):
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
        """Undo everything, and wait for the end; `MavfiError` if it takes too long."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(_LAST_WORDS_S)
        except subprocess.TimeoutExpired:
            raise MavfiError(f"the ROS graph: is not put back after {_LAST_WORDS_S:g} s, still trying") from None


def publishers_of(master: str, topic: str) -> list[str]:
    """Addresses of the publishers of a topic, by the master; those that the master has lost are left out."""
    found = []
    for name, nodes in call(master, "getSystemState", CALLER)[0]:
        for node in nodes if name == topic else ():
            with suppress(MavfiError):
                found.append(call(master, "lookupNode", CALLER, node))
    return found


def undo(task: dict) -> None:
    """Undo what a line lists; nodes that are gone need nothing."""
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
    """Wait until a reader has its connections again; it makes them after it has answered."""
    end = time.monotonic() + _BACK_S
    while time.monotonic() < end:
        rows = call(turned["uri"], "getBusInfo", CALLER)
        if sum(row[2] == "i" and row[4] == turned["topic"] for row in rows) >= publishers:
            return
        time.sleep(_POLL_S)


def main() -> None:
    """Wait for the end of the input, and undo what its last line lists."""
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
