"""SIGKILL of the process that injects registers, at random instants: its target must survive and continue.

    python -m tests.nightly.tracers        (N=200 kills of each target, SEED=1)

This holds without single-stepping, the default where no function is named.  A target that is being single-stepped dies
with its tracer; the share of these cases is printed.
"""

import os
import random
import signal
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from mavfi.extras.registers.fault import DEFAULT_WALK, RegisterFault
from mavfi.extras.registers.injector import inject_once
from mavfi.extras.registers.registers import decode
from tests.extras.registers.conftest import Targets
from tests.nightly.chaos import say

TARGETS = ("spin", "threads")
STEPLESS = RegisterFault(null=True)
STEPPING = RegisterFault(access="either", walk=DEFAULT_WALK, null=True)
LONGEST_S = 0.15
"""Of a tracer's life; an injection takes a tenth of it."""
_PATIENCE_S = 2.0
_TICKS = slice(11, 13)


def killed(pid, instant, fault):
    """Inject null faults one after the other, and kill the process that does so at an instant (s)."""
    tracer = os.fork()
    if tracer == 0:
        try:
            number = 0
            while True:
                inject_once(pid, fault, number, 0, bool)
                number += 1
        finally:
            os._exit(1)
    time.sleep(instant)
    os.kill(tracer, signal.SIGKILL)
    return os.waitpid(tracer, 0)[1] == signal.SIGKILL


def survives(target):
    """ "" if the process computes, untraced; otherwise what it does instead."""
    begun, deadline = _ticks(target.pid), time.monotonic() + _PATIENCE_S
    status = {}
    while time.monotonic() < deadline:
        if target.poll() is not None:
            return f"it ended with {target.returncode}"
        lines = Path(f"/proc/{target.pid}/status").read_text(encoding="ascii").splitlines()
        status = dict(line.split(":\t", 1) for line in lines)
        if status["TracerPid"] == "0" and status["State"][0] not in "tT" and _ticks(target.pid) > begun:
            return ""
        time.sleep(0.002)
    return f"it stands still: state {status['State']}, tracer {status['TracerPid']}"


def _ticks(pid):
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return 0
    return sum(map(int, fields[_TICKS]))


def strike(targets, name, kills, draw, fault):
    """Kill so many tracers of a program; gives how it ended where it did not survive, and how many were killed."""
    target, _ = targets.start(name)
    wrong, hits = [], 0
    for _ in range(kills):
        hits += killed(target.pid, draw.uniform(0.0, LONGEST_S), replace(fault, seed=draw.randrange(1 << 30)))
        found = survives(target)
        if found:
            wrong.append(found)
            target.kill()
            target, _ = targets.start(name)
    return wrong, hits


def main():
    """Kill N tracers of each target."""
    kills, draw = int(os.environ.get("N", "200")), random.Random(int(os.environ.get("SEED", "1")))
    decode(b"\x90", 0)
    total = 0
    with tempfile.TemporaryDirectory(prefix="mavfi-tracers-") as folder:
        targets = Targets(Path(folder))
        try:
            for name in TARGETS:
                for fault in (STEPLESS, STEPPING):
                    wrong, hits = strike(targets, name, kills, draw, fault)
                    total += 0 if fault.steps else len(wrong)
                    how = "with" if fault.steps else "without"
                    say(f"{name}, {how} steps: {kills - len(wrong)} of {kills} lived on {wrong[:2]}, {hits} kills")
        finally:
            for target in targets.running:
                target.kill()
                target.wait()
    return 1 if total else 0


if __name__ == "__main__":
    sys.exit(main())
