"""System calls of a process and of all that it forks, each allowed, or answered with an error, by a supervisor.

A seccomp filter hands the calls named in `CALLS` to whoever holds its listener (seccomp_unotify(2)); no privilege is
needed on x86-64 Linux.  The supervisor is another process, so that nothing of it runs in those that it watches.
"""

import ctypes
import errno
import fcntl
import os
import platform
import select
import signal
import struct
import sys
import time
from pathlib import Path

CALLS = {
    "read": 0,
    "write": 1,
    "mmap": 9,
    "brk": 12,
    "pread64": 17,
    "pwrite64": 18,
    "mremap": 25,
    "socketpair": 53,
    "clone": 56,
    "fsync": 74,
    "fdatasync": 75,
    "ftruncate": 77,
    "rename": 82,
    "mkdir": 83,
    "unlink": 87,
    "openat": 257,
    "fallocate": 285,
    "pipe2": 293,
    "pidfd_open": 434,
    "clone3": 435,
}
NAMES = {number: name for name, number in CALLS.items()}
_SYS_SECCOMP, _SYS_PIDFD_GETFD = 317, 438
_SET_FILTER, _NEW_LISTENER = 1, 1 << 3
_NO_NEW_PRIVILEGES, _DIE_WITH_PARENT = 38, 1
_NOTIFY, _ALLOW = 0x7FC00000, 0x7FFF0000
_LOAD, _EQUAL, _RETURN = 0x20, 0x15, 0x06
_RECEIVE, _SEND = 0xC0502100, 0xC0182101
_CONTINUE = 1
_X86_64 = 0xC000003E
_NOTICE = struct.Struct("QIIiIQ6Q")  # id, pid, flags; number, architecture, instruction pointer, arguments
_ANSWER = struct.Struct("QqiI")  # id, value, error, flags
_libc = ctypes.CDLL(None, use_errno=True)


class _Program(ctypes.Structure):
    """struct sock_fprog."""

    _fields_ = (("length", ctypes.c_ushort), ("code", ctypes.c_void_p))


def why_not():
    """Why system calls cannot be supervised here; "" = they can."""
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        return "system calls are supervised on x86-64 Linux"
    try:
        supervised = Supervised(lambda: 0)
        supervised.serve(lambda call: 0)
        return ""
    except OSError as error:
        return f"the kernel does not let a process supervise another one: {error}"


def _install():
    """Hand the calls over from now on; the listener is the lowest number that is free."""
    numbers = list(CALLS.values())
    code = struct.pack("HBBI", _LOAD, 0, 0, 4) + struct.pack("HBBI", _EQUAL, 0, len(numbers) + 1, _X86_64)
    code += struct.pack("HBBI", _LOAD, 0, 0, 0)
    for index, number in enumerate(numbers):
        code += struct.pack("HBBI", _EQUAL, len(numbers) - index, 0, number)
    code += struct.pack("HBBI", _RETURN, 0, 0, _ALLOW) + struct.pack("HBBI", _RETURN, 0, 0, _NOTIFY)
    memory = ctypes.create_string_buffer(code, len(code))
    program = _Program(len(code) // 8, ctypes.addressof(memory))
    _libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    if _libc.syscall(_SYS_SECCOMP, _SET_FILTER, _NEW_LISTENER, ctypes.byref(program)) < 0:
        os._exit(ctypes.get_errno())


def heap_end(pid):
    """Where a process's heap ends; 0 = it has none, or is gone."""
    try:
        lines = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0
    ends = (int(line.split()[0].partition("-")[2], 16) for line in lines if line.endswith("[heap]"))
    return next(ends, 0)


class Call:
    """A call that waits for its answer: process, depth below the first one (0 = itself), name, arguments."""

    def __init__(self, pid, depth, name, arguments):
        self.pid, self.depth, self.name, self.arguments = pid, depth, name, arguments

    def target(self, index=0):
        """Path, or kind, of what the file number in an argument stands for."""
        try:
            return os.readlink(f"/proc/{self.pid}/fd/{self.arguments[index] & 0x7FFFFFFF}")
        except OSError:
            return ""


class Supervised:
    """A forked child that does some work, a function whose value is the exit code, in a session of its own.

    Raises an OSError if the kernel does not allow a filter, or its listener to be taken over.
    """

    def __init__(self, work):
        numbers, report = os.pipe()
        started, start = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            try:
                _libc.prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
                os.setsid()
                os.close(start)
                free = os.dup(0)
                os.write(report, bytes([free]))
                os.close(free)
                _install()
                select.select([started], [], [])  # is not handed over
                for handle in (numbers, report, started):
                    os.close(handle)
                os._exit(work())
            finally:
                os._exit(99)
        self._depths = {self.pid: 0}
        self._handle = os.pidfd_open(self.pid)
        try:
            self._listener = self._take(os.read(numbers, 1)[0])
        finally:
            for handle in (numbers, report, started, start):
                os.close(handle)

    def _take(self, number):
        """The listener, as soon as the child has it."""
        while True:
            descriptor = _libc.syscall(_SYS_PIDFD_GETFD, self._handle, number, 0)
            if descriptor >= 0 and "seccomp" in os.readlink(f"/proc/self/fd/{descriptor}"):
                return descriptor
            if descriptor >= 0:
                os.close(descriptor)
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                code = os.waitstatus_to_exitcode(status)
                os.close(self._handle)
                raise OSError(code, os.strerror(code), "seccomp")
            time.sleep(1e-4)

    def _depth(self, pid):
        if pid not in self._depths:
            try:
                lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
            except OSError:
                return -1
            status = dict(line.split(":", 1) for line in lines if ":" in line)
            group, parent = int(status["Tgid"]), int(status["PPid"])
            self._depths[pid] = self._depth(group) if group != pid else 1 + self._depth(parent)
        return self._depths[pid]

    def serve(self, decide, longest=120.0, patience=5.0):
        """Answer every call with the error that `decide(call)` gives (0 = allow it) until all processes have ended.

        Returns:
            Exit code of the child (None = it did not end within `longest` (s)), and whether a process outlived it by
            more than `patience` (s); those are killed.
        """
        deadline, code, ended = time.monotonic() + longest, None, False
        poll = select.poll()
        poll.register(self._listener, select.POLLIN)
        poll.register(self._handle, select.POLLIN)
        try:
            while time.monotonic() < deadline:
                ready = dict(poll.poll(100))
                if not ended and ready.get(self._handle):
                    ended, deadline = True, time.monotonic() + patience
                    poll.unregister(self._handle)
                    code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
                happened = ready.get(self._listener, 0)
                if happened & select.POLLIN:
                    self._answer(decide)
                elif happened & select.POLLHUP:  # nobody is left
                    if ended:
                        return code, False
                    time.sleep(1e-3)
            return code, True
        finally:
            self._close(ended)

    def _answer(self, decide):
        notice = bytearray(_NOTICE.size)
        try:
            fcntl.ioctl(self._listener, _RECEIVE, notice)
        except OSError as error:
            if error.errno in (errno.ENOENT, errno.EINTR):  # it was killed meanwhile
                return
            raise
        number, pid, _, call, _, _, *arguments = _NOTICE.unpack(notice)
        wrong = decide(Call(pid, self._depth(pid), NAMES[call], arguments))
        if wrong and CALLS["brk"] == call:  # it tells no error, but where the heap ends still
            answer = bytearray(_ANSWER.pack(number, heap_end(pid), 0, 0))
        else:
            answer = bytearray(_ANSWER.pack(number, 0, -wrong, 0 if wrong else _CONTINUE))
        try:
            fcntl.ioctl(self._listener, _SEND, answer)
        except OSError as error:
            if error.errno != errno.ENOENT:
                raise

    def _close(self, ended):
        for pid in self._depths:  # closing the listener alone would leave the child waiting: it has a copy
            try:
                if os.getpgid(pid) == self.pid:
                    os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        if not ended:
            os.waitpid(self.pid, 0)
        os.close(self._listener)
        os.close(self._handle)
