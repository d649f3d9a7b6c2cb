"""Processes and networks of flights and benches: everything that was started can be found and ended by its id."""

import ctypes
import fcntl
import os
import signal
import socket
import struct
import subprocess
import time
from contextlib import suppress
from pathlib import Path

from mavfi.errors import BadInputError

# <linux/prctl.h>
_PARENT_DIED = 1  # PR_SET_PDEATHSIG
_NAME = 15  # PR_SET_NAME
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER
# <linux/sockios.h>
_GET_FLAGS = 0x8913  # SIOCGIFFLAGS
_SET_FLAGS = 0x8914  # SIOCSIFFLAGS
_UP = 0x1  # IFF_UP
_MULTICAST = 0x1000  # IFF_MULTICAST
_POLL_S = 0.005


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def end_with_parent(number: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel send a signal to this process when its parent thread exits."""
    _libc().prctl(_PARENT_DIED, number)


def adopt_orphans() -> None:
    """Become the parent of orphaned descendants (subreaper)."""
    _libc().prctl(_SUBREAPER, 1)


def name_process(name: str) -> None:
    """Give this process a name of up to 15 characters, as shown by `ps`."""
    _libc().prctl(_NAME, name.encode()[:15])


def is_alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def is_traced(pid: int) -> bool:
    """Whether a tracer is attached to a thread of a process."""
    for path in Path(f"/proc/{pid}/task").glob("*/status"):
        with suppress(OSError):  # the thread has ended
            if "TracerPid:\t0\n" not in path.read_text():
                return True
    return False


def reap() -> bool:
    """Reap exited children; returns whether any children remain."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def children_by_parent() -> dict[int, list[int]]:
    """Process ids of the children of each process that has some."""
    children: dict[int, list[int]] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            children.setdefault(int(fields[1]), []).append(int(path.parent.name))
    return children


def descendants(pid: int) -> list[int]:
    """A process and all that descend from it."""
    children = children_by_parent()
    family = [pid]
    for parent in family:
        family += children.get(parent, [])
    return family


def end_all() -> None:
    """Kill all children, including orphaned descendants as they are adopted."""
    while reap():
        for pid in children_by_parent().get(os.getpid(), []):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(_POLL_S)


def absolute_python_path() -> str:
    """PYTHONPATH of this process with absolute folders, as nodes have other working directories."""
    folders = os.environ.get("PYTHONPATH", "")
    return os.pathsep.join(os.path.abspath(folder) for folder in folders.split(os.pathsep) if folder)


# ---- private network and shared memory -------------------------------------------------------------------------------


def private_network(allowed: str = "as root, or with user namespaces") -> list[str]:
    """Command that runs a program in private network and mount namespaces, unreachable from outside.

    Required as ROS 2's discovery listens on all interfaces regardless of its settings, and as a killed node leaves
    files in `/dev/shm`: see `private_shared_memory`.

    Raises:
        BadInputError: None can be created; the message names the alternatives.
    """
    for command in (["unshare", "-n", "-m"], ["unshare", "-Urnm"]):
        try:
            if subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0:
                return command
        except OSError:
            break
    raise BadInputError(
        "no private network: neither `unshare -n -m` nor `unshare -Urnm` works here, and ROS listens on all "
        f"interfaces; allowed: {allowed}"
    )


def loopback_up() -> None:
    """Bring up the loopback interface of the private network, with multicast; `OSError` if not permitted."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sh14x", b"lo", 0)
        flags = struct.unpack("16sh14x", fcntl.ioctl(any_socket, _GET_FLAGS, request))[1]
        fcntl.ioctl(any_socket, _SET_FLAGS, struct.pack("16sh14x", b"lo", flags | _UP | _MULTICAST))


def private_shared_memory() -> None:
    """Mount an empty `/dev/shm`; only in a mount namespace of this process's own.  `OSError` if not permitted."""
    if _libc().mount(b"tmpfs", b"/dev/shm", b"tmpfs", 0, None) != 0:
        raise OSError(ctypes.get_errno(), "mount /dev/shm")
