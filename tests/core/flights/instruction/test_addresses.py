"""Faults in addresses: the same bytes in any process, folder, environment, order and company."""

import json
import subprocess
import sys
from dataclasses import asdict

import pytest

from mavfi.flight.compose import resolve
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.mission import MissionSpec
from mavfi.numerics.jit import code_folder
from tests.core.architecture.source import ROOT

pytestmark = pytest.mark.slow

KERNELS = {"pid": 4, "point_cloud": 5, "octomap": 3, "collision_check": 3, "rrt_connect": 3}
SEEDS = (3, 4)
ELSEWHERE = """
import json, sys
from mavfi.faults.fault import fault_from_json
from tests.core.flights.instruction.test_addresses import flown
blocks = [bytearray(size) for size in range(1, 200_000, 977)]
print(json.dumps(flown([fault_from_json(data) for data in json.loads(sys.stdin.read())])))
"""


def scenario():
    return resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))


def flown(faults):
    """All that a flight leaves, as text."""
    logs = [flight.log for flight in fly_instruction_faults(scenario(), faults).flights]
    records = [(log.digest(), log.injections[0].to_json(), asdict(log.kernel)) for log in logs]
    return json.loads(json.dumps(records))


@pytest.fixture(scope="module")
def faults():
    drawn = [
        draw_instruction_faults(scenario(), InstructionRequest(KERNELS, which="address"), seed=seed).faults
        for seed in SEEDS
    ]
    return [fault for faults in drawn for of_kernel in faults.values() for fault in of_kernel]


@pytest.fixture(scope="module")
def records(faults):
    return flown(faults)


def test_they_are_faults_in_addresses_that_crash_corrupt_and_are_masked(records):
    assert {kernel["effect"] for _, _, kernel in records} >= {"crash", "sdc", "masked"}
    for _, record, _ in records:
        assert record["activated"] and record["details"]["value_class"] == "address"
        assert record["details"]["replayable"]
    assert any(record["details"]["type"] == "ptr" for _, record, _ in records)


def test_another_environment_heap_and_hash_seed_give_the_same_bytes(faults, records, tmp_path):
    """With random addresses; other folders and CPUs: `tests/core/golden/test_machines.py`."""
    environment = {
        "PYTHONHASHSEED": "99",
        "SOMETHING": "x" * 5_000,
        "PATH": "/usr/bin",
        "LANG": "C",
        "HOME": str(tmp_path),
        "PYTHONPATH": f"{ROOT / 'src'}:{ROOT}",
        "XDG_CACHE_HOME": str(code_folder().parents[1]),
        "OMP_NUM_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", ELSEWHERE],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        input=json.dumps([fault.to_json() for fault in faults]),
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == records
