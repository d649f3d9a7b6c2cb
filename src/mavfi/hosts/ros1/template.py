"""A warm process from which flights are forked, with the nodes' modules imported and compiled kernels loaded.

Starting a dozen interpreters takes longer than most flights.  Each thread of a program has one template, which runs its
flights one at a time and exits with it.  Every flight runs in processes of its own.
"""

import atexit
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import traceback
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from mavfi.errors import MachineError, MavfiError
from mavfi.hosts.ros1 import finder
from mavfi.hosts.ros1 import folder as files
from mavfi.hosts.ros1.processes import end_with_parent, isolate, set_environment, write_to

ROOM = 1 << 11
"""Length of the template's command line: forked nodes overwrite it with their own."""
KILLED = "ROS: the process that starts the nodes was killed"
_ENDED, _KILLED = b"ended", b"killed"
_LONGEST = 1 << 20
_PATIENCE_S = 5.0
_NODES = ("world", "kernels", "taps", "node", "free", "supervisor", "launcher", "nodelet_cloud")
_ROS = ("rospy", "rosmaster", "roslaunch", "genpy", "std_srvs.srv", "geometry_msgs.msg", "sensor_msgs.msg")


# ---- in the calling program -----------------------------------------------------------------------------------------
class Template:
    """The template of one thread of this program; its errors are logged with the flight that starts it."""

    def __init__(self, log: Path) -> None:
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._made_by = _maker()
        command = [sys.executable, "-m", "mavfi.hosts.ros1.template", " " * ROOM]
        with theirs, log.open("wb") as errors:
            self._process = subprocess.Popen(
                command, stdin=theirs.fileno(), stdout=errors, stderr=errors, start_new_session=True,
                env={**os.environ, "PYTHONPATH": files.own_path(), **_SINGLE},
            )  # fmt: skip

    def usable(self) -> bool:
        """Whether it runs, and was started under the present settings."""
        return not self.has_ended() and self._made_by == _maker()

    def has_ended(self) -> bool:
        """Whether it has exited."""
        return self._process.poll() is not None

    def begin(self, folder: Path, network: list[str]) -> "Supervision":
        """Start the flight of a folder in a network, see `processes.isolate`; raises `failure` if it has ended."""
        variables = {**os.environ, "PYTHONPATH": files.own_path(), files.FOLDER_VARIABLE: str(folder)}
        reply = b""
        with suppress(OSError):  # the template has exited
            try:
                self._channel.send(json.dumps([variables, str(folder), network]).encode())
                reply = self._channel.recv(_LONGEST)
            except KeyboardInterrupt:
                self.end()
                raise
        if not reply:
            raise self.failure()
        return Supervision(self._channel, int(reply))

    def failure(self) -> MavfiError:
        """Why it has ended: a `MachineError` if it was killed."""
        with suppress(subprocess.TimeoutExpired):  # its socket can be closed before its process has exited
            if self._process.wait(_PATIENCE_S) < 0:
                return MachineError(KILLED)
        self.end()
        return MavfiError("ROS: the process that starts the nodes has ended")

    def end(self) -> None:
        """Terminate it together with its flights."""
        self._channel.close()
        self._process.kill()
        self._process.wait()


class Supervision:
    """A flight in progress; `pid` is its supervisor, which may be `killed`, or `lost` with its template."""

    def __init__(self, channel: socket.socket, pid: int) -> None:
        self.pid = pid
        self._channel = channel
        self._end: bytes | None = None

    def wait(self, seconds: float) -> bool:
        """Wait for the end of the flight; returns whether it has ended."""
        if self._end is None and select.select([self._channel], [], [], seconds)[0]:
            self._end = b""
            with suppress(OSError):
                self._end = self._channel.recv(_LONGEST)
        return self._end is not None

    @property
    def killed(self) -> bool:
        """Whether its supervisor was killed from outside."""
        return self._end == _KILLED

    @property
    def lost(self) -> bool:
        """Whether its template has ended."""
        return self._end == b""

    def stop(self) -> None:
        """Request termination of all its processes."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)


_SINGLE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
_LASTING = ("XDG_", "NUMBA_")
_templates: dict[tuple[int, int], Template] = {}


def _maker() -> tuple[object, ...]:
    """Settings that a template inherits permanently: interpreter, module search path, and cache folders."""
    lasting = [(name, value) for name, value in os.environ.items() if name.startswith(_LASTING)]
    return sys.executable, files.own_path(), os.environ.get(finder.ROOT_VARIABLE), *sorted(lasting)


def template_of_thread(log: Path) -> Template:
    """The template of this thread, started on first use."""
    key = os.getpid(), threading.get_ident()
    for other in [each for each, template in _templates.items() if each[0] == key[0] and template.has_ended()]:
        _templates.pop(other).end()  # its thread has exited
    if key in _templates and not _templates[key].usable():
        _templates.pop(key).end()
    if key not in _templates:
        _templates[key] = Template(log)
    return _templates[key]


@atexit.register
def end_templates() -> None:
    """Terminate the templates of this process; a later flight starts a new one."""
    for key in [key for key in _templates if key[0] == os.getpid()]:
        _templates.pop(key).end()


# ---- in the template ------------------------------------------------------------------------------------------------
def main() -> None:
    """Fork flights until the calling program exits."""
    end_with_parent()
    channel = socket.socket(fileno=os.dup(0))
    warm()
    while request := channel.recv(_LONGEST):
        pid = os.fork()
        if pid == 0:
            channel.close()
            _become(*json.loads(request))
        channel.send(str(pid).encode())
        _, status = os.waitpid(pid, 0)
        channel.send(_KILLED if os.WIFSIGNALED(status) else _ENDED)


def warm() -> None:
    """Import the modules that all flights need, and load the compiled functions of the default mission."""
    import warnings

    from mavfi.hosts.loop.compose import resolve

    finder.enable()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # raised by ROS's own modules
        for name in (*_ROS, *(f"mavfi.hosts.ros1.{name}" for name in _NODES)):
            import_module(name)
    from mavfi.hosts.ros1.kernels import fly_begin
    from mavfi.mission import MissionSpec

    fly_begin(resolve(MissionSpec()))
    gc.collect()
    gc.freeze()


def _become(variables: dict[str, str], folder: str, network: list[str]) -> NoReturn:
    """Become the supervisor of a flight."""
    from mavfi.hosts.ros1 import supervisor

    try:
        os.setsid()
        os.chdir(folder)
        write_to(Path(folder) / files.LOG / "supervisor")
        set_environment(variables)
        isolate(network)
        supervisor.main()
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


if __name__ == "__main__":
    main()
