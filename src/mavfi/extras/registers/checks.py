"""Whether this process may trace others, for `mavfi doctor`."""

import signal
import subprocess
import sys

from mavfi.cli.doctor import Check
from mavfi.extras.registers.ptrace import Tracee
from mavfi.extras.registers.target import not_permitted


def checks() -> list[Check]:
    """Seizes a program that sleeps."""
    with subprocess.Popen([sys.executable, "-S", "-c", "import signal; signal.pause()"]) as target:
        try:
            Tracee(target.pid)
        except OSError:
            return [Check("ptrace", False, not_permitted())]
        finally:
            target.send_signal(signal.SIGKILL)
    return [Check("ptrace", True, "programs may be traced (mavfi inject)")]
