"""A warm process that flights are forked from: it has imported what nodes need, and loaded compiled kernels.

To start a dozen interpreters takes longer than most flights.  A thread of a program has one template, which waits for
its flights, one at a time, and ends with it.  Whatever a flight does happens in processes of its own.
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

from mavfi.errors import MavfiError
from mavfi.hosts.ros1 import finder
from mavfi.hosts.ros1 import folder as files
from mavfi.hosts.ros1.processes import end_with_parent, isolate, set_environment, write_to

ROOM = 1 << 11
"""Length of the command line of a template: nodes, which are forked from it, show their own there."""
_LONGEST = 1 << 20
_NODES = ("world", "kernels", "taps", "node", "free", "supervisor", "launcher", "nodelet_cloud")
_ROS = ("rospy", "rosmaster", "roslaunch", "genpy", "std_srvs.srv", "geometry_msgs.msg", "sensor_msgs.msg")


# ---- in the program that wants to fly -------------------------------------------------------------------------------
class Template:
    """The template of one thread of this program; its own errors go to the log of the flight that begins it."""

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
        """Whether it is there, and would begin in the same way again."""
        return not self.has_ended() and self._made_by == _maker()

    def has_ended(self) -> bool:
        """Whether it is gone."""
        return self._process.poll() is not None

    def begin(self, folder: Path, network: list[str]) -> "Supervision":
        """Begin the flight of a folder in a network of its own, see `processes.isolate`; `MavfiError` if that fails."""
        variables = {**os.environ, "PYTHONPATH": files.own_path(), files.FOLDER_VARIABLE: str(folder)}
        told = b""
        with suppress(OSError):  # it has ended
            try:
                self._channel.send(json.dumps([variables, str(folder), network]).encode())
                told = self._channel.recv(_LONGEST)
            except KeyboardInterrupt:
                self.end()
                raise
        if not told:
            raise MavfiError("ROS: the process that starts the nodes has ended")
        return Supervision(self._channel, int(told))

    def end(self) -> None:
        """End it; flights that are under way end as well."""
        self._channel.close()
        self._process.kill()
        self._process.wait()


class Supervision:
    """A flight under way; `pid` is its supervisor."""

    def __init__(self, channel: socket.socket, pid: int) -> None:
        self.pid = pid
        self._channel = channel
        self._ended = False

    def wait(self, seconds: float) -> bool:
        """Wait for its end; whether it has come."""
        if not self._ended and select.select([self._channel], [], [], seconds)[0]:
            self._channel.recv(_LONGEST)
            self._ended = True
        return self._ended

    def stop(self) -> None:
        """Ask it to end everything."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)


_SINGLE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
_LASTING = ("XDG_", "NUMBA_")
_templates: dict[tuple[int, int], Template] = {}


def _maker() -> tuple[object, ...]:
    """What a template takes from its maker for good: the interpreter, and where that finds modules and their code."""
    lasting = [(name, value) for name, value in os.environ.items() if name.startswith(_LASTING)]
    return sys.executable, files.own_path(), os.environ.get(finder.ROOT_VARIABLE), *sorted(lasting)


def template_of_thread(log: Path) -> Template:
    """The template of this thread, made if there is none yet."""
    key = os.getpid(), threading.get_ident()
    for other in [each for each, template in _templates.items() if each[0] == key[0] and template.has_ended()]:
        _templates.pop(other).end()  # their threads have ended
    if key in _templates and not _templates[key].usable():
        _templates.pop(key).end()
    if key not in _templates:
        _templates[key] = Template(log)
    return _templates[key]


@atexit.register
def end_templates() -> None:
    """End the templates of this process; its next flight makes another one."""
    for key in [key for key in _templates if key[0] == os.getpid()]:
        _templates.pop(key).end()


# ---- in the template ------------------------------------------------------------------------------------------------
def main() -> None:
    """Fork flights until the program that wants them has ended."""
    end_with_parent()
    channel = socket.socket(fileno=os.dup(0))
    warm()
    while request := channel.recv(_LONGEST):
        pid = os.fork()
        if pid == 0:
            channel.close()
            _become(*json.loads(request))
        channel.send(str(pid).encode())
        os.waitpid(pid, 0)
        channel.send(b"ended")


def warm() -> None:
    """Import what any flight needs, and load the compiled functions of the usual one."""
    import warnings

    from mavfi.hosts.loop.compose import resolve

    finder.enable()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ROS's own modules
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
