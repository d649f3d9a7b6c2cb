"""Supervises a flight in its private network: starts the nodes, restarts those that die, ends all.

It imports what the nodes need and loads the compiled kernels once, then forks each node; so a node is there, or back,
in a moment.  Orphans become its children, so that every process of the flight can be found and killed by its id.
"""

import gc
import os
import signal
import sys
import time
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import NoReturn

from mavfi.extras.ros.lockstep import folder as files
from mavfi.extras.ros.lockstep.kernels import DetectorNode, InjectorNode, KernelNode, warm_up
from mavfi.extras.ros.lockstep.plan import DETECTOR, INJECTOR, WORLD, FlightPlan, load_plan
from mavfi.extras.ros.lockstep.ports import Ports
from mavfi.extras.ros.lockstep.world import fly
from mavfi.extras.ros.processes import (
    adopt_orphans,
    end_all,
    end_with_parent,
    loopback_up,
    name_process,
    private_shared_memory,
)

ISOLATED = "isolated"
"""Argument of a supervisor in private namespaces."""
_POLL_S = 0.02
_STOP = [False]


def main() -> None:
    """Supervise a flight until it ends, the parent exits, or a signal arrives.

    Arguments: process id of the parent, and `ISOLATED` in private namespaces.
    """
    end_with_parent(signal.SIGTERM)
    adopt_orphans()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, _stop)
    parent = int(sys.argv[1])
    _STOP[0] = os.getppid() != parent  # it ended before the first line
    if ISOLATED in sys.argv:
        loopback_up()
        private_shared_memory()
    folder = files.flight_folder()
    try:
        files.write_file(files.PID, str(os.getpid()).encode())
        plan = load_plan()
        plan.middleware.prepare(folder)
        _supervise(_load(plan), folder)
    finally:
        end_all()
        if os.getppid() != parent:  # no process is left to read the results
            files.remove_folder(folder)


def _stop(number: int, frame: FrameType | None) -> None:
    _STOP[0] = True


def _load(plan: FlightPlan) -> FlightPlan:
    """Import what the nodes need, and load the compiled functions of this flight; returns the plan as it was."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # raised by ROS's own modules
        plan.middleware.load()
    with suppress(Exception):  # the node concerned reports the error
        warm_up(plan.scenario)
    gc.collect()
    gc.freeze()  # a collection in a node would copy the memory that it shares with the others
    return load_plan()


def _supervise(plan: FlightPlan, folder: Path) -> None:
    """Keep the nodes running until the flight has ended, the world's node is dead, or a signal comes."""
    running: dict[int, str] = {}
    for name in (WORLD, *plan.nodes):
        running[_fork(name, plan, folder)] = name
    while not _STOP[0] and not any((folder / name).exists() for name in (files.FLIGHT, files.FAILURE)):
        pid, _ = os.waitpid(-1, os.WNOHANG)
        name = running.pop(pid, "")
        if name == WORLD:
            return
        if name:
            running[_fork(name, plan, folder)] = name
        elif not pid:
            time.sleep(_POLL_S)


def _fork(name: str, plan: FlightPlan, folder: Path) -> int:
    """Start a node in a process with a session, a name and a log of its own; returns its id."""
    pid = os.fork()
    if pid == 0:
        end_with_parent()
        os.setsid()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        name_process(name)
        log = os.open(folder / files.LOG / f"{name}.out", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        run_node(name, plan)
    return pid


# ---- a node, in a forked process -------------------------------------------------------------------------------------


def run_node(name: str, plan: FlightPlan) -> NoReturn:
    """Run a node until the supervisor ends it; an exception ends it at once, and in the world's node the flight."""
    try:
        _serve(Ports(name, plan, plan.middleware.connect(name)))
    except BaseException:
        traceback.print_exc()
        if name == WORLD:
            (files.flight_folder() / files.FAILURE).write_text(traceback.format_exc())
        os._exit(1)
    signal.pause()  # the flight is over
    os._exit(0)


def _serve(ports: Ports) -> None:
    """Run a node; only the world's returns."""
    if ports.node == WORLD:
        fly(ports)
    elif ports.node == INJECTOR:
        InjectorNode(ports).run()
    elif ports.node == DETECTOR:
        DetectorNode(ports).run()
    else:
        KernelNode(ports).run()


if __name__ == "__main__":
    main()
