"""Linux process control for a flight: parent-death signal, adoption of orphans, private network, process name."""

import ctypes
import os
import signal
from collections.abc import Mapping
from pathlib import Path

_PDEATHSIG, _DUMPABLE, _NAME, _SUBREAPER = 1, 4, 15, 36  # PR_SET_... of <linux/prctl.h>
_NEW_USER, _NEW_NETWORK = 0x10000000, 0x40000000  # CLONE_NEW... of <linux/sched.h>
_ARGUMENTS = slice(45, 47)  # arg_start, arg_end: fields 48 and 49 of proc_pid_stat(5), from field 3 on
_SIGNALS = (signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def end_with_parent(number: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel send a signal to this process when its parent thread exits."""
    _libc().prctl(_PDEATHSIG, number)


def adopt_orphans() -> None:
    """Become the parent of orphaned descendants (subreaper)."""
    _libc().prctl(_SUBREAPER, 1)


def usual_signals() -> None:
    """Restore the signal handlers of a new interpreter."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_DFL if number != signal.SIGPIPE else signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.default_int_handler)


def write_to(path: Path) -> None:
    """Redirect standard output and error to a truncated file, and standard input to /dev/null."""
    log, nothing = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), os.open(os.devnull, os.O_RDONLY)
    for here, there in ((nothing, 0), (log, 1), (log, 2)):
        os.dup2(here, there)
    os.close(log)
    os.close(nothing)


def set_environment(variables: Mapping[str, str]) -> None:
    """Replace all environment variables."""
    os.environ.clear()
    os.environ.update(variables)


def isolate(command: list[str]) -> None:
    """Apply a command of `private_network` to this process: enter new network and, if requested, user namespaces.

    Raises:
        OSError: Not permitted.
    """
    if not command:
        return
    own_users = "-Urn" in command
    user, group = os.getuid(), os.getgid()
    if _libc().unshare(_NEW_NETWORK | _NEW_USER * own_users):
        raise OSError(ctypes.get_errno(), "unshare")
    if own_users:
        _libc().prctl(_DUMPABLE, 1)  # lets processes of the same user join, as after exec
        for name, text in (("setgroups", "deny"), ("uid_map", f"0 {user} 1"), ("gid_map", f"0 {group} 1")):
            Path("/proc/self", name).write_text(text, encoding="ascii")


def show_as(name: str, arguments: list[str]) -> None:
    """Change name and command line in /proc; truncated to the length of the original command line."""
    _libc().prctl(_NAME, name.encode()[:15])
    start, end = (int(text) for text in Path("/proc/self/stat").read_text().rpartition(")")[2].split()[_ARGUMENTS])
    text = b"".join(argument.encode() + b"\0" for argument in arguments)[: end - start - 1]
    ctypes.memmove(start, text.ljust(end - start, b"\0"), end - start)
