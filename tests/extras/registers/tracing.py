"""Whether a process may trace its children here."""

import os
import signal

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.registers.ptrace import Tracee
from mavfi.extras.registers.target import check_machine, not_permitted


def require_tracing():
    """Skip where a child must not be traced, and say why."""
    try:
        check_machine()
    except BadInputError as reason:
        pytest.skip(str(reason))
    child = os.fork()
    if child == 0:
        signal.pause()
        os._exit(0)
    try:
        Tracee(child).detach()
    except PermissionError:
        pytest.skip(f"a process may not trace its children: {not_permitted()}")
    finally:
        os.kill(child, signal.SIGKILL)
        while os.WIFSTOPPED(os.waitpid(child, 0)[1]):
            pass
