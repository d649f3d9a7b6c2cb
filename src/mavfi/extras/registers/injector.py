"""One injection: stop the target, find an instruction, flip a bit, release the target.

Killing the tracer while it single-steps the target kills the target as well: the kernel leaves single-stepping on (in
`__ptrace_unlink`), and nobody handles the SIGTRAP.  Without steps (`RegisterFault.steps`), the default where no
breakpoint is set, the target survives.

The stop determines the location of the flip.  A stop from outside occurs at few instructions, always the same (skid);
with `RegisterFault.walk` a random number of instructions is single-stepped before the injection.  This spreads
injections over the code near the stop, not over the program: for rates per instruction use the level `instruction`.
"""

import errno
import os
import random
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from typing import Any

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.addresses import AddressSpace
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.registers.ptrace import WAIT_ALL, TargetGoneError, Tracee, TracerTimeoutError, await_news
from mavfi.extras.registers.registers import MachineInstruction, Register, decode, enters_kernel, flip, value_of
from mavfi.extras.registers.target import busiest_thread, check_target, not_permitted, threads_of
from mavfi.record import Injection

_REACH = 40
"""Instructions after the walk within which the first eligible one is injected."""
_PAUSES_S = (2e-4, 5e-3)
"""Shortest and longest time between two attempts."""
_STEP_LIMIT_S = 2.0
"""Longest wait for a thread to stop."""
_NAP_S = 1e-3
"""Time between two looks whether the search is over."""
_MOST_IN_CALLS = 20
"""Stops inside of system calls after which the end of a call is waited for: the target is idle nearly all the time."""
_CALL_LIMIT_S = 1.0
"""Longest wait for the end of a system call; after it, the busiest thread may be another one."""
_AT_ENTRY = 2**64 - errno.ENOSYS
"""Value of rax when a system call begins; at its end it is the result."""
_MAX_INSTRUCTION_BYTES = 15  # Intel SDM, vol. 2, 2.3.11
_VERBS = {"read": "reads", "write": "writes", "either": "reads or writes"}
"""What an instruction does with a register, for messages, by `RegisterFault.access`."""
_NOUNS = {"general": "a general register", "fp": "an fp register", "all": "a register"}
"""Kind of register, for messages, by `RegisterFault.registers`."""


@dataclass(frozen=True, slots=True)
class _Search:
    """Shared context of all attempts at one injection."""

    pid: int
    fault: RegisterFault
    choices: random.Random
    deadline: float
    cancelled: Callable[[], bool]

    def is_over(self) -> bool:
        """Whether the time is up, or nobody waits for the injection."""
        return time.monotonic() > self.deadline or self.cancelled()


@dataclass(frozen=True, slots=True)
class RegisterFlip:
    """An injection, before its address is resolved to a location."""

    address: int
    instruction: MachineInstruction
    access: str
    register: Register
    bit: int
    before: int
    after: int


@dataclass(slots=True)
class _Attempt:
    """The stopped target.

    Attributes:
        tracee: The thread.
        memory: File of its memory.
        since: Start of the stop (s).
        is_after_call: Whether the stop is at the end of a system call: the registers are those of the thread again.
        walked: Number of instructions that have been single-stepped.
        flip: The injection; None = there is none yet.
        stop_s: Duration of the stop (s), after it.
    """

    tracee: Tracee
    memory: int
    since: float
    is_after_call: bool = False
    walked: int = 0
    flip: RegisterFlip | None = None
    stop_s: float = 0.0

    def walk(self, count: int) -> bool:
        """Single-step instructions; False before one that would enter the kernel, which may block."""
        for _ in range(count):
            code = os.pread(self.memory, _MAX_INSTRUCTION_BYTES, self.tracee.instruction_pointer())
            if enters_kernel(code):
                return False
            self.tracee.step(_STEP_LIMIT_S)
            self.walked += 1
        return True


def inject_once(pid: int, fault: RegisterFault, number: int, tool: int, cancelled: Callable[[], bool]) -> Injection:
    """Flip one bit of a process; returns the injection, with time 0.

    Each injection has a number that seeds its own random choices; `tool` is the calling process, which is never a
    target; `cancelled` is polled while waiting, and True ends the wait.

    Raises:
        BadInputError: The target is rejected.
        MavfiError: The target ended, or did not reach an eligible instruction in time.
    """
    check_target(pid, tool)
    search = _Search(pid, fault, random.Random(f"{fault.seed}/{number}"), time.monotonic() + fault.timeout, cancelled)
    attempts = 0
    decode(b"\x90", 0)  # builds the decoder while the target still runs
    try:
        while True:
            attempts += 1
            with closing(AddressSpace(pid)) as space:
                with _stopped(search, space, is_idle=attempts > _MOST_IN_CALLS) as attempt:
                    attempt.flip = _try(search, attempt)
                    if attempt.flip is not None:
                        space.read()  # as it was at the injection
                # The target runs again: names are looked up now.
                if attempt.flip is not None:
                    return _record(search, attempt, attempt.flip, attempts, space)
            if search.is_over():
                raise TracerTimeoutError(_no_instruction(search, attempts))
            time.sleep(search.choices.uniform(*_PAUSES_S))
    except TargetGoneError as error:
        raise MavfiError(f"pid {pid}: {error} before the injection") from None
    except PermissionError:
        raise BadInputError(f"pid {pid}: may not be traced ({not_permitted()})") from None
    except (ProcessLookupError, ChildProcessError, FileNotFoundError):
        raise MavfiError(f"pid {pid}: ended before the injection") from None


def _no_instruction(search: _Search, attempts: int) -> str:
    """Text of the error that no eligible instruction was reached in some stops."""
    fault = search.fault
    remedy = ""
    if not fault.steps:
        remedy = "; --walk looks further"
    return (
        f"pid {search.pid}: found no instruction that {_VERBS[fault.access]} {_NOUNS[fault.registers]} "
        f"({attempts} stops in {fault.timeout:g} s, system calls excluded{remedy})"
    )


def _try(search: _Search, attempt: _Attempt) -> RegisterFlip | None:
    """Walk, and flip a bit at the first eligible instruction; None if there is none."""
    fault = search.fault
    choices = search.choices
    tracee = attempt.tracee
    if not tracee.is_stopped or (tracee.in_system_call() and not attempt.is_after_call):
        return None
    if not attempt.walk(choices.randrange(fault.walk)):
        return None
    return flip_here(fault, choices, attempt.tracee, attempt.memory, attempt.walk)


def flip_here(
    fault: RegisterFault, choices: random.Random, tracee: Tracee, memory: int, walk: Callable[[int], bool]
) -> RegisterFlip | None:
    """Flip a bit at the first eligible instruction, beginning with the next one of a stopped thread.

    Args:
        fault: The fault.
        choices: Draws access, register and bit.
        tracee: The thread.
        memory: File of its memory.
        walk: Executes a number of instructions; False = the thread cannot continue.

    Returns:
        The injection; None if no instruction within reach is eligible.
    """
    access = fault.access
    if access == "either":
        access = choices.choice(("read", "write"))
    reach = 1
    if fault.steps:
        reach = _REACH
    for tried in range(1, reach + 1):
        address = tracee.instruction_pointer()
        instruction = decode(os.pread(memory, _MAX_INSTRUCTION_BYTES, address), address)
        if instruction is None:
            return None
        registers = _qualifying(instruction, access, fault.registers)
        # what a system call writes is there after a step that may block
        if registers and not (instruction.enters_kernel and access == "write"):
            register = choices.choice(registers)
            bit = choices.choice(register.bits)
            if access == "write":
                tracee.step(_STEP_LIMIT_S)
            before = value_of(tracee, register)
            if not fault.null:
                flip(tracee, register, bit)
            return RegisterFlip(address, instruction, access, register, bit, before, value_of(tracee, register))
        if tried == reach or not walk(1):
            return None
    return None


def _qualifying(instruction: MachineInstruction, access: str, kind: str) -> list[Register]:
    """The registers of a kind, as in `RegisterFault.registers`, that an instruction reads or writes."""
    registers = instruction.writes
    if access == "read":
        registers = instruction.reads
    if kind == "all":
        return list(registers)
    return [register for register in registers if register.is_vector == (kind == "fp")]


def _record(search: _Search, attempt: _Attempt, flipped: RegisterFlip, attempts: int, space: AddressSpace) -> Injection:
    """The injection record."""
    details = {
        "pid": search.pid,
        "thread": attempt.tracee.thread,
        "attempts": attempts,
        "walked": attempt.walked,
        "stopped_us": round(1e6 * attempt.stop_s),
    }
    return injection_of(flipped, space, search.fault, details)


def injection_of(
    flipped: RegisterFlip, space: AddressSpace, fault: RegisterFault, details: Mapping[str, Any]
) -> Injection:
    """The record of an injection, with time 0; values and addresses are hexadecimal text, for up to 256 bits."""
    location = space.location_of(flipped.address)
    planned = flipped.before
    if not fault.null:
        planned ^= 1 << flipped.bit
    return Injection(
        fault.level,
        flipped.register.name,
        0.0,
        flipped.bit,
        f"{flipped.before:#x}",
        f"{flipped.after:#x}",
        activated=flipped.after == planned,
        details={
            "address": f"{flipped.address:#x}",
            "library": location.library,
            "offset": f"{location.offset:#x}",
            "symbol": location.symbol,
            "instruction": flipped.instruction.text,
            "access": flipped.access,
            "register": flipped.register.name,
            "width": flipped.register.width,
            **details,
        },
    )


@contextmanager
def _stopped(search: _Search, space: AddressSpace, *, is_idle: bool) -> Iterator[_Attempt]:
    """Stop the thread to be injected, an idle one at the end of a system call; it is released in any case."""
    pid = search.pid
    fault = search.fault
    with ExitStack() as cleanup:
        memory = os.open(f"/proc/{pid}/mem", os.O_RDONLY)
        cleanup.callback(os.close, memory)
        if fault.symbol:
            tracee, since = _stop_at(search, space, cleanup)
        else:
            tracee = Tracee(busiest_thread(pid), cancelled=search.cancelled)
            cleanup.callback(tracee.detach)
            time.sleep(search.choices.uniform(*_PAUSES_S))
            since = time.perf_counter()
            tracee.interrupt(_STEP_LIMIT_S)
        attempt = _Attempt(tracee, memory, since)
        if is_idle and tracee.in_system_call():
            attempt.is_after_call = _finish_call(tracee)
            attempt.since = time.perf_counter()  # in the call it was not held up
        yield attempt
        tracee.detach()
        attempt.stop_s = time.perf_counter() - attempt.since


def _finish_call(tracee: Tracee) -> bool:
    """Let a thread that was stopped in a system call finish it, and stop it there; False = it takes too long."""
    tracee.trace_system_calls()
    number = 0
    try:
        while True:
            tracee.resume_to_system_call(number)
            stop = tracee.wait(_CALL_LIMIT_S)
            # The interrupted call begins once more, and then ends.
            if stop.system_call and tracee.general()["rax"] != _AT_ENTRY:
                return True
            number = stop.signal
    except TracerTimeoutError:
        return False


def _stop_at(search: _Search, space: AddressSpace, cleanup: ExitStack) -> tuple[Tracee, float]:
    """Stop the first thread that calls the function; returns it and the time (s).  All others are released."""
    pid = search.pid
    fault = search.fault
    address = space.find(fault.symbol)
    tracees: dict[int, Tracee] = {}

    def release_all() -> None:
        for tracee in tracees.values():
            tracee.detach()

    cleanup.callback(release_all)
    # Set a breakpoint in each thread; they continue.
    for thread in threads_of(pid):
        try:
            tracees[thread] = Tracee(thread, cancelled=search.cancelled)
            tracees[thread].interrupt(_STEP_LIMIT_S)
            tracees[thread].follow_threads()
            tracees[thread].set_breakpoint(address)
            tracees[thread].resume()
        except (ProcessLookupError, PermissionError, TargetGoneError):  # no permission: it is ending
            if thread == pid:
                raise
            tracees.pop(thread, None)  # a thread that has ended since it was listed
    arrived = _first_at(address, tracees, search)
    since = time.perf_counter()
    arrived.clear_breakpoint()
    # Release the others first: they are not to wait for the injection.
    del tracees[arrived.thread]
    cleanup.callback(arrived.detach)
    release_all()
    tracees.clear()
    return arrived, since


def _first_at(address: int, tracees: dict[int, Tracee], search: _Search) -> Tracee:
    """Wait for the first thread to reach an address; includes newly created threads."""
    while tracees:
        thread, status = os.waitpid(-1, WAIT_ALL | os.WNOHANG)
        if not thread:
            if search.is_over():
                fault = search.fault
                raise TracerTimeoutError(f"pid {search.pid}: did not call {fault.symbol!r} within {fault.timeout:g} s")
            await_news(_NAP_S)
            continue
        is_new = thread not in tracees
        if is_new:  # created by a traced thread
            tracees[thread] = Tracee(thread, seize=False, cancelled=search.cancelled)
        tracee = tracees[thread]
        try:
            stop = tracee.note(status)
        except TargetGoneError:
            del tracees[thread]
            continue
        if is_new:
            tracee.set_breakpoint(address)
        elif not stop.signal and not stop.interrupted and tracee.instruction_pointer() == address:
            return tracee
        tracee.resume(stop.signal)
    raise TargetGoneError("the target ended")
