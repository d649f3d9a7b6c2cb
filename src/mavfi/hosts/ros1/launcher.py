"""roslaunch with nodes forked from a warm process instead of started as new interpreters.

The roslaunch process has one single-threaded child, the image.  For each node the image forks twice, and roslaunch
adopts the grandchild.  To roslaunch this is an ordinary process with its own id, session, environment and log, which
can be killed and is then restarted.
"""

import json
import os
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

from mavfi.hosts.ros1 import finder
from mavfi.hosts.ros1 import folder as files
from mavfi.hosts.ros1.plan import load_plan
from mavfi.hosts.ros1.processes import adopt_orphans, end_with_parent, set_environment, show_as, usual_signals, write_to

_LONGEST = 1 << 20
_MASTER = "rosmaster"
_ADOPTION_S = 1e-3


def main(folder: Path) -> NoReturn:
    """Launch the nodes of a flight and restart those that die, until shutdown."""
    try:
        _launch(folder)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)


def _launch(folder: Path) -> None:
    end_with_parent()
    usual_signals()
    os.setsid()
    os.chdir(folder)
    set_environment(files.environment(folder))
    write_to(folder / files.LOG / "roslaunch")
    adopt_orphans()
    if load_plan().forked:
        _fork_nodes(folder)
    arguments = [
        "roslaunch", "--skip-log-check", "--disable-title", "-p", files.master_port(), str(folder / files.LAUNCH_FILE)
    ]  # fmt: skip
    show_as(arguments[0], arguments)
    sys.argv[:] = arguments
    import roslaunch

    roslaunch.main(arguments)


def _fork_nodes(folder: Path) -> None:
    """Redirect roslaunch's process creation to forks of the image."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    launcher = os.getpid()
    if os.fork() == 0:
        ours.close()
        _serve(theirs, launcher)
    theirs.close()
    from roslaunch import nodeprocess

    lock, node = threading.Lock(), str(folder / files.PACKAGE / files.EXECUTABLE)

    def start(args: list[str], **options: Any) -> Any:  # noqa: ANN401
        if args[0] not in (_MASTER, node):
            return subprocess.Popen(args, **options)
        with lock:
            return Forked(ours, args, **options)

    nodeprocess.subprocess = SimpleNamespace(Popen=start, PIPE=subprocess.PIPE)


class Forked:
    """The subset of `subprocess.Popen` that roslaunch uses."""

    def __init__(
        self, channel: socket.socket, args: list[str], *, cwd: str, env: Mapping[str, str], stdout: Any, stderr: Any,
        **options: object,
    ) -> None:  # fmt: skip
        del options
        request = json.dumps([args, cwd, dict(env)]).encode()
        socket.send_fds(channel, [request], [1 if stdout is None else stdout.fileno(), 2])
        del stderr  # roslaunch inherits its own
        self.pid = int(channel.recv(_LONGEST) or b"0")
        if not self.pid:
            raise OSError("the process that forks nodes has ended")
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Exit code; None = running."""
        if self.returncode is None:
            with suppress(ChildProcessError):
                pid, status = os.waitpid(self.pid, os.WNOHANG)
                if pid:
                    self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode


# ---- the image ------------------------------------------------------------------------------------------------------
def _serve(channel: socket.socket, launcher: int) -> NoReturn:
    """Fork the requested processes, the master first, until roslaunch exits."""
    end_with_parent()
    plan = None
    while True:
        request, descriptors, _, _ = socket.recv_fds(channel, _LONGEST, 2)
        if not request:
            os._exit(0)
        args, cwd, variables = json.loads(request)
        first = os.fork()
        if first == 0:
            if os.fork():
                os._exit(0)
            _become(channel, launcher, descriptors, args, cwd, variables, plan)
        os.waitpid(first, 0)
        for descriptor in descriptors:
            os.close(descriptor)
        if plan is None:
            plan = _prepare()


def _prepare() -> Any:  # noqa: ANN401
    """Load the code that all nodes of this flight share; returns its plan."""
    finder.enable(files.flight_folder() / files.MESSAGES)
    from mavfi.hosts.ros1.generate import state_types
    from mavfi.hosts.ros1.kernels import fly_begin

    plan = load_plan()
    state_types()
    with suppress(Exception):  # the node concerned reports the error
        fly_begin(plan.scenario)
    return plan


def _become(
    channel: socket.socket, launcher: int, descriptors: list[int], args: list[str], cwd: str,
    variables: dict[str, str], plan: Any,
) -> NoReturn:  # fmt: skip
    """Become a node after adoption by roslaunch."""
    while os.getppid() != launcher:
        time.sleep(_ADOPTION_S)
    end_with_parent()
    usual_signals()
    os.setsid()
    os.chdir(cwd)
    set_environment(variables)
    for descriptor, place in zip(descriptors, (1, 2), strict=True):
        os.dup2(descriptor, place)
        os.close(descriptor)
    sys.argv[:] = args
    name, run = _program(args, plan)
    show_as(name, _shown(args))
    channel.send(str(os.getpid()).encode())
    channel.close()
    code = 1
    try:
        run()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _program(args: list[str], plan: Any) -> tuple[str, Callable[[], None]]:
    """Name and entry function of a program."""
    if args[0] == _MASTER:
        import rosmaster

        return _MASTER, lambda: rosmaster.rosmaster_main(args)
    from mavfi.hosts.ros1 import node

    return args[1], lambda: node.main(plan)


def _shown(args: list[str]) -> list[str]:
    """The command line that an unforked process would show."""
    return args if args[0] == _MASTER else [sys.executable, "-m", "mavfi.hosts.ros1.node", *args[1:]]
