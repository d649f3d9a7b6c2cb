"""Flips a bit in a register of a running process (x86-64 Linux) by system calls, as the paper's injector does.

`inject` is the entry point.  The target need not run any part of mavfi, nor be a robot.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from mavfi.errors import BadInputError, MavfiError, naming_extra

if TYPE_CHECKING:
    from mavfi.extras.registers.fault import RegisterFault
    from mavfi.record import Injection

__all__ = ["inject"]

_RELEASE_S = 5.0
"""Time for a cancelled tracer to release the target."""


def inject(
    pid: int,
    fault: "RegisterFault",
    count: int = 1,
    tell: "Callable[[Injection], None] | None" = None,
) -> "list[Injection]":
    """Flip bits in registers of a running process.

    The paper's injector reaches its targets by system calls as well (MAVFI section III-B).  The target is traced by a
    separate process, is stopped for about a millisecond per injection, and continues afterwards, whatever happens to
    the caller.

    Args:
        pid: The process.
        fault: The fault.
        count: Number of injections.
        tell: Called with each injection immediately.

    Returns:
        The injections, with times relative to the call (s); `activated` says whether the bit was read back flipped.

    Raises:
        BadInputError: Not x86-64 Linux; no such process, or one that has ended, is stopped, is already traced, is
            mavfi itself, or belongs to another user or to the kernel; no such thread or symbol; no permission.
        MavfiError: The target ended, or did not reach the injection point in time.
    """
    # Refuse what cannot be injected before a tracer is started.
    if count < 1:
        raise BadInputError(f"count: {count}: allowed: 1 or more")
    if pid < 1:
        raise BadInputError(f"pid: {pid}: allowed: the number of a running process")
    from mavfi.extras.registers.target import check_target

    with naming_extra("faults in registers"):  # the tracer's packages: a missing one would only end that process
        from mavfi.extras.registers import addresses, registers  # noqa: F401
    check_target(pid, os.getpid())
    order = {"pid": pid, "fault": fault.to_json(), "count": count, "tool": os.getpid()}
    injections: list[Injection] = []
    # The tracer gets one order, and answers with a line per injection.
    with subprocess.Popen(
        [sys.executable, "-m", "mavfi.extras.registers.tracer"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    ) as tracer:
        assert tracer.stdin is not None and tracer.stdout is not None
        # Whatever happens here, the end of its input tells the tracer to release the target.
        try:
            tracer.stdin.write(json.dumps(order).encode() + b"\n")
            tracer.stdin.flush()
            for line in tracer.stdout:
                injection = _read(json.loads(line))
                injections.append(injection)
                if tell is not None:
                    tell(injection)
        finally:
            tracer.stdin.close()
            tracer.wait(_RELEASE_S)
    if len(injections) < count:  # it was killed, or failed before it could report why
        raise MavfiError(f"pid {pid}: the tracer ended with exit code {tracer.returncode}")
    return injections


def _read(answer: dict[str, Any]) -> "Injection":
    """The injection in an answer of the tracer, or its error."""
    from mavfi.record import Injection

    if "refused" in answer:
        raise BadInputError(answer["refused"])
    if "failed" in answer:
        raise MavfiError(answer["failed"])
    return Injection.from_json(answer["done"])
