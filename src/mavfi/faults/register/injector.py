"""One strike: stop the target, find an instruction, flip a bit, let go.

Where the target is stopped decides what is struck.  A stop from outside comes at few instructions, always the same
(skid): so a random number of instructions is executed one by one before the strike.  This spreads the strikes over the
code near the stop, not over the program: for rates by instruction use the level `instruction`.
"""

import os
import random
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from mavfi.errors import BadInputError, MavfiError
from mavfi.faults.register.addresses import AddressSpace
from mavfi.faults.register.ptrace import WAIT_ALL, TargetGoneError, Tracee, TracerTimeoutError, await_news
from mavfi.faults.register.registers import Instruction, Register, decode, enters_kernel, flip, value_of
from mavfi.faults.register.request import RegisterInjection, Request
from mavfi.faults.register.target import check_target, choose_thread, not_permitted, threads_of

_REACH = 40
"""Instructions after the walk among which the first one that qualifies is struck."""
_PAUSES = (2e-4, 5e-3)
"""Shortest and longest time between two attempts (s)."""
_STEP_LIMIT = 2.0
_NAP = 1e-3
_LONGEST_INSTRUCTION = 15
_SIGN = 1 << 63


@dataclass(slots=True)
class _Attempt:
    """The target as it stands.

    Attributes:
        tracee: The thread.
        memory: File of the target's memory.
        since: When it was seen to stand still (s).
        walked: Instructions executed one by one.
        done: What was struck.
        stopped: How long it stood still, once it has been let go (s).
    """

    tracee: Tracee
    memory: int
    since: float
    walked: int = 0
    done: "_Done | None" = None
    stopped: float = 0.0

    def in_system_call(self) -> bool:
        """Whether the thread was stopped on its way through the kernel: its registers then belong to the call."""
        return self.tracee.system_call() < _SIGN

    def here(self) -> tuple[int, Instruction | None]:
        """Address of the next instruction, and the instruction."""
        address = self.tracee.instruction_pointer()
        return address, decode(os.pread(self.memory, _LONGEST_INSTRUCTION, address), address)

    def walk(self, count: int) -> bool:
        """Execute instructions one by one; False where one would enter the kernel, which may block."""
        for _ in range(count):
            code = os.pread(self.memory, _LONGEST_INSTRUCTION, self.tracee.instruction_pointer())
            if enters_kernel(code):
                return False
            self.tracee.step(_STEP_LIMIT)
            self.walked += 1
        return True


@dataclass(frozen=True, slots=True)
class _Done:
    """A strike, before it is known where its address lies."""

    address: int
    instruction: Instruction
    access: str
    register: Register
    bit: int
    before: int
    after: int


def strike(request: Request, number: int, tool: int, cancelled: Callable[[], bool] = bool) -> RegisterInjection:
    """Strike once.

    Args:
        request: Where and how.
        number: Of the strike; each has random choices of its own.
        tool: Process that asked; never a target.
        cancelled: Asked while waiting; True ends the wait.

    Returns:
        What was done.

    Raises:
        BadInputError: The target is refused.
        MavfiError: The target ended, or did not come to an instruction that qualifies in time.
    """
    check_target(request.pid, tool)
    choices = random.Random(f"{request.seed}/{number}")
    deadline = time.monotonic() + request.timeout
    attempts = 0
    _warm_up()
    try:
        while True:
            attempts += 1
            with ExitStack() as after:
                space = AddressSpace(request.pid)
                after.callback(space.close)
                with _stopped(request, space, choices, deadline, cancelled) as attempt:
                    attempt.done = _try(request, choices, attempt)
                    if attempt.done is not None:
                        space.read()
                if attempt.done is not None:
                    return _record(request, attempt, attempts, space)
            if time.monotonic() > deadline or cancelled():
                raise TracerTimeoutError(
                    f"pid {request.pid}: within {request.timeout:g} s and {attempts} stops it was never at an "
                    f"instruction with registers {request.registers!r} to {request.access}, outside of system calls"
                )
            time.sleep(choices.uniform(*_PAUSES))
    except TargetGoneError as error:
        raise MavfiError(f"pid {request.pid}: {error} before it was struck") from None
    except PermissionError:
        raise BadInputError(f"pid {request.pid}: may not be traced ({not_permitted()})") from None
    except (ProcessLookupError, ChildProcessError, FileNotFoundError):
        raise MavfiError(f"pid {request.pid}: ended before it was struck") from None


def _warm_up() -> None:
    """Build the decoder while the target still runs."""
    decode(b"\x90", 0)


def _try(request: Request, choices: random.Random, attempt: _Attempt) -> _Done | None:
    """Walk, and strike the first instruction that qualifies; None if there is none."""
    if attempt.in_system_call() or not attempt.walk(choices.randrange(request.walk)):
        return None
    access = choices.choice(("read", "write")) if request.access == "either" else request.access
    for _ in range(_REACH):
        address, instruction = attempt.here()
        if instruction is None:
            return None
        registers = _qualifying(instruction, access, request.registers)
        if registers and not (instruction.enters_kernel and access == "write"):
            register = choices.choice(registers)
            bit = choices.choice(register.bits)
            return _flip(request, attempt.tracee, address, instruction, access, register, bit)
        if not attempt.walk(1):
            return None
    return None


def _qualifying(instruction: Instruction, access: str, wanted: str) -> list[Register]:
    registers = instruction.reads if access == "read" else instruction.writes
    return [register for register in registers if wanted == "all" or register.is_vector == (wanted == "fp")]


def _flip(  # noqa: PLR0913 - all that is known of the strike
    request: Request, tracee: Tracee, address: int, instruction: Instruction, access: str, register: Register, bit: int,
) -> _Done:  # fmt: skip
    if access == "write":
        tracee.step(_STEP_LIMIT)
    before = value_of(tracee, register)
    if not request.null:
        flip(tracee, register, bit)
    return _Done(address, instruction, access, register, bit, before, value_of(tracee, register))


def _record(request: Request, attempt: _Attempt, attempts: int, space: AddressSpace) -> RegisterInjection:
    """All that is known of a strike; the target runs again."""
    done = attempt.done
    assert done is not None
    place = space.place(done.address)
    return RegisterInjection(
        request.pid, attempt.tracee.thread, done.address, place.library, place.offset, place.symbol,
        done.instruction.text, done.access, done.register.name, done.register.width, done.bit, done.before, done.after,
        attempts, attempt.walked, round(1e6 * attempt.stopped),
        done.after == done.before ^ (0 if request.null else 1 << done.bit),
    )  # fmt: skip


@contextmanager
def _stopped(
    request: Request, space: AddressSpace, choices: random.Random, deadline: float, cancelled: Callable[[], bool]
) -> Iterator[_Attempt]:
    """The thread that is to be struck, standing still; it is let go in any case."""
    with ExitStack() as cleanup:
        memory = os.open(f"/proc/{request.pid}/mem", os.O_RDONLY)
        cleanup.callback(os.close, memory)
        if request.symbol:
            tracee, since = _stop_at(request, space, deadline, cancelled, cleanup)
        else:
            tracee = Tracee(choose_thread(request.pid, request.thread), cancelled=cancelled)
            cleanup.callback(tracee.detach)
            time.sleep(choices.uniform(*_PAUSES))
            since = time.perf_counter()
            tracee.interrupt(_STEP_LIMIT)
        attempt = _Attempt(tracee, memory, since)
        yield attempt
        tracee.detach()
        attempt.stopped = time.perf_counter() - since


def _stop_at(
    request: Request, space: AddressSpace, deadline: float, cancelled: Callable[[], bool], cleanup: ExitStack
) -> tuple[Tracee, float]:
    """Stop the first thread that calls the function, since when it stands; the others are let go again."""
    address = space.find(request.symbol)
    held: dict[int, Tracee] = {}

    def let_go() -> None:
        for tracee in held.values():
            _disarm(tracee)

    cleanup.callback(let_go)
    for thread in [choose_thread(request.pid, request.thread)] if request.thread else threads_of(request.pid):
        try:
            held[thread] = Tracee(thread, cancelled=cancelled)
            held[thread].interrupt(_STEP_LIMIT)
            if not request.thread:
                held[thread].follow_threads()
            held[thread].set_breakpoint(address)
            held[thread].resume()
        except (ProcessLookupError, TargetGoneError):
            if thread in (request.pid, request.thread):
                raise
            held.pop(thread, None)  # a thread that came to its end since it was listed
    arrived = _first_at(address, held, request, deadline, cancelled)
    since = time.perf_counter()
    arrived.clear_breakpoint()
    del held[arrived.thread]
    cleanup.callback(arrived.detach)
    let_go()
    held.clear()
    return arrived, since


def _first_at(
    address: int, held: dict[int, Tracee], request: Request, deadline: float, cancelled: Callable[[], bool]
) -> Tracee:
    """Wait for the first thread that stands at an address; threads that come up meanwhile are watched as well."""
    while held:
        thread, status = os.waitpid(-1, WAIT_ALL | os.WNOHANG)
        if not thread:
            if time.monotonic() > deadline or cancelled():
                raise TracerTimeoutError(
                    f"pid {request.pid}: did not call {request.symbol!r} within {request.timeout:g} s"
                )
            await_news(_NAP)
            continue
        new = thread not in held
        if new:  # made by one that is watched
            held[thread] = Tracee(thread, seize=False, cancelled=cancelled)
        tracee = held[thread]
        try:
            stop = tracee.note(status)
        except TargetGoneError:
            del held[thread]
            continue
        if new:
            tracee.set_breakpoint(address)
        elif not stop.signal and not stop.interrupted and tracee.instruction_pointer() == address:
            return tracee
        tracee.resume(stop.signal)
    raise TargetGoneError("the target ended")


def _disarm(tracee: Tracee) -> None:
    """Take the breakpoint back, and let go."""
    try:
        number = 0
        if not tracee.stopped and not tracee.ended:
            number = tracee.halt(_STEP_LIMIT)
        if not tracee.ended:
            tracee.clear_breakpoint()
        tracee.detach(number)
    except (ProcessLookupError, ChildProcessError, TargetGoneError, TracerTimeoutError):
        pass
