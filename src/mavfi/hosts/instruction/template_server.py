"""The program of a template: `python -m mavfi.hosts.instruction.template_server SCENARIO`, see `template`.

It flies one mission of the kind, with every kernel instrumented, and waits.  Each request is read and answered by a
fork, so that the template itself stays as it is.
"""

import contextlib
import hashlib
import json
import os
import pickle
import select
import sys
import time
from typing import Any

import numpy as np

from mavfi.config import parse
from mavfi.errors import MavfiError
from mavfi.faults.fault import InstructionFault, fault_from_json
from mavfi.faults.instruction import Counting, run_in_child
from mavfi.faults.instruction.forked import LENGTH_BYTES, framed, write_all
from mavfi.faults.instruction.launch import addresses_are_fixed
from mavfi.hosts.instruction.case import Case
from mavfi.hosts.instruction.forking import Forks
from mavfi.hosts.instruction.template import AGAIN, ENDED, READY
from mavfi.hosts.local import fly
from mavfi.hosts.loop.golden_prefix import GoldenPrefix
from mavfi.hosts.loop.recovery import Coupling
from mavfi.mission import Scenario
from mavfi.numerics.jit import code_folder
from mavfi.pipeline.functions import PLAIN

_REQUESTS = 0
_ANSWERS = os.dup(1)
_NO_REQUEST = 3


def main() -> None:
    """Warm up, and be forked until requests end."""
    os.dup2(2, 1)  # whatever prints does not print into the answers
    before = _cache()
    try:
        scenario = parse(Scenario, json.loads(sys.argv[1]), "template")
        names = tuple(PLAIN.__dataclass_fields__)
        fly(scenario, functions=PLAIN.instrumented(names, lambda _, function: Counting(function)))
    except MavfiError:
        pass  # there is no such mission; then each fork loads what it needs
    write_all(_ANSWERS, framed(READY if _cache() == before and not _wrote_bytecode() else AGAIN) + ENDED)
    failure = framed(pickle.dumps((False, ("", "the process of a flight with a fault in an address died"), None)))
    while True:
        select.select([_REQUESTS], [], [])
        child = os.fork()
        if child == 0:
            _answer()
        _, status = os.waitpid(child, 0)
        if os.waitstatus_to_exitcode(status) == _NO_REQUEST:
            return
        write_all(_ANSWERS, ENDED if status == 0 else failure + ENDED)


def _answer() -> None:
    """In the fork: read one request, fly, answer, end."""
    status = 1
    try:
        request = _read()
        if not request:
            status = _NO_REQUEST
            return
        try:
            paths, work = pickle.loads(request)
            sys.path[:] = paths or sys.path
            answer: tuple[bool, Any, Any] = (addresses_are_fixed(), None, fly_one(*pickle.loads(work)))
        except Exception as error:  # noqa: BLE001 - whoever asked is told, whatever it is
            answer = (addresses_are_fixed(), (type(error).__name__, str(error)), None)
        write_all(_ANSWERS, framed(pickle.dumps(answer)))
        status = 0
    finally:
        os._exit(status)


def fly_one(scenario: str, fault: str, detector: Any, coupling: Coupling) -> tuple[GoldenPrefix, list[Case]]:
    """Fly one mission (as JSON) with a fault (as JSON); see `Forks.fly_to_injections`."""
    mission = parse(Scenario, json.loads(scenario), "request")
    planned = fault_from_json(json.loads(fault))
    assert isinstance(planned, InstructionFault)  # others are not flown from templates
    with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
        return Forks(mission, [planned], detector, coupling).fly_to_injections()


def _cache() -> bytes:
    """Digest of the compiled code; a child looks, since its memory depends on how much there is."""

    def look() -> bytes:
        found = sorted((str(path), path.stat().st_size) for path in code_folder().rglob("*") if path.is_file())
        return hashlib.sha256(repr(found).encode()).digest()

    return run_in_child(look).payload


def _wrote_bytecode() -> bool:
    """Whether modules were compiled to bytecode since this process began: then the next one will load them."""
    template = os.getpid()

    def look() -> bytes:
        with open(f"/proc/{template}/stat", encoding="ascii") as file:
            ticks = int(file.read().rpartition(")")[2].split()[19])  # its begin since the machine's, proc(5)
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
        files = [getattr(module, "__cached__", None) for module in list(sys.modules.values())]
        written = [os.stat(file).st_mtime for file in files if file is not None and os.path.exists(file)]
        return b"1" if max(written, default=0.0) >= time.time() - age else b""

    return bool(run_in_child(look).payload)


def _read() -> bytes:
    length = _exactly(LENGTH_BYTES)
    return _exactly(int.from_bytes(length, "little")) if length else b""


def _exactly(size: int) -> bytes:
    data = b""
    while len(data) < size:
        chunk = os.read(_REQUESTS, size - len(data))
        if not chunk:
            return b""
        data += chunk
    return data


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):  # whoever asked is gone
        main()
