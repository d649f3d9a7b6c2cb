"""Flies faults in addresses from identical processes, so that such flights can be replayed bit for bit.

A corrupted address accesses whatever lies there, and that depends on the whole history of the process: on its other
flights, on the command line, on what was compiled.  So each of these flights is forked from a *template*: a process
with fixed addresses and hashing, a fixed environment and a fixed history, which has flown one fixed mission and waits.
Templates of one kind of mission are the same in every command, campaign and worker.
"""

import atexit
import json
import os
import pickle
import re
import select
import subprocess
import sys
import time
from collections import OrderedDict
from pathlib import Path
from typing import Any

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError, MavfiError
from mavfi.faults.fault import InstructionFault
from mavfi.faults.instruction.forked import LENGTH_BYTES, framed, write_all
from mavfi.faults.instruction.launch import with_fixed_addresses
from mavfi.faults.instruction.refusal import MismatchError
from mavfi.hosts.instruction.case import Case
from mavfi.hosts.loop.golden_prefix import GoldenPrefix
from mavfi.hosts.loop.recovery import Coupling
from mavfi.mission import Scenario
from mavfi.numerics.jit import code_folder

_SERVER = "mavfi.hosts.instruction.template_server"
_KEPT = 4
"""Templates that a process keeps waiting."""
_PASSED = ("HOME", "LANG", "LD_LIBRARY_PATH", "PATH", "VIRTUAL_ENV", "XDG_CACHE_HOME")
_FIXED = {"PYTHONHASHSEED": "0", **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")}
_ERRORS = {"BadInputError": BadInputError, "MismatchError": MismatchError}
_CHUNK = 1 << 16
ENDED = b"e"
"""What a template says when a flight's process is gone."""
READY, AGAIN = b"ready", b"again"
"""What a template says when it is warm; `AGAIN` if it had to compile for that: the next one will not, and differs."""
_PATIENCE_S = 300.0
"""Other processes may compile at the same time; a template waits until the cache of compiled code stays as it is."""


class Template:
    """A process that waits to be forked; templates of one `kind`, the mission of their warm-up, are identical.

    Raises:
        MavfiError: It died, or other processes keep changing the cache of compiled code.
    """

    def __init__(self, kind: str) -> None:
        command = [sys.executable, "-P", "-m", _SERVER, kind]
        begun = time.monotonic()
        while time.monotonic() - begun < _PATIENCE_S:
            self._process = with_fixed_addresses(
                lambda: subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                    env=_environment(), cwd="/", bufsize=0, start_new_session=True,
                )
            )  # fmt: skip
            if self._receive() == READY:
                return
            self.close()
        raise MavfiError(f"the cache of compiled code changes all the time: {code_folder()}")

    def ask(self, request: bytes) -> tuple[Any, bool]:
        """Fork the template and let the child work; its errors are raised here, `MavfiError` also if it died.

        Returns:
            The result, and whether addresses and hashes were fixed.
        """
        self._send(request)
        fixed, failure, result = pickle.loads(self._receive())
        if failure:
            raise _ERRORS.get(failure[0], MavfiError)(failure[1])
        return result, fixed

    def close(self) -> None:
        """End it."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process.wait()

    def _send(self, data: bytes) -> None:
        assert self._process.stdin is not None  # a pipe
        try:
            write_all(self._process.stdin.fileno(), framed(data))
        except BrokenPipeError:
            raise MavfiError("the process from which flights are forked has died") from None

    def _receive(self) -> bytes:
        """The child's answer, which ends with the template's word that the child is gone."""
        assert self._process.stdout is not None  # a pipe
        handle = self._process.stdout.fileno()
        data = bytearray()
        while True:
            select.select([handle], [], [])
            chunk = os.read(handle, _CHUNK)
            data += chunk
            if not chunk:
                raise MavfiError("the process from which flights are forked has died")
            whole = len(data) - LENGTH_BYTES - len(ENDED)
            if whole >= 0 and int.from_bytes(data[:LENGTH_BYTES], "little") == whole:
                return bytes(data[LENGTH_BYTES : LENGTH_BYTES + whole])


def _environment() -> dict[str, str]:
    """The same in every command: what finds the code and its cache, and nothing else."""
    package = Path(__file__).parents[3]
    given = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    roots = dict.fromkeys([str(package), *(os.path.abspath(entry) for entry in given)])
    passed = {name: os.environ[name] for name in _PASSED if name in os.environ}
    numba = {name: value for name, value in sorted(os.environ.items()) if name.startswith("NUMBA_")}
    return {**passed, **numba, **_FIXED, "PYTHONPATH": os.pathsep.join(roots)}


_PLUGGED = re.compile(r'"[A-Za-z_][\w.]*:[A-Za-z_]\w*"')
"""How a user's own planner or map is named."""
_templates: OrderedDict[tuple[int, str], Template] = OrderedDict()


def template_for(kind: str) -> Template:
    """The template of a kind; each process has its own, and ends the one that it has not used for longest."""
    process = os.getpid()
    key = (process, kind)
    if key not in _templates:
        own = [other for other in _templates if other[0] == process]  # others are those of a parent
        for oldest in own[: max(0, len(own) - _KEPT + 1)]:
            _templates.pop(oldest).close()
        _templates[key] = Template(kind)
    _templates.move_to_end(key)
    return _templates[key]


def fly_from_template(
    scenario: Scenario, fault: InstructionFault, detector: Detector | None, coupling: Coupling = "inline"
) -> tuple[GoldenPrefix, Case]:  # fmt: skip
    """Fly one mission with a fault in an instruction, in a process forked from the template of its kind.

    Returns the beginning of the golden flight over there, and the case; for errors see `Template.ask`.
    """
    kind = scenario.model_copy(update={"seed": 0, "start": None, "goal": None})
    parts = (json.dumps(part.to_json(), sort_keys=True) for part in (scenario, fault))
    template = template_for(json.dumps(kind.to_json(), sort_keys=True))
    paths = sys.path if _has_parts_of_a_user(kind, detector) else []  # the mission computer's memory holds them too
    request = pickle.dumps((paths, pickle.dumps((*parts, detector, coupling))))
    (prefix, (case,)), fixed = template.ask(request)
    case.replayable = fixed
    return prefix, case


def _has_parts_of_a_user(kind: Scenario, detector: Detector | None) -> bool:
    """Whether a flight needs modules that are found from here only."""
    plugged = _PLUGGED.search(json.dumps(kind.to_json())) is not None
    return plugged or (detector is not None and not type(detector).__module__.startswith("mavfi."))


@atexit.register
def close_templates() -> None:
    """End all templates of this process."""
    while _templates:
        (process, _), template = _templates.popitem()
        if process == os.getpid():
            template.close()
