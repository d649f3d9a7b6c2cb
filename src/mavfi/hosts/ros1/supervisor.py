"""Supervises a flight in its private network: starts roslaunch, and terminates all processes however the flight ends.

Orphans become its children, so that every process of the flight can be found and killed by its id.
"""

import fcntl
import os
import signal
import socket
import struct
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType

from mavfi.errors import BadInputError
from mavfi.hosts.ros1 import folder as files
from mavfi.hosts.ros1.processes import adopt_orphans, end_with_parent

_GET_FLAGS, _SET_FLAGS, _UP = 0x8913, 0x8914, 0x1  # SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP of <linux/sockios.h>
_POLL_S = 0.02
_STOP = [False]


def main() -> None:
    """Supervise a flight until it ends, the parent exits, or a signal arrives."""
    from mavfi.hosts.ros1 import launcher

    parent = os.getppid()
    folder = files.flight_folder()
    end_with_parent(signal.SIGTERM)
    adopt_orphans()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, _stop)
    with suppress(OSError):  # outside a private network it is already up
        loopback_up()
    try:
        if os.fork() == 0:
            launcher.main(folder)
        files.write_file(files.PID, str(os.getpid()).encode())
        while not _STOP[0] and not any((folder / name).exists() for name in (files.FLIGHT, files.FAILURE)):
            if not reap():
                break
            time.sleep(_POLL_S)
    finally:
        end_all()
        if os.getppid() != parent:  # no process is left to read the results
            files.remove_folder(folder)


def _stop(number: int, frame: FrameType | None) -> None:
    _STOP[0] = True


def private_network(allowed: str = "as root, or with user namespaces") -> list[str]:
    """Command that runs a program in a private network namespace, unreachable from outside.

    Required as roscpp listens on all interfaces regardless of its settings.

    Raises:
        BadInputError: None can be created; the message names the alternatives.
    """
    for way in (["unshare", "-n"], ["unshare", "-Urn"]):
        try:
            if subprocess.run([*way, "true"], capture_output=True, check=False).returncode == 0:
                return way
        except OSError:
            break
    raise BadInputError(
        "no private network: neither `unshare -n` nor `unshare -Urn` works here, and ROS's C++ nodes listen on all "
        f"interfaces; allowed: {allowed}"
    )


def loopback_up() -> None:
    """Bring up the loopback interface of the private network; `OSError` if not permitted."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sh14x", b"lo", 0)
        flags = struct.unpack("16sh14x", fcntl.ioctl(any_socket, _GET_FLAGS, request))[1]
        fcntl.ioctl(any_socket, _SET_FLAGS, struct.pack("16sh14x", b"lo", flags | _UP))


def reap() -> bool:
    """Reap exited children; returns whether any children remain."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def children(parent: int) -> list[int]:
    """Process ids of the children of a process."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[1]) == parent:
                found.append(int(path.parent.name))
    return found


def end_all() -> None:
    """Kill all children, including orphaned descendants as they are adopted."""
    while reap():
        for pid in children(os.getpid()):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(_POLL_S / 4)
