"""Subset of ptrace(2) on x86-64 Linux needed by the injector.

All calls for a target must come from the thread that seized it.  `PTRACE_SEIZE` is used throughout: it sends the target
no signal, and if the tracer dies the target continues, unless it is being single-stepped or has a breakpoint.
"""

import ctypes
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from mavfi.errors import MavfiError

# Requests of ptrace(2), from <sys/ptrace.h>.
_CONT = 7
_SINGLESTEP = 9
_GETREGS = 12
_SETREGS = 13
_DETACH = 17
_SYSCALL = 24
_PEEKUSER = 3
_POKEUSER = 6
_SETOPTIONS = 0x4200
_GETSIGINFO = 0x4202
_GETREGSET = 0x4204
_SETREGSET = 0x4205
_SEIZE = 0x4206
_INTERRUPT = 0x4207
_TRACE_SYSTEM_CALLS = 1 << 0
"""Option that tells stops at system calls from those by SIGTRAP: by this bit in the signal's number."""
_SYSTEM_CALL_BIT = 0x80
_TRACE_CLONE = 1 << 3
"""Option that traces the threads that a thread creates."""
_EVENT_STOP = 128
"""Event of a stop by `_INTERRUPT`, or with the whole process."""
WAIT_ALL = 0x40000000
"""__WALL: without it, waitpid does not report threads created by clone."""
_XSTATE_NOTE = 0x202
"""NT_X86_XSTATE: the note of the XSAVE area, from <elf.h>."""
_XSTATE_SIZE = 16384
"""Room for an XSAVE area of any processor (bytes)."""

# The standard XSAVE area (Intel SDM, vol. 1, 13.4).
_XSTATE_HEADER = 512
"""Offset of the bits that say which components are stored."""
_YMM_HIGH = 576
"""Offset of the upper halves of the YMM registers."""
_XMM_COMPONENT = 1 << 1
"""Bit of the XMM registers in the header."""
_YMM_COMPONENT = 1 << 2
"""Bit of the upper halves of the YMM registers in the header."""
_XMM = 160
"""Offset of the XMM registers."""
_DEBUG_REGISTERS = 848
"""offsetof(struct user, u_debugreg)."""
_SPINS = 200
"""Number of looks at a thread before waiting for a signal."""
_HALT_LIMIT_S = 2.0
"""Longest wait for a thread that is to be released."""
_NAP_S = 1e-3
"""Longest wait for a signal between two looks at a thread."""
_NEWS = (signal.SIGCHLD,)
"""Signals that announce that a thread has stopped or ended."""

GENERAL = (
    "r15",
    "r14",
    "r13",
    "r12",
    "rbp",
    "rbx",
    "r11",
    "r10",
    "r9",
    "r8",
    "rax",
    "rcx",
    "rdx",
    "rsi",
    "rdi",
    "orig_rax",
    "rip",
    "cs",
    "rflags",
    "rsp",
    "ss",
    "fs_base",
    "gs_base",
    "ds",
    "es",
    "fs",
    "gs",
)
"""`struct user_regs_struct`."""


_RIP, _ORIG_RAX = (8 * GENERAL.index(name) for name in ("rip", "orig_rax"))
"""Their offsets in `struct user`."""


class TargetGoneError(MavfiError):
    """The target ended while traced, with an exit code (negative = signal number)."""

    def __init__(self, text: str, code: int = 0) -> None:
        super().__init__(text)
        self.code = code


class TracerTimeoutError(MavfiError):
    """The target did not stop in time, or the wait was cancelled."""


class _Registers(ctypes.Structure):
    """struct user_regs_struct."""

    _fields_ = [(name, ctypes.c_uint64) for name in GENERAL]


class _Vector(ctypes.Structure):
    """struct iovec."""

    _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]


# not the library's ptrace, which distinguishes values and errors by errno only
# (system call number, request, thread, address, data)
_syscall = ctypes.CDLL(None, use_errno=True).syscall
_syscall.restype = ctypes.c_long
_syscall.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_SYS_PTRACE = 101
"""Number of the system call on x86-64."""


def await_news(seconds: float) -> None:
    """Wait at most `seconds` for the SIGCHLD of a thread that stops or ends; just sleep if it is not blocked."""
    signal.sigtimedwait(_NEWS, seconds)


def _ptrace(request: int, thread: int, address: int = 0, data: int = 0) -> None:
    """Make a request; an error is an OSError."""
    if _syscall(_SYS_PTRACE, request, thread, address, data) < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), f"ptrace {request:#x} of {thread}")


@dataclass(frozen=True, slots=True)
class Stop:
    """Why a thread stopped."""

    signal: int = 0
    """Pending signal, to be passed on to the target; 0 = none."""
    interrupted: bool = False
    """Stopped by `interrupt`, or with the whole process by SIGSTOP."""
    system_call: bool = False
    """Stopped at the beginning or the end of a system call, see `resume_to_system_call`."""


class Tracee:
    """One thread of the target.

    Methods that wait for it raise `TargetGoneError` if it ended, and `TracerTimeoutError` if it did not stop in time.

    Attributes:
        thread: Thread id.
        is_stopped: Whether it is stopped.
        has_ended: Whether it has ended.
        cancelled: Polled while waiting; True ends the wait.
    """

    def __init__(self, thread: int, *, seize: bool = True, cancelled: Callable[[], bool] = bool) -> None:
        """Seize a thread, which continues to run; with `seize` False it is already traced as a new thread.

        Raises an OSError if it must not be traced.
        """
        self.thread = thread
        self.is_stopped = False
        self.has_ended = False
        self.cancelled = cancelled
        self._info = (ctypes.c_int * 32)()  # siginfo_t
        self._info_at = ctypes.addressof(self._info)
        self._word = ctypes.c_uint64()
        self._word_at = ctypes.addressof(self._word)
        self._has_breakpoint = False
        if seize:
            _ptrace(_SEIZE, thread)

    # ---- running and stopping ---------------------------------------------------------------------------------------
    def follow_threads(self) -> None:
        """Trace all threads that this stopped thread creates from now on."""
        _ptrace(_SETOPTIONS, self.thread, 0, _TRACE_CLONE)

    def interrupt(self, timeout: float) -> None:
        """Stop the thread; signals that arrive first are delivered."""
        _ptrace(_INTERRUPT, self.thread)
        stop = self.wait(timeout)
        while not stop.interrupted:
            self.resume(stop.signal)
            stop = self.wait(timeout)

    def step(self, timeout: float) -> None:
        """Execute one instruction; if a signal arrives first, the first instruction of its handler."""
        stop = Stop()
        while True:
            _ptrace(_SINGLESTEP, self.thread, 0, stop.signal)
            self.is_stopped = False
            stop = self.wait(timeout)
            if not stop.signal:
                return

    def resume(self, number: int = 0) -> None:
        """Continue the thread, and deliver a signal."""
        _ptrace(_CONT, self.thread, 0, number)
        self.is_stopped = False

    def trace_system_calls(self) -> None:
        """Make stops at system calls recognizable; the thread must be stopped."""
        _ptrace(_SETOPTIONS, self.thread, 0, _TRACE_SYSTEM_CALLS)

    def resume_to_system_call(self, number: int = 0) -> None:
        """Continue the thread to the beginning or end of its next system call, and deliver a signal."""
        _ptrace(_SYSCALL, self.thread, 0, number)
        self.is_stopped = False

    def wait(self, timeout: float) -> Stop:
        """Wait until the thread stops."""
        deadline = time.monotonic() + timeout
        spins = 0
        while True:
            thread, status = os.waitpid(self.thread, WAIT_ALL | os.WNOHANG)
            if thread:
                return self.note(status)
            spins += 1
            if spins < _SPINS:  # a step takes microseconds, less than a sleep and wake-up
                continue
            if time.monotonic() > deadline or self.cancelled():
                raise TracerTimeoutError(f"thread {self.thread}: did not stop within {timeout:g} s")
            await_news(_NAP_S)

    def note(self, status: int) -> Stop:
        """Process a status of waitpid; returns why the thread stopped."""
        if not os.WIFSTOPPED(status):
            self.is_stopped = False
            self.has_ended = True
            code = os.waitstatus_to_exitcode(status)
            if code < 0:
                raise TargetGoneError(f"the target ended by signal {-code}", code)
            raise TargetGoneError(f"the target ended with {code}", code)
        self.is_stopped = True
        event = status >> 16
        number = os.WSTOPSIG(status)
        if event == _EVENT_STOP:
            return Stop(0, interrupted=True)
        if number == signal.SIGTRAP | _SYSTEM_CALL_BIT:
            return Stop(0, system_call=True)
        if event or (number == signal.SIGTRAP and self._is_trap()):
            return Stop()
        return Stop(number)

    def _is_trap(self) -> bool:
        """Whether a SIGTRAP comes from a step or breakpoint, not from kill(2)."""
        _ptrace(_GETSIGINFO, self.thread, 0, self._info_at)
        return self._info[2] > 0  # si_code

    def stop_again(self, timeout: float) -> int:
        """Move a stopped thread on to a stop from which an interrupted system call is restarted.

        Returns the signal that is pending there, to be passed to `detach`; 0 = none.
        """
        _ptrace(_INTERRUPT, self.thread)
        self.resume()
        return self.wait(timeout).signal

    def detach(self, number: int = 0) -> None:
        """Remove the breakpoint, and release the thread with its pending signal."""
        if self.has_ended:
            return
        try:
            if not self.is_stopped:
                self.cancelled = bool  # never cancelled: a breakpoint would be left behind
                _ptrace(_INTERRUPT, self.thread)
                number = self.wait(_HALT_LIMIT_S).signal
            if self._has_breakpoint:
                self.clear_breakpoint()
            _ptrace(_DETACH, self.thread, 0, number)
        except (ProcessLookupError, ChildProcessError, TargetGoneError, TracerTimeoutError):
            pass

    # ---- registers --------------------------------------------------------------------------------------------------
    def general(self) -> dict[str, int]:
        """General registers by name."""
        values = _Registers()
        _ptrace(_GETREGS, self.thread, 0, ctypes.addressof(values))
        return {name: int(getattr(values, name)) for name in GENERAL}

    def instruction_pointer(self) -> int:
        """Address of the next instruction: `general()["rip"]` in a fraction of the time."""
        return self._peek(_RIP)

    def in_system_call(self) -> bool:
        """Whether the thread was stopped inside a system call, to which its registers then belong."""
        return self._peek(_ORIG_RAX) < 1 << 63  # outside calls it is -1, unsigned

    def _peek(self, offset: int) -> int:
        """A word of the thread's `struct user`."""
        _ptrace(_PEEKUSER, self.thread, offset, self._word_at)
        return self._word.value

    def set_general(self, registers: dict[str, int]) -> None:
        """Write all general registers."""
        values = _Registers(**registers)
        _ptrace(_SETREGS, self.thread, 0, ctypes.addressof(values))

    def vector(self, index: int) -> int:
        """YMM register 0 to 15 as one integer of 256 bits; without AVX the upper half is 0."""
        area, length = self._extended()
        low = _XMM + 16 * index
        high = _YMM_HIGH + 16 * index
        upper = bytes(16)
        if length >= high + 16 and area[_XSTATE_HEADER] & _YMM_COMPONENT:
            upper = bytes(area[high : high + 16])
        return int.from_bytes(bytes(area[low : low + 16]) + upper, "little")

    def set_vector(self, index: int, value: int) -> None:
        """Write a YMM register."""
        area, length = self._extended()
        raw = value.to_bytes(32, "little")
        low = _XMM + 16 * index
        high = _YMM_HIGH + 16 * index
        area[low : low + 16] = list(raw[:16])
        area[_XSTATE_HEADER] |= _XMM_COMPONENT
        has_high = area[_XSTATE_HEADER] & _YMM_COMPONENT
        if any(raw[16:]) and not has_high:  # all upper halves are 0 and not stored
            area[_YMM_HIGH : _YMM_HIGH + 256] = [0] * 256
            area[_XSTATE_HEADER] |= _YMM_COMPONENT
            has_high = 1
        if has_high:
            area[high : high + 16] = list(raw[16:])
        note = _Vector(ctypes.addressof(area), length)
        _ptrace(_SETREGSET, self.thread, _XSTATE_NOTE, ctypes.addressof(note))

    def extended_state(self) -> bytes:
        """Vector and floating-point registers of a stopped thread, for `set_extended_state`."""
        area, length = self._extended()
        return bytes(area[:length])

    def set_extended_state(self, state: bytes) -> None:
        """Restore what `extended_state` returned."""
        area = (ctypes.c_uint8 * len(state)).from_buffer_copy(state)
        note = _Vector(ctypes.addressof(area), len(state))
        _ptrace(_SETREGSET, self.thread, _XSTATE_NOTE, ctypes.addressof(note))

    def _extended(self) -> tuple["ctypes.Array[ctypes.c_uint8]", int]:
        """The XSAVE area of the thread, and its length (bytes)."""
        area = (ctypes.c_uint8 * _XSTATE_SIZE)()
        note = _Vector(ctypes.addressof(area), _XSTATE_SIZE)
        _ptrace(_GETREGSET, self.thread, _XSTATE_NOTE, ctypes.addressof(note))
        return area, note.length

    # ---- breakpoint -------------------------------------------------------------------------------------------------
    def set_breakpoint(self, address: int) -> None:
        """Stop this thread, currently stopped, before it executes the instruction at an address.

        Uses a debug register of the processor: the target's code is not modified, so untraced threads and children of
        the target never hit the breakpoint.
        """
        self._has_breakpoint = True
        _ptrace(_POKEUSER, self.thread, _DEBUG_REGISTERS, address)
        _ptrace(_POKEUSER, self.thread, _DEBUG_REGISTERS + 8 * 7, 1)

    def clear_breakpoint(self) -> None:
        """Remove the breakpoint; the thread must be stopped."""
        self._has_breakpoint = False
        _ptrace(_POKEUSER, self.thread, _DEBUG_REGISTERS + 8 * 7, 0)
        _ptrace(_POKEUSER, self.thread, _DEBUG_REGISTERS, 0)
