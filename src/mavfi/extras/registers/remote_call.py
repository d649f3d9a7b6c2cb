"""Calls functions in a running process, in one of its threads, and leaves the thread as it was.

The thread is chosen and stopped where it waits in a system call and so holds no lock of the C library.  The called
function returns to `rt_sigreturn` with a frame on the stack that holds the thread's registers, as after a signal
handler: if the tracer is killed during the call, the thread nevertheless returns to its system call, which then reports
an interruption.
"""

import os
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.addresses import AddressSpace
from mavfi.extras.registers.ptrace import TargetGoneError, Tracee, TracerTimeoutError

_WAITING_CALLS = {
    7: "poll",
    23: "select",
    34: "pause",
    35: "nanosleep",
    43: "accept",
    45: "recvfrom",
    47: "recvmsg",
    61: "wait4",
    128: "rt_sigtimedwait",
    130: "rt_sigsuspend",
    202: "futex",
    230: "clock_nanosleep",
    232: "epoll_wait",
    270: "pselect6",
    271: "ppoll",
    281: "epoll_pwait",
    288: "accept4",
    299: "recvmmsg",
}
"""System calls of x86-64 in which a thread waits without a lock of malloc or of the dynamic loader."""
_FUTEX = 202
_FUTEX_COMMAND = 0x7F
_FUTEX_WAIT_BITSET = 9
"""Waits for condition variables and semaphores; locks, also those of malloc, use another command."""
_RESTARTS = (-512, -513, -514, -516)
"""ERESTARTSYS, ERESTARTNOINTR, ERESTARTNOHAND and ERESTART_RESTARTBLOCK: an interrupted call that will be restarted."""
_EINTR = -4
_SIGRETURN = 15
_RETURN_CODE = bytes.fromhex("48c7c00f0000000f05")
"""mov $15, %rax; syscall: the C library's return from a signal handler."""
_RED_ZONE = 128
_FRAME_ROOM = 1024
"""Room for the frame of a signal handler, without floating-point registers (bytes)."""
_CALL_LIMIT_S = 10.0
_RETRY_S = 0.0005
_WORD = (1 << 64) - 1
_NO_CALL = _WORD
"""`orig_rax` outside of system calls: no call is restarted."""

# struct ucontext of x86-64 (<asm/ucontext.h>, <asm/sigcontext.h>).
_CONTEXT = "r8 r9 r10 r11 r12 r13 r14 r15 rdi rsi rbp rbx rdx rax rcx rsp rip rflags".split()
_SEGMENTS_KEPT = 0x2 | 0x4  # UC_SIGCONTEXT_SS, UC_STRICT_RESTORE_SS
_INVALID_STACK = 0x7FFFFFFF
"""Flags of an alternate stack that the kernel refuses: so it keeps the present one."""


class StoppedThread:
    """A thread of a process, stopped where functions can be called; a context manager that lets it go on.

    Args:
        pid: The process.
        timeout: Longest wait for a thread that waits in a system call (s).

    Raises:
        BadInputError: The process must not be traced, or does not exist.
        MavfiError: None of its threads came to rest in time.
    """

    def __init__(self, pid: int, timeout: float = 5.0) -> None:
        self.pid = pid
        self._return_address = _find_return(pid)
        self._tracee = self._stop_thread(timeout)
        self._registers = self._tracee.general()
        self._extended = self._tracee.extended_state()
        self._tracee.trace_system_calls()
        self._stack = (self._registers["rsp"] - _RED_ZONE - _FRAME_ROOM) & ~15

    def __enter__(self) -> "StoppedThread":
        return self

    def __exit__(self, *_: object) -> None:
        number = 0
        try:
            number = self._restore()
        except (TargetGoneError, ProcessLookupError):
            pass
        finally:
            self._tracee.detach(number)

    def call(self, address: int, *arguments: int | str) -> None:
        """Call a function, once, with at most six numbers or texts; what it returns is not known.

        Raises:
            MavfiError: It did not return in time.
        """
        registers = dict(self._registers)
        texts = b""
        for name, argument in zip(("rdi", "rsi", "rdx", "rcx", "r8", "r9"), arguments, strict=False):
            value = argument
            if isinstance(argument, str):
                value = self._stack - 4096 + len(texts)
                texts += argument.encode() + b"\0"
            registers[name] = int(value)

        # Texts below the frame, the frame, and the stack of the function below both.
        frame = self._frame()
        frame_address = self._stack - 4096 - len(frame) - 8
        frame_address -= (frame_address - 8) % 16  # as a call instruction leaves it
        self._write(self._stack - 4096, texts)
        self._write(frame_address, frame)
        registers.update(rip=address, rsp=frame_address, rax=0, orig_rax=_NO_CALL)
        self._tracee.set_general(registers)
        self._run_to_return(frame_address + 8)

    # ---- stopping ---------------------------------------------------------------------------------------------------
    def _stop_thread(self, timeout: float) -> Tracee:
        """Stop a thread that waits in a system call."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            for thread in waiting_threads(self.pid):
                try:
                    tracee = Tracee(thread)
                except ProcessLookupError:  # it has ended meanwhile
                    continue
                except PermissionError:
                    raise BadInputError(
                        f"process {self.pid}: must not be traced; allowed: processes of the same user, with "
                        "/proc/sys/kernel/yama/ptrace_scope 0, or as root; and none that is already traced"
                    ) from None
                if self._is_safe(tracee):
                    return tracee
                tracee.detach()
            if not os.path.exists(f"/proc/{self.pid}"):
                raise BadInputError(f"process {self.pid}: has ended")
            time.sleep(_RETRY_S)
        raise MavfiError(f"process {self.pid}: no thread waited in a system call within {timeout:g} s")

    def _is_safe(self, tracee: Tracee) -> bool:
        """Interrupt a thread; whether it was still waiting."""
        with suppress(TargetGoneError, TracerTimeoutError):
            tracee.interrupt(_CALL_LIMIT_S)
            registers = tracee.general()
            is_waiting = registers["orig_rax"] in _WAITING_CALLS and _signed(registers["rax"]) in _RESTARTS
            if registers["orig_rax"] == _FUTEX:
                return is_waiting and registers["rsi"] & _FUTEX_COMMAND == _FUTEX_WAIT_BITSET
            return is_waiting
        return False

    # ---- the call ---------------------------------------------------------------------------------------------------
    def _run_to_return(self, stack: int) -> None:
        """Run the thread until the function has returned; `stack`: its stack pointer then."""
        tracee = self._tracee
        number = 0
        deadline = time.monotonic() + _CALL_LIMIT_S
        while True:
            tracee.resume_to_system_call(number)
            stop = tracee.wait(max(0.0, deadline - time.monotonic()))
            number = stop.signal
            if not stop.system_call:
                continue
            registers = tracee.general()
            if registers["orig_rax"] == _SIGRETURN and registers["rsp"] == stack:
                break
        # Let it return: from now on its registers are right again, whatever becomes of the tracer.
        tracee.resume_to_system_call()
        tracee.wait(_CALL_LIMIT_S)

    def _restore(self) -> int:
        """Restart the thread's system call, which otherwise reports an interruption, with all its registers.

        Returns the signal that is pending there; 0 = none.
        """
        tracee = self._tracee
        if tracee.has_ended:
            return 0
        if not tracee.is_stopped:  # leave it inside the function: its frame brings it back
            raise MavfiError(f"process {self.pid}: the called function did not return within {_CALL_LIMIT_S:g} s")
        number = tracee.stop_again(_CALL_LIMIT_S)
        tracee.set_general(self._registers)
        tracee.set_extended_state(self._extended)
        return number

    def _frame(self) -> bytes:
        """Return address and `struct ucontext` of a signal handler: the thread as it was."""
        registers = {**self._registers, "rax": _EINTR & _WORD}
        blocked = 0
        for line in Path(f"/proc/{self.pid}/task/{self._tracee.thread}/status").read_text().splitlines():
            if line.startswith("SigBlk:"):
                blocked = int(line.split()[1], 16)
        header = struct.pack("<QQQQiiQ", self._return_address, _SEGMENTS_KEPT, 0, 0, _INVALID_STACK, 0, 0)
        general = b"".join(registers[name].to_bytes(8, "little") for name in _CONTEXT)
        segments = struct.pack("<HHHH", registers["cs"], registers["gs"], registers["fs"], registers["ss"])
        # error, trap number, old mask, fault address, no floating-point state, reserved
        return header + general + segments + bytes(8 * 5) + bytes(8 * 8) + blocked.to_bytes(8, "little")

    def _write(self, address: int, data: bytes) -> None:
        with open(f"/proc/{self.pid}/mem", "r+b", buffering=0) as memory:
            memory.seek(address)
            memory.write(data)


def function_address(pid: int, name: str, file: str, nameless: str = "") -> int:
    """Address of a function in a process, by its exact name and a part of the name of its file.

    `nameless`: see `AddressSpace`.

    Raises:
        BadInputError: The process has no such function, has ended, or must not be inspected.
    """
    try:
        space = AddressSpace(pid, nameless)
    except OSError as error:
        raise BadInputError(f"process {pid}: cannot be inspected ({error.strerror})") from None
    try:
        address = space.function_in(name, file)
    finally:
        space.close()
    if address == 0:
        raise BadInputError(f"process {pid}: no function {name} in a file {file!r}")
    return address


@lru_cache(maxsize=64)
def _return_offset(path: str, identity: tuple[int, int]) -> int:
    """Offset of the return from signal handlers in a file; -1 = it has none."""
    del identity  # a replaced file is read again
    return Path(path).read_bytes().find(_RETURN_CODE)


def _find_return(pid: int) -> int:
    """Address of the C library's return from signal handlers; BadInputError if it is not glibc, or out of reach."""
    try:
        for start, end, offset, path in AddressSpace(pid).code_of("libc.so"):
            status = os.stat(path)
            code = _return_offset(path, (status.st_ino, status.st_mtime_ns))
            if offset <= code < offset + end - start:
                return start + code - offset
    except OSError as error:
        raise BadInputError(f"process {pid}: cannot be inspected ({error.strerror})") from None
    raise BadInputError(f"process {pid}: its C library is not glibc")


def waiting_threads(pid: int) -> Iterator[int]:
    """Threads of a process that wait in a system call without a lock of the C library."""
    with suppress(OSError):
        for folder in Path(f"/proc/{pid}/task").iterdir():
            with suppress(OSError, ValueError):
                fields = (folder / "syscall").read_text().split()
                call = int(fields[0])  # "running" is no number
                if call not in _WAITING_CALLS:
                    continue
                if call == _FUTEX and int(fields[2], 16) & _FUTEX_COMMAND != _FUTEX_WAIT_BITSET:
                    continue
                yield int(folder.name)


def _signed(word: int) -> int:
    if word >> 63:
        return word - (1 << 64)
    return word
