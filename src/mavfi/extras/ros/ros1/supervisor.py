"""Supervises a flight in its private network: starts the ROS master and the nodes, restarts nodes that die, ends all.

It imports what the nodes need and loads the compiled kernels once, then forks each node; so a node is there, or back,
in a moment.  Orphans become its children, so that every process of the flight can be found and killed by its id.
"""

import ctypes
import fcntl
import gc
import os
import signal
import socket
import struct
import subprocess
import sys
import time
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import NoReturn

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros1 import finder
from mavfi.extras.ros.ros1 import folder as files
from mavfi.extras.ros.ros1.folder import FAILURE, flight_folder
from mavfi.extras.ros.ros1.plan import DETECTOR, INJECTOR, WORLD, FlightPlan, load_plan

# <linux/prctl.h>
_PARENT_DIED = 1  # PR_SET_PDEATHSIG
_NAME = 15  # PR_SET_NAME
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER
# <linux/sockios.h>
_GET_FLAGS = 0x8913  # SIOCGIFFLAGS
_SET_FLAGS = 0x8914  # SIOCSIFFLAGS
_UP = 0x1  # IFF_UP
_POLL_S = 0.02
_MASTER_PATIENCE_S = 60.0
_STOP = [False]


def main() -> None:
    """Supervise a flight until it ends, the parent (its process id is the argument) exits, or a signal arrives."""
    end_with_parent(signal.SIGTERM)
    adopt_orphans()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, _stop)
    parent = int(sys.argv[1])
    _STOP[0] = os.getppid() != parent  # it ended before the first line
    with suppress(OSError):  # outside a private network it is already up
        loopback_up()
    folder = files.flight_folder()
    try:
        files.write_file(files.PID, str(os.getpid()).encode())
        master = _start_master(folder)
        plan = _load(folder)
        _supervise(plan, folder, master)
    finally:
        end_all()
        if os.getppid() != parent:  # no process is left to read the results
            files.remove_folder(folder)


def _stop(number: int, frame: FrameType | None) -> None:
    _STOP[0] = True


def _start_master(folder: Path) -> "subprocess.Popen[bytes]":
    """Start the ROS master, which ends with this process."""
    program = str(finder.find_file("usr/bin/rosmaster"))
    command = [program, "--core", "-p", files.master_port()]
    with (folder / files.LOG / "master.out").open("wb") as output:
        return subprocess.Popen(
            command,
            env=files.environment(folder),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            cwd=folder,
            preexec_fn=end_with_parent,
        )


def _load(folder: Path) -> FlightPlan:
    """Import the modules of all nodes, and load the compiled functions of this flight; returns its plan."""
    import warnings

    finder.enable(folder / files.MESSAGES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # raised by ROS's own modules
        import rospy  # noqa: F401

        from mavfi.extras.ros.ros1 import kernels
        from mavfi.extras.ros.ros1.messages import state_types

        state_types()
    with suppress(Exception):  # the node concerned reports the error
        kernels.warm_up(load_plan().scenario)
    gc.collect()
    gc.freeze()  # a collection in a node would copy the memory that it shares with the others
    return load_plan()


def _supervise(plan: FlightPlan, folder: Path, master: "subprocess.Popen[bytes]") -> None:
    """Keep the nodes running until the flight has ended, the world's node or the master is dead, or a signal comes."""
    _wait_for_master(master)
    running: dict[int, str] = {}
    for name in (WORLD, *plan.nodes):
        running[_fork(name, plan, folder)] = name
    while not _STOP[0] and not any((folder / name).exists() for name in (files.FLIGHT, files.FAILURE)):
        pid, _ = os.waitpid(-1, os.WNOHANG)
        name = running.pop(pid, "")
        if name == WORLD or pid == master.pid:
            return
        if name:
            running[_fork(name, plan, folder)] = name
        elif not pid:
            time.sleep(_POLL_S)


def _wait_for_master(master: "subprocess.Popen[bytes]") -> None:
    """Wait until the master accepts connections, or has ended."""
    end = time.monotonic() + _MASTER_PATIENCE_S
    address = "127.0.0.1", int(files.master_port())
    while master.poll() is None and time.monotonic() < end and not _STOP[0]:
        with socket.socket() as trial:
            if trial.connect_ex(address) == 0:
                return
        time.sleep(_POLL_S)


def _fork(name: str, plan: FlightPlan, folder: Path) -> int:
    """Start a node in a process with a session, a name and a log of its own; returns its id."""
    pid = os.fork()
    if pid == 0:
        end_with_parent()
        os.setsid()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        _prctl(_NAME, name.encode()[:15])
        log = os.open(folder / files.LOG / f"{name}.out", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        run_node(name, plan)
    return pid


# ---- processes and networks -----------------------------------------------------------------------------------------
def _prctl(option: int, value: int | bytes) -> None:
    ctypes.CDLL(None, use_errno=True).prctl(option, value)


def end_with_parent(number: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel send a signal to this process when its parent thread exits."""
    _prctl(_PARENT_DIED, number)


def adopt_orphans() -> None:
    """Become the parent of orphaned descendants (subreaper)."""
    _prctl(_SUBREAPER, 1)


def private_network(allowed: str = "as root, or with user namespaces") -> list[str]:
    """Command that runs a program in a private network namespace, unreachable from outside.

    Required as roscpp listens on all interfaces regardless of its settings.

    Raises:
        BadInputError: None can be created; the message names the alternatives.
    """
    for command in (["unshare", "-n"], ["unshare", "-Urn"]):
        try:
            if subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0:
                return command
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
    numbers = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[1]) == parent:
                numbers.append(int(path.parent.name))
    return numbers


def end_all() -> None:
    """Kill all children, including orphaned descendants as they are adopted."""
    while reap():
        for pid in children(os.getpid()):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(_POLL_S / 4)


# ---- a node, in a forked process -------------------------------------------------------------------------------------


def run_node(name: str, plan: FlightPlan) -> NoReturn:
    """Run a node until the supervisor ends it; an exception ends it at once, and in the world's node the flight."""
    try:
        import rospy

        # values are published without a queue: the order of transmission is that of the calls
        warnings.filterwarnings("ignore", "The publisher should be created", SyntaxWarning)
        rospy.init_node(name, argv=[], disable_signals=True, disable_rostime=True, disable_rosout=True)
        _serve(name, plan)
        signal.pause()
    except BaseException:
        traceback.print_exc()
        if name == WORLD:
            (flight_folder() / FAILURE).write_text(traceback.format_exc())
    os._exit(1)


def _serve(name: str, plan: FlightPlan) -> None:
    if name == WORLD:
        from mavfi.extras.ros.ros1.world import fly

        fly(plan)
    elif name == INJECTOR:
        from mavfi.extras.ros.ros1.kernels import InjectorNode

        InjectorNode(plan).run()
    elif name == DETECTOR:
        from mavfi.extras.ros.ros1.kernels import DetectorNode

        DetectorNode(plan).run()
    else:
        from mavfi.extras.ros.ros1.kernels import KernelNode

        KernelNode(name, plan).run()


if __name__ == "__main__":
    main()
