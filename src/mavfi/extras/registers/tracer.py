"""The tracing process: separate from the one that the user started, and out of reach of the keyboard.

During single-stepping or with a breakpoint, the target depends on its tracer.  This process protects the target if the
user's process is stopped or killed: it detects this, removes the breakpoint, releases the target, and exits.
"""

import json
import os
import select
import signal
import sys
import time
from dataclasses import replace
from typing import TextIO

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.registers.injector import inject_once
from mavfi.faults.fault import fault_from_json


def _abandoned() -> bool:
    """Whether the caller no longer waits for an answer: the other end of stdin is closed."""
    readable, _, _ = select.select([sys.stdin.fileno()], [], [], 0)
    return bool(readable)


def serve(order: dict, answers: TextIO) -> None:
    """Inject as often as requested; write each injection, or the reason for its failure, as a line of JSON."""
    began = time.monotonic()
    try:
        fault = fault_from_json(order["fault"])
        assert isinstance(fault, RegisterFault)
        for number in range(order["count"]):
            if _abandoned():
                return
            injection = inject_once(order["pid"], fault, number, order["tool"], _abandoned)
            injection = replace(injection, time_s=round(time.monotonic() - began, 6))
            answers.write(json.dumps({"done": injection.to_json()}) + "\n")
            answers.flush()
    except BadInputError as error:
        answers.write(json.dumps({"refused": str(error)}) + "\n")
    except MavfiError as error:
        answers.write(json.dumps({"failed": str(error)}) + "\n")


def main() -> None:
    """Read one order from stdin, write answers to stdout."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})  # can be waited for, see `await_news`
    with open(sys.stdin.fileno(), "rb", buffering=0, closefd=False) as orders:  # end of file stays unread
        line = orders.readline()
    if not line.endswith(b"\n"):
        return
    try:
        serve(json.loads(line), sys.stdout)
        sys.stdout.flush()
    except BrokenPipeError:
        os._exit(0)


if __name__ == "__main__":
    main()
