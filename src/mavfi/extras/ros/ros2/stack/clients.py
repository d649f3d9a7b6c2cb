"""Clients of the processes that run a stack: launchers, the driver, and the commands of the stack."""

import json
import socket
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.ros2.agent import Frames
from mavfi.extras.ros.ros2.environment import Installation
from mavfi.extras.ros.ros2.stack.config import StackConfig

_FOLDER = Path(__file__).parent
ANSWER_S = 30.0
"""Time limit for an answer, in addition to what a request may wait for (s)."""
_PYTHONS = ("python", "python3")


class LauncherClient:
    """A process that starts others, see `launcher.py`."""

    def __init__(self, python: str, variables: Mapping[str, str], *role: str) -> None:
        self._socket, theirs = socket.socketpair()
        self.process = subprocess.Popen(
            [python, str(_FOLDER / "launcher.py"), str(theirs.fileno()), *role],
            env=dict(variables),
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        theirs.close()
        self._stream = self._socket.makefile("rb")

    def ask(self, action: str, descriptor: int | None = None, **keys: Any) -> dict[str, Any]:
        """Send a request, with a file descriptor if there is one; return the reply."""
        self.send(action, descriptor, **keys)
        return self.answer()

    def send(self, action: str, descriptor: int | None = None, **keys: Any) -> None:
        """Send a request; `answer` must follow."""
        line = json.dumps({"do": action, **keys}).encode() + b"\n"
        descriptors = []
        if descriptor is not None:
            descriptors = [descriptor]
        with suppress(OSError):  # the missing answer tells
            socket.send_fds(self._socket, [line], descriptors)

    def answer(self) -> dict[str, Any]:
        """The reply to the last request."""
        line = self._stream.readline()
        if not line:
            self.process.wait(ANSWER_S)
            assert self.process.stderr is not None  # a pipe
            lines = self.process.stderr.read().decode(errors="replace").strip().splitlines() or ["no message"]
            raise MavfiError(f"launcher of the stack: has ended ({lines[-1]})")
        reply: dict[str, Any] = json.loads(line)
        if "error" in reply:
            raise MavfiError(f"launcher of the stack: {reply['error']}")
        return reply

    def close(self) -> None:
        """End it, and all that it has started."""
        self._stream.close()
        self._socket.close()
        try:
            self.process.wait(ANSWER_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        assert self.process.stderr is not None  # a pipe
        self.process.stderr.close()


class DriverClient:
    """The driver of a trial, see `driver.py`."""

    def __init__(self, launcher: LauncherClient) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            self.pid = int(launcher.ask("drive", theirs.fileno())["pid"])
        self._frames = Frames(self._socket)
        self._number = 0

    def wait(self) -> None:
        """Wait until it is a node."""
        self._socket.settimeout(ANSWER_S)
        event = self._receive()
        if event.get("event") != "ready":
            raise MavfiError(f"driver of the stack: {event.get('text', 'has ended')}")

    def ask(self, action: str, content: bytes = b"", waits_s: float = 0.0, **keys: Any) -> dict[str, Any]:
        """Send a request; return the reply.

        Raises:
            BadInputError: It cannot be met; the message says why.
        """
        self._number += 1
        self._socket.settimeout(waits_s + ANSWER_S)
        with suppress(OSError):  # the missing answer tells
            self._frames.send({"id": self._number, "do": action, **keys}, content)
        while True:
            reply = self._receive()
            if reply.get("id") == self._number:
                break
        if "error" in reply:
            raise BadInputError(f"stack: {reply['error']}")
        return reply

    def _receive(self) -> dict[str, Any]:
        frame = self._frames.receive()
        if frame is None:
            raise MavfiError("driver of the stack: has ended, or does not answer")
        header: dict[str, Any] = frame[0]
        return header

    def close(self) -> None:
        """Let it end."""
        self._socket.close()


class StackProcesses:
    """Starts the commands of a stack, each from the launcher that is the quickest."""

    def __init__(self, stack: StackConfig, installation: Installation, variables: Mapping[str, str]) -> None:
        self._commands = [with_python(command, installation) for command in stack.commands]
        self._launchers: list[LauncherClient] = []
        self._of_command: list[LauncherClient] = []
        plain: LauncherClient | None = None
        for command in self._commands:
            is_script = command[0] == installation.python and len(command) > 1 and command[1].endswith(".py")
            if is_script and stack.fork:
                launcher = LauncherClient(installation.python, variables, "node", command[1])
                self._launchers.append(launcher)
            else:
                if plain is None:
                    plain = LauncherClient(installation.python, variables, "plain")
                    self._launchers.append(plain)
                launcher = plain
            self._of_command.append(launcher)
        self.forks = [bool(launcher.ask("ready")["forks"]) for launcher in self._of_command]

    def load(self, kinds: Sequence[str]) -> None:
        """Load the libraries of message types where scripts are forked."""
        for launcher, forks in zip(self._of_command, self.forks, strict=True):
            if forks:
                launcher.ask("load", kinds=list(kinds))

    def start(self, namespace: int, folder: Path) -> list[int]:
        """Start all commands in the namespaces of a process; returns their process ids, in the order of commands."""
        for index, launcher in enumerate(self._of_command):
            log = str(folder / f"{index}.log")
            launcher.send("start", command=self._commands[index], namespace=namespace, log=log)
        return [int(launcher.answer()["pid"]) for launcher in self._of_command]

    def end(self) -> dict[int, int]:
        """End all processes; returns how those ended that had ended before, by process id (as `waitpid` does)."""
        for launcher in self._launchers:
            launcher.send("end")
        statuses: dict[int, int] = {}
        for launcher in self._launchers:
            statuses |= {int(pid): status for pid, status in launcher.answer()["statuses"].items()}
        return statuses

    def close(self) -> None:
        """End the launchers."""
        for launcher in self._launchers:
            launcher.close()


def with_python(command: Sequence[str], installation: Installation) -> list[str]:
    """A command whose interpreter is that of the installation."""
    if command[0] in _PYTHONS:
        return [installation.python, *command[1:]]
    return list(command)


class StartError(BadInputError):
    """The stack does not start: something is missing, or one of its processes has ended before it was tried."""
