"""Loads the interposer into running ROS 2 processes, and takes it out of their calls again.

The library and the page are memory without a name, opened by the target through the file descriptors of this process;
so a target in another mount namespace needs no file of ours.
"""

import os
from contextlib import suppress
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.remote_call import StoppedThread, function_address
from mavfi.extras.ros.ros2.interposer.page import ControlPage, library

_NAME = "libmavfi-interposer"
"""Name of the library in the target's memory map, preloaded or loaded late."""
_LOAD_NOW = 2
"""RTLD_NOW of dlopen."""


class Attachments:
    """Running processes into which the interposer has been loaded; a context manager that detaches at the end.

    Args:
        page: Controls the interposer in all of them.

    Attributes:
        redirected: Number of redirected calls by process.
    """

    def __init__(self, page: ControlPage) -> None:
        self._page = page
        self._library_file = os.memfd_create(_NAME, os.MFD_CLOEXEC)
        os.write(self._library_file, library().read_bytes())
        self.redirected: dict[int, int] = {}

    def __enter__(self) -> "Attachments":
        return self

    def __exit__(self, *_: object) -> None:
        for pid in list(self.redirected):
            with suppress(MavfiError, OSError):  # it has ended, or is being traced by somebody else
                self.detach(pid)
        os.close(self._library_file)

    def attach(self, pid: int) -> None:
        """Load the interposer into a process, and redirect its calls.

        Raises:
            BadInputError: The process does not exist, must not be traced, is in another container, or has no ROS 2.
            MavfiError: The library could not be loaded.
        """
        check_target(pid)
        path = f"/proc/{os.getpid()}/fd/{self._library_file}"
        if not os.path.exists(f"/proc/{pid}/root{path}"):
            raise BadInputError(
                f"process {pid}: does not see /proc/{os.getpid()}; allowed: processes of this container"
            )
        calls_before = self._page.redirected_calls()
        try:
            self._load(pid, path)
        except (FileNotFoundError, ProcessLookupError):
            raise BadInputError(f"process {pid}: has ended") from None
        owner = self._page.take_busy_with()
        if owner:
            raise BadInputError(
                f"process {pid}: has faults of mavfi, process {owner}; allowed: after its end, or several --fault "
                "of one `mavfi ros run`"
            )
        redirected = self._page.redirected_calls() - calls_before
        self.redirected[pid] = redirected
        if redirected == 0:
            raise BadInputError(
                f"process {pid}: calls no function of rmw that could be redirected; is it linked statically?"
            )

    def _load(self, pid: int, path: str) -> None:
        """Load the library from a path, and redirect the calls of a process.

        All addresses are looked up before a thread is stopped, or while none is.
        """
        if not is_loaded(pid):
            load = function_address(pid, "dlopen", "libc.so")
            with StoppedThread(pid) as thread:
                thread.call(load, path, _LOAD_NOW)
        if not is_loaded(pid):
            raise MavfiError(f"process {pid}: could not load the interposer")
        redirect = function_address(pid, "mavfi_attach", _NAME, str(library()))
        with StoppedThread(pid) as thread:
            thread.call(redirect, self._page.path)

    def detach(self, pid: int) -> None:
        """Restore the calls of a process."""
        del self.redirected[pid]
        restore = function_address(pid, "mavfi_detach", _NAME, str(library()))
        with StoppedThread(pid) as thread:
            thread.call(restore)


def is_loaded(pid: int) -> bool:
    """Whether a process has the interposer."""
    return _NAME in _maps(pid)


def check_target(pid: int) -> None:
    """Check that a process is a ROS 2 process of this container.

    Raises:
        BadInputError: It is not; the message says why.
    """
    if not os.path.exists(f"/proc/{pid}"):
        raise BadInputError(f"process {pid}: does not exist")
    try:
        other_container = os.stat(f"/proc/{pid}/ns/pid").st_ino != os.stat("/proc/self/ns/pid").st_ino
    except PermissionError:
        raise BadInputError(
            f"process {pid}: belongs to another user; allowed: run mavfi as that user, or as root"
        ) from None
    if other_container:
        raise BadInputError(f"process {pid}: is in another container; allowed: run mavfi inside it")
    if "librcl.so" not in _maps(pid):
        raise BadInputError(
            f"process {pid}: has not loaded librcl.so; allowed: processes with ROS 2 nodes, not linked statically"
        )


def _maps(pid: int) -> str:
    """The memory map of a process; "" if it has ended."""
    try:
        return Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return ""
