"""Checks whether a process may be injected, and chooses its thread."""

import os
import platform
import sys
from pathlib import Path

from mavfi.errors import BadInputError

_CLOCK_FIELDS = slice(11, 13)  # utime and stime, counted from the state, in /proc/PID/stat
_INIT = 1
"""Number of the first process, which must not be traced."""
_ELF_64 = b"\x7fELF\x02"
"""Beginning of a 64-bit program."""


def check_machine() -> None:
    """Raise a BadInputError unless this is x86-64 Linux."""
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        raise BadInputError(f"registers are injected on x86-64 Linux; this is {sys.platform} on {platform.machine()}")


def check_target(pid: int, tool: int) -> None:
    """Raise a BadInputError, with the reason, for a process that must not be injected, such as `tool` itself."""
    check_machine()
    if pid in (os.getpid(), tool):
        raise BadInputError(f"pid {pid}: is mavfi itself")
    if pid == _INIT:
        raise BadInputError(f"pid {pid}: is init, whose end would stop the machine")
    status = _status(pid)
    owner = int(status["Uid"].split()[1])
    if owner != os.geteuid():
        raise BadInputError(f"pid {pid}: belongs to user {owner}, not to user {os.geteuid()} who runs mavfi")
    state = status["State"].split()[0]
    if state in "ZX":
        raise BadInputError(f"pid {pid}: has ended (state {state})")
    if status["TracerPid"].strip() != "0":
        raise BadInputError(f"pid {pid}: is traced already, by process {status['TracerPid'].strip()}")
    if state in "Tt":
        raise BadInputError(f"pid {pid}: is stopped; continue it first (kill -CONT {pid})")
    _check_program(pid)


def _status(pid: int) -> dict[str, str]:
    """The lines of /proc/PID/status by key; refuses a thread, and a process that does not exist."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        raise BadInputError(f"pid {pid}: there is no such process") from None
    status = dict(line.split(":", 1) for line in lines if ":" in line)
    if int(status["Tgid"]) != pid:
        raise BadInputError(f"pid {pid}: is a thread of process {status['Tgid'].strip()}; name the process")
    return status


def _check_program(pid: int) -> None:
    """Refuse what is not a 64-bit program of the user."""
    try:
        with open(f"/proc/{pid}/exe", "rb") as program:
            head = program.read(5)
    except FileNotFoundError:
        raise BadInputError(f"pid {pid}: belongs to the kernel") from None
    except PermissionError:
        raise BadInputError(f"pid {pid}: may not be looked into ({not_permitted()})") from None
    if head != _ELF_64:
        raise BadInputError(f"pid {pid}: is not a 64-bit program")


def not_permitted() -> str:
    """Likely reason why the kernel refuses ptrace, and the remedy."""
    yama = Path("/proc/sys/kernel/yama/ptrace_scope")
    if yama.is_file() and yama.read_text().strip() != "0":
        return f"{yama} is {yama.read_text().strip()}: only children may be traced; 0 allows all of one's own processes"
    return "the process forbids it, or this container lacks the capability SYS_PTRACE"


def threads_of(pid: int) -> list[int]:
    """Ids of all threads; a BadInputError if the process has ended."""
    try:
        return sorted(int(name) for name in os.listdir(f"/proc/{pid}/task"))
    except OSError:
        raise BadInputError(f"pid {pid}: has ended") from None


def busiest_thread(pid: int) -> int:
    """A running thread with the most CPU time, or a BadInputError if the process has ended."""
    return max(threads_of(pid), key=lambda thread: _busyness(pid, thread))


def _busyness(pid: int, thread: int) -> tuple[bool, int]:
    """Whether a thread is running, and its CPU time (clock ticks)."""
    try:
        text = Path(f"/proc/{pid}/task/{thread}/stat").read_text()
    except OSError:  # it has just ended
        return False, -1
    fields = text.rsplit(")", 1)[1].split()
    return fields[0] == "R", sum(map(int, fields[_CLOCK_FIELDS]))
