"""Faults in addresses: the same bytes in any process, order and company, as each flight is forked from a template."""

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from mavfi.campaign.samplers.instruction import draw_instruction_faults
from mavfi.errors import MavfiError
from mavfi.faults.instruction import MismatchError, launch
from mavfi.faults.instruction.plan import is_in_data
from mavfi.faults.spec import InstructionRequest
from mavfi.hosts.instruction import case, fly_instruction_faults, template
from mavfi.hosts.loop.compose import resolve
from mavfi.kernels.perception.point_cloud import back_project
from mavfi.mission import MissionSpec
from mavfi.numerics.jit import code_folder

pytestmark = pytest.mark.slow

KERNELS = {"pid": 4, "point_cloud": 5, "octomap": 3}
SEEDS = (3, 4)
ELSEWHERE = """
import json, sys
sys.path[:0] = {roots!r}
from mavfi.faults.fault import fault_from_json
from tests.hosts.instruction.test_template import flown
blocks = [bytearray(size) for size in range(1, 200_000, 977)]
print(json.dumps(flown([fault_from_json(data) for data in json.loads(sys.stdin.read())])))
"""


def scenario():
    return resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))


def flown(faults):
    """All that a flight leaves, as text."""
    logs = [flight.log for flight in fly_instruction_faults(scenario(), faults).flights]
    told = [(log.digest(), log.injections[0].to_json(), asdict(log.kernel)) for log in logs]
    return json.loads(json.dumps(told))


@pytest.fixture(scope="module")
def faults():
    drawn = [
        draw_instruction_faults(scenario(), InstructionRequest(KERNELS, which="address"), seed=seed).faults
        for seed in SEEDS
    ]
    return [fault for faults in drawn for own in faults.values() for fault in own]


@pytest.fixture(scope="module")
def told(faults):
    return flown(faults)


def test_they_are_faults_in_addresses_that_crash_corrupt_and_are_masked(faults, told):
    assert not any(is_in_data(fault) for fault in faults)
    assert {kernel["effect"] for _, _, kernel in told} >= {"crash", "sdc", "masked"}
    assert all(record["activated"] and record["details"]["value_class"] == "address" for _, record, _ in told)
    assert any(record["details"]["type"] == "ptr" for _, record, _ in told)


def test_order_and_company_do_not_matter(faults, told):
    assert flown(faults[::-1]) == told[::-1]
    crashed = next(i for i, row in enumerate(told) if row[2]["effect"] == "crash")
    corrupted = next(i for i, row in enumerate(told) if row[2]["effect"] == "sdc")
    for number in (crashed, corrupted):
        assert flown([faults[number]]) == [told[number]]


def test_a_fresh_process_with_another_past_gives_the_same_bytes(faults, told, tmp_path):
    """Another folder, environment, heap and hash seed; and a template of its own."""
    roots = [os.getcwd(), *(os.path.abspath(entry) for entry in sys.path if entry)]
    given = [os.path.abspath(entry) for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    environment = os.environ | {
        "PYTHONHASHSEED": "99", "SOMETHING": "x" * 5_000, "PYTHONPATH": os.pathsep.join(given)
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE.format(roots=roots)], env=environment, cwd=tmp_path, capture_output=True,
        input=json.dumps([fault.to_json() for fault in faults]), text=True, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout) == told


def test_a_template_that_had_to_compile_modules_is_not_the_one_that_is_forked(faults, told, monkeypatch):
    """The first process after an update compiles them to bytecode, all later ones load it: their memory differs."""
    compiled = Path(importlib.util.cache_from_source(case.__file__))
    said = []
    receive = template.Template._receive

    def listen(self):
        said.append(receive(self))
        return said[-1]

    template.close_templates()
    monkeypatch.setattr(template.Template, "_receive", listen)
    compiled.unlink(missing_ok=True)
    try:
        assert flown(faults[:1]) == told[:1]
    finally:
        template.close_templates()
    assert said[:2] == [template.AGAIN, template.READY]


@pytest.mark.long
def test_what_else_was_compiled_does_not_matter(faults, told):
    """Other signatures of the same functions are in the cache or not."""
    before = set(code_folder().rglob("*.nbc"))
    small = np.zeros((4, 3), np.float32)
    back_project(small[:, 0].astype(np.int16), small, np.eye(3), np.zeros(3), 20.0, small)
    made = set(code_folder().rglob("*.nbc")) - before
    template.close_templates()
    try:
        assert made
        assert flown(faults) == told
    finally:
        template.close_templates()
        for path in made:
            path.unlink()


def test_where_addresses_cannot_be_fixed_the_rows_say_so(faults, told, monkeypatch):
    """As in a container whose filter of system calls refuses personality(2)."""
    template.close_templates()
    monkeypatch.setattr(launch, "_personality", lambda wanted=0: -1)
    try:
        rows = flown(faults[:2])
    finally:
        template.close_templates()
    assert [row[1]["details"]["replayable"] for row in rows] == [False, False]
    assert all(row[1]["details"]["replayable"] for row in told)


def test_faults_in_data_are_replayable_anywhere():
    fault = draw_instruction_faults(scenario(), InstructionRequest({"pid": 1}, which="data"), seed=3).faults["pid"][0]
    assert is_in_data(fault)
    assert flown([fault])[0][1]["details"]["replayable"]


def test_errors_come_back_as_what_they_are(faults):
    with pytest.raises(MismatchError, match="drawn for IR 000000000000"):
        fly_instruction_faults(scenario(), [replace(faults[0], ir_sha256="0" * 64)])


def test_nothing_is_left_of_templates(faults):
    template.close_templates()
    before = len(os.listdir("/proc/self/fd"))
    flown(faults[:1])
    template.close_templates()
    assert len(os.listdir("/proc/self/fd")) == before
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


def test_a_template_that_dies_is_an_error_and_not_a_wait():
    broken = template.Template.__new__(template.Template)
    broken._process = subprocess.Popen(["true"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
    with pytest.raises(MavfiError, match="has died"):
        broken.ask(b"anything")
    broken.close()
