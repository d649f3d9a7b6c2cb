"""ROS 2 programs that are started with the interposer: faults in their messages, and why some never came about."""

import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import FrameType

from mavfi.errors import BadInputError
from mavfi.extras.ros.processes import descendants
from mavfi.extras.ros.ros2.environment import find_installation
from mavfi.extras.ros.ros2.fault_text import parse_fault
from mavfi.extras.ros.ros2.injection import GraphInjection
from mavfi.extras.ros.ros2.interposer.attach import is_loaded
from mavfi.extras.ros.ros2.interposer.page import ControlPage
from mavfi.extras.ros.ros2.processes import program_of

_LIBRARIES = ("/librcl.so", "/librmw_")
_LOOK_S = 1.0
"""How often the processes are looked at for one that cannot be reached (s)."""


class StartedGraph:
    """A command that is run with faults, in the ROS 2 of this shell or the first that is installed.

    A context manager that ends it.

    Args:
        command: Program and arguments.
        texts: The faults, see `fault_text`.
        seed: Of the first fault; the others have the next ones.

    Attributes:
        exit_code: Of the command, once it has ended.

    Raises:
        BadInputError: A fault is not understood, or the command cannot be started.
    """

    def __init__(self, command: Sequence[str], texts: Sequence[str], seed: int = 0) -> None:
        self._command = list(command)
        self._installation = find_installation()
        self._faults = [parse_fault(text, seed + index) for index, text in enumerate(texts)]
        self._unreached: dict[int, str] = {}
        self._next_look = 0.0
        self.exit_code = 0

    def __enter__(self) -> "StartedGraph":
        self._page = ControlPage()
        self._page.arm(self._faults)
        self._armed_s = time.time()
        self._earlier_handlers = {
            number: signal.signal(number, self._pass_on) for number in (signal.SIGINT, signal.SIGTERM)
        }
        variables = self._installation.environment(**self._page.environment())
        try:
            self._process = subprocess.Popen(self._command, env=variables)
        except OSError as error:
            raise BadInputError(f"{self._command[0]}: cannot be started ({error.strerror})") from None
        return self

    def __exit__(self, *_: object) -> None:
        self._page.disarm()
        if self._process.poll() is None:
            self._process.terminate()
            self._process.wait()
        for number, handler in self._earlier_handlers.items():
            signal.signal(number, handler)

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        """Leave the end to the command: the terminal sends Ctrl-C to both, SIGTERM is passed on."""
        if number == signal.SIGTERM:
            self._process.terminate()

    @property
    def has_ended(self) -> bool:
        """Whether the command has ended."""
        code = self._process.poll()
        if code is None:
            self._look_for_unreached()
            return False
        self.exit_code = code
        if code < 0:  # by a signal, as shells report it
            self.exit_code = 128 - code
        return True

    def new_reports(self) -> Iterator[GraphInjection]:
        """Injections and refusals since the last call."""
        for report in self._page.reports():
            yield GraphInjection(self._faults[report.fault], report, self._armed_s, program_of(report.pid))

    def summary(self) -> list[str]:
        """For each fault, how many messages passed and were changed; if none passed, why not."""
        lines = []
        for index, fault in enumerate(self._faults):
            seen = self._page.messages_seen(index)
            line = f"{fault.topic}: {self._page.messages_changed(index)} of {seen} messages changed"
            if seen == 0:
                count = len(set(self._page.pids()))
                line = (
                    f"{fault.topic}: NOT injected: none of {count} processes had a message of it on side {fault.side}"
                )
            lines.append(line)
        return lines + [f"process {pid}: {reason}" for pid, reason in self._unreached.items()]

    def _look_for_unreached(self) -> None:
        """Remember processes of ROS 2 into which the interposer was not loaded."""
        if time.monotonic() < self._next_look:
            return
        self._next_look = time.monotonic() + _LOOK_S
        for pid in descendants(self._process.pid):
            with suppress(OSError):
                maps = Path(f"/proc/{pid}/maps").read_text()
                if any(library in maps for library in _LIBRARIES) and not is_loaded(pid):
                    self._unreached[pid] = (
                        f"{program_of(pid)} runs ROS 2 without the interposer (setuid, or it clears LD_PRELOAD): "
                        "its messages were not changed"
                    )
