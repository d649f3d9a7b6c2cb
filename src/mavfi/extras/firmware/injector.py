"""One register fault in the main thread of a firmware in lock-step, uniform over its instructions, replayed exactly.

An instruction of a period is named by two numbers: of the main thread's call of the shim (its clock, for the most part)
and of the instruction after this call.  Both are drawn below an upper bound, and the firmware stops there
(`lockstep.c`).  Where a period has no such instruction nothing happens, and the next period gets a new draw: so all
instructions of a period are equally likely, a hundred are stepped for each draw instead of half a period, and no clock
of the machine decides anything.
"""

import os
import random
from dataclasses import replace

from mavfi.errors import BadInputError
from mavfi.extras.firmware.process import NEVER, Firmware, StopPoint, fixed_addresses
from mavfi.extras.registers.addresses import AddressSpace
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.registers.injector import flip_here, injection_of
from mavfi.extras.registers.ptrace import TargetGoneError, Tracee
from mavfi.extras.registers.target import not_permitted
from mavfi.record import Injection
from mavfi.states import State

NODE = "firmware"
"""`RegisterFault.node` of a fault in a firmware."""
WALK = 3_000
"""Upper bound of the instructions between two calls of the shim; `RegisterFault.walk` of a fault in a firmware."""
CALLS = 512
"""Upper bound of the calls in a period of 1 ms."""
_STOP_LIMIT_S = 10.0
"""Longest wait for the main thread to stop (s)."""


class FirmwareInjector:
    """Injects one fault; the injector tap of its flight, whose publications pass unchanged.

    Attributes:
        fault: The fault; its symbol cannot be chosen.
        injections: The injection; empty = not yet.
    """

    spent = True

    def __init__(self, fault: RegisterFault) -> None:
        if fault.symbol:
            text = "allowed: none; faults are uniform over the instructions of the main thread"
            raise BadInputError(f"firmware: symbol {fault.symbol!r}: {text}")
        self.fault = fault
        self.injections: list[Injection] = []
        self._choices = random.Random(f"{fault.seed}/firmware")
        self._periods = 0

    def __call__(self, state: State, time_us: int) -> State:
        """The unchanged publication."""
        del time_us
        return state

    def stop_at(self, time_us: int) -> StopPoint:
        """Where the firmware has to stop in the next period, see `Firmware.run`."""
        if self.injections or time_us < self.fault.time_us:
            return NEVER
        self._periods += 1
        return StopPoint(self._choices.randrange(CALLS), self._choices.randrange(self.fault.walk))

    def inject(self, firmware: Firmware, time_us: int) -> None:
        """Inject into a firmware that has stopped there, at an instant of the flight, and run it to the period's end.

        Raises:
            BadInputError: It may not be traced.
            FirmwareLostError: It ended or hangs.
        """
        # The main thread waits in front of an instruction: it becomes ours.
        call = firmware.calls - 1
        walked = firmware.instructions
        space = AddressSpace(firmware.pid)
        memory = os.open(f"/proc/{firmware.pid}/mem", os.O_RDONLY)
        try:
            tracee = _stop_main_thread(firmware)

            def walk(count: int) -> bool:
                """Execute some instructions; False = the thread has left the firmware's code for the shim."""
                for _ in range(count):
                    tracee.step(_STOP_LIMIT_S)
                return space.location_of(tracee.instruction_pointer()).library != str(firmware.shim)

            # Flip a bit at the first eligible instruction; without one, a later period is tried.
            flipped = flip_here(self.fault, self._choices, tracee, memory, walk)
            if flipped is not None:
                details = {
                    "node": NODE,
                    "kernel": NODE,
                    "call": call,
                    "walked": walked,
                    "periods": self._periods,
                    "replayable": bool(fixed_addresses()),
                }
                injection = injection_of(flipped, space, self.fault, details)
                self.injections = [replace(injection, time_s=1e-6 * time_us)]
            # Release it: it runs on to the end of the period.
            tracee.detach()
        except TargetGoneError as error:
            raise firmware.loss(error.code) from None
        finally:
            os.close(memory)
            space.close()
        firmware.wait()

    def finish(self) -> list[Injection]:
        """The injection, or that of a fault that was not injected."""
        fault = self.fault
        missed = Injection(fault.level, fault.site, 1e-6 * fault.time_us, None, None, None, activated=False)
        return self.injections or [missed]


def _stop_main_thread(firmware: Firmware) -> Tracee:
    """The main thread of a firmware that waits in front of an instruction, stopped at this instruction."""
    try:
        tracee = Tracee(firmware.pid)
    except PermissionError:
        raise BadInputError(f"pid {firmware.pid}: may not be traced ({not_permitted()})") from None
    tracee.interrupt(_STOP_LIMIT_S)
    tracee.set_breakpoint(firmware.address)
    tracee.resume()
    firmware.resume()
    tracee.wait(_STOP_LIMIT_S)
    tracee.clear_breakpoint()
    return tracee
