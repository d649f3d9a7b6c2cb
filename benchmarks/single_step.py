"""The machine-level reference: one call of compiled code, single-stepped, with one injection.

In contrast to an asynchronous stop, single-stepping makes every dynamic instruction equally likely, and faults
repeatable.  It costs some ten microseconds per instruction, and is therefore limited to calls of some thousands of
instructions.  The code is the plain one; functions in files (libm, Python) are stepped through, but not injected.

A call is executed in a forked child, traced by this process.  All children of one parent have the same addresses, so
that an instruction number denotes the same instruction in all of them.
"""

import contextlib
import ctypes
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.destinations import destinations, is_out_of_reach
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.ptrace import TargetGoneError, Tracee, TracerTimeoutError
from mavfi.extras.registers.registers import MachineInstruction, Register, decode, flip, value_of
from mavfi.extras.registers.target import check_machine, not_permitted
from mavfi.ir.forked import ChildEnd, judge_exit, run_in_child

_LIMIT = 10.0
"""Time limit of a wait for a stop (s)."""
_LONGEST_INSTRUCTION = 15
_WORD = 8
_WARM_UP = 3
How = Literal["masked", "sdc", "crash", "hang", "exception"]


@dataclass(frozen=True, slots=True)
class MachineFault:
    """One bit of a destination register.

    Attributes:
        step: Executed instruction of the call after which the bit is flipped, from 0.
        register: Destination register.
        bit: Bit of the register, from its first.
    """

    step: int
    register: Register
    bit: int


@dataclass(frozen=True, slots=True)
class MachineOutcome:
    """Outcome of an injected call.

    Attributes:
        how: "masked": the report equals that of the error-free call; "sdc": it differs; "crash": a signal; "hang": the
            instruction budget was exceeded; "exception".
        fault: The injected fault.
        instruction: Mnemonic and operands.
        before: Register value before the injection.
        after: Register value after the injection.
        detail: Name of the signal, or text of the exception.
    """

    how: How
    fault: MachineFault
    instruction: str
    before: int
    after: int
    detail: str = ""

    @property
    def activated(self) -> bool:
        """Whether the register held the planned value after the injection."""
        return self.after == self.before ^ (1 << self.fault.bit)


class SteppedCall:
    """One call that can be single-stepped repeatedly.

    Attributes:
        own: Number of dynamic instructions in the code itself, excluding functions in files.
    """

    def __init__(self, call: Callable[[], bytes], entry: int) -> None:
        """Execute the call once freely and once in single steps.

        Args:
            call: Calls the code, and reports its results; must be deterministic.
            entry: Address of the code's first instruction.

        Raises:
            BadInputError: Not x86-64 Linux, or tracing is not permitted.
            MavfiError: The call did not reach `entry`, or its error-free execution failed.
        """
        check_machine()
        self._call = call
        self._entry = entry
        for _ in range(_WARM_UP):  # excludes loading and binding at the first call
            self._golden = self._free()
        self._run: list[int] = []
        ended = self._stepped(self._record)
        if ended.how != "done" or ended.payload != self._golden:
            raise MavfiError(
                f"single steps without a fault: ended with {ended.how} ({ended.detail}), not as a free run"
            )
        self.own = sum(made is not None for made in self._instructions)

    @property
    def steps(self) -> int:
        """Number of dynamic instructions from entry to return, including functions in files."""
        return len(self._run)

    @property
    def budget(self) -> int:
        """Number of dynamic instructions after which a call counts as hanging: as at IR level, 3 n + 10,000."""
        return 3 * self.steps + 10_000

    @cached_property
    def _instructions(self) -> list[MachineInstruction | None]:
        """The code's own instructions as executed; None for others."""
        ranges = _unnamed_code()
        own: dict[int, MachineInstruction | None] = {}
        for address in self._run:
            if address not in own:
                inside = any(start <= address < end for start, end in ranges)
                own[address] = _decode_here(address) if inside else None
        return [own[address] for address in self._run]

    @cached_property
    def sites(self) -> list[tuple[int, tuple[Register, ...]]]:
        """Injectable steps, and the destination registers of each."""
        return [(step, found) for step, found in enumerate(destinations(self._instructions)) if found]

    @cached_property
    def out_of_reach(self) -> int:
        """Dynamic instructions without accessible destination: mask registers, vector registers from 16 on."""
        return sum(made is not None and is_out_of_reach(made) for made in self._instructions)

    def text(self, step: int) -> str:
        """Mnemonic and operands of an own instruction; "" for others."""
        made = self._instructions[step]
        return "" if made is None else made.text

    def draw(self, random: np.random.Generator, n: int) -> list[MachineFault]:
        """Sample faults: uniform over the dynamic instructions with a destination, then its registers, then its bits.

        Args:
            random: Random generator.
            n: Number of faults.
        """
        faults = []
        for place in random.integers(len(self.sites), size=n).tolist():
            step, registers = self.sites[place]
            register = registers[int(random.integers(len(registers)))]
            faults.append(MachineFault(step, register, register.bits[int(random.integers(len(register.bits)))]))
        return faults

    def inject(self, fault: MachineFault, *, null: bool = False) -> MachineOutcome:
        """Execute the call with a fault.

        Args:
            fault: A fault sampled from this call.
            null: Perform every operation except the flip, to verify that injection itself has no side effect.

        Raises:
            MavfiError: The instruction differs from that of the recorded run.
        """
        seen: list[int] = []
        ended = self._stepped(partial(self._inject, fault, null, seen))
        if len(seen) != 2:
            raise MavfiError(f"step {fault.step}: not reached as in the recorded run ({ended.how}, {ended.detail})")
        how: How
        if ended.how == "done":
            how = "masked" if ended.payload == self._golden else "sdc"
        else:
            how = ended.how
        return MachineOutcome(how, fault, self.text(fault.step), seen[0], seen[1], ended.detail)

    # ---- the traced child -------------------------------------------------------------------------------------------
    def _free(self) -> bytes:
        ended = run_in_child(self._call)
        if ended.how != "done":
            raise MavfiError(f"the call without a fault ended with {ended.how} ({ended.detail})")
        return ended.payload

    def _stepped(self, between: Callable[[Tracee, int], bool]) -> ChildEnd:
        """Execute the call in a child that waits to be traced; `between` steps from entry to return."""
        waiting, starting = os.pipe()

        def held() -> bytes:
            os.read(waiting, 1)
            return self._call()

        try:
            return run_in_child(held, attend=lambda child: self._attend(child, starting, between))
        finally:
            os.close(waiting)
            os.close(starting)

    def _attend(self, child: int, starting: int, between: Callable[[Tracee, int], bool]) -> ChildEnd | None:
        """Trace a child from entry to return of the code, then detach; returns its termination if it ended before."""
        try:
            tracee = Tracee(child)
        except PermissionError:
            _kill(child)
            raise BadInputError(f"single steps: may not trace a child of this process ({not_permitted()})") from None
        try:
            tracee.interrupt(_LIMIT)
            tracee.set_breakpoint(self._entry)
            tracee.resume()
            os.write(starting, b"\n")
            home = _arrive(tracee, self._entry)
            if between(tracee, home):
                tracee.detach()
                return None
        except TargetGoneError as gone:
            return judge_exit(gone.code)
        except BaseException:
            _kill(child)
            raise
        _kill(child)
        return ChildEnd("hang", detail="instruction budget")

    def _record(self, tracee: Tracee, home: int) -> bool:
        """Record every instruction until the code returns."""
        address = self._entry
        while address != home:
            self._run.append(address)
            tracee.step(_LIMIT)
            address = tracee.general()["rip"]
        return True

    def _inject(self, fault: MachineFault, null: bool, seen: list[int], tracee: Tracee, home: int) -> bool:
        """Step to the fault, inject, and step until the code returns; False if the budget is exceeded first."""
        for _ in range(fault.step):
            tracee.step(_LIMIT)
        if tracee.general()["rip"] != self._run[fault.step]:
            return True
        tracee.step(_LIMIT)
        seen.append(value_of(tracee, fault.register))
        if not null:
            flip(tracee, fault.register, fault.bit)
        seen.append(value_of(tracee, fault.register))
        for _ in range(self.budget - fault.step):
            if tracee.general()["rip"] == home:
                return True
            tracee.step(_LIMIT)
        return False


def _arrive(tracee: Tracee, entry: int) -> int:
    """Run a child to the entry of the code; returns the code's return address."""
    while True:
        try:
            stop = tracee.wait(_LIMIT)
        except (TargetGoneError, TracerTimeoutError):
            raise MavfiError(f"the call did not come to {entry:#x}: is the code inlined into its caller?") from None
        registers = tracee.general()
        if not stop.signal and registers["rip"] == entry:
            break
        tracee.resume(stop.signal)
    tracee.clear_breakpoint()
    with open(f"/proc/{tracee.thread}/mem", "rb", buffering=0) as memory:
        return int.from_bytes(os.pread(memory.fileno(), _WORD, registers["rsp"]), "little")


def _kill(child: int) -> None:
    """Kill a child that may have exited, and reap it."""
    with contextlib.suppress(ProcessLookupError, ChildProcessError):
        os.kill(child, signal.SIGKILL)
        while os.WIFSTOPPED(os.waitpid(child, 0)[1]):
            pass


def _unnamed_code() -> list[tuple[int, int]]:
    """Executable memory without a backing file: code compiled in this process."""
    found = []
    for line in Path("/proc/self/maps").read_text().splitlines():
        columns = line.split(None, 5)
        if "x" in columns[1] and len(columns) == 5:
            start, end = (int(text, 16) for text in columns[0].split("-"))
            found.append((start, end))
    return found


def _decode_here(address: int) -> MachineInstruction | None:
    """The instruction at an address of this process, which is valid in its children."""
    return decode(ctypes.string_at(address, _LONGEST_INSTRUCTION), address)
