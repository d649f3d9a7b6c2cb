"""The same bits on every x86-64 machine, whatever the C library, NumPy, BLAS and the compiler pick for a CPU."""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from mavfi.numerics.portable import BASELINE
from tests.core.architecture.source import ROOT

FLIGHTS = """
import importlib.util
import json
import sys
import mavfi
from pathlib import Path
from mavfi.extras.airsim.boundary import Boundary
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.airsim.host import run_program
from mavfi.levels.instruction import draw_instruction_faults
from mavfi.campaign.store import Store
from mavfi.levels.instruction import InstructionRequest
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec

folder, workers, program, size = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
flights = (
    {"environment": "sparse", "seed": 7, "fault": "state:control.command.vx:bit=62", "detector": "autoencoder",
     "profile": "tuned"},
    {"environment": "dense", "seed": 6, "fault": "state:planning.trajectory.y:bit=62", "fault_seed": 6},
    {"environment": "factory", "seed": 0, "autopilot": "hardened", "planner": "rrt_star", "wind": 2.0,
     "localization": "estimator"},
)
for flight in flights:
    result = mavfi.fly(**flight)
    print(result.status.label, result.log.digest())

mission = resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))
kernels = ("pid", "octomap", "rrt_connect", "point_cloud", "collision_check")
if size == "small":
    kernels = kernels[:2]
for which in ("address", "control", "data"):
    drawn = draw_instruction_faults(mission, InstructionRequest(dict.fromkeys(kernels, 3), which=which), seed=1)
    for flight in fly_instruction_faults(mission, sum(drawn.faults.values(), []), golden=drawn.golden).flights:
        injection = json.dumps(flight.log.injections[0].to_json(), sort_keys=True)
        print(flight.log.kernel.effect, flight.log.kernel.detail, flight.log.digest(), injection)

if size == "small":
    sys.exit()

instructions = mavfi.Campaign(
    name="instructions", environments=("sparse",), missions=2, faults=4,
    sampling={"level": "instruction", "kernels": list(kernels[:2])},
    arms={"watched": {"detector": "autoencoder", "profile": "tuned"}},
)
for campaign in (instructions, "smoke"):
    place = f"{folder}/{campaign if isinstance(campaign, str) else campaign.name}"
    mavfi.run(campaign, place, workers=workers)
    with Store.open(Path(place)) as store:
        print(place.rpartition("/")[2], store.complete, store.digest())

if importlib.util.find_spec("cosysairsim"):
    ended = run_program(ProgramConfig(script=program), MissionSpec(environment="sparse", seed=7), Boundary())
    print(ended.how, ended.digest, repr(ended.output))
"""
"""Every function below a digest is called by one of the flights.  Then faults in instructions, with the values before
and after, among them addresses; then campaigns, and a client program of AirSim with what it saw."""
PROGRAM = ROOT / "tests" / "extras" / "airsim" / "programs" / "everything.py"
CAMPAIGNS = slice(3 + 3 * 5 * 3, 3 + 3 * 5 * 3 + 2)
"""Lines of campaigns, after those of flights and faults."""
OLDER_CODE = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
ELSEWHERE = {"LANG": "C", "LC_ALL": "C", "PATH": "/usr/bin:/bin", "TZ": "Asia/Kathmandu", "PYTHONHASHSEED": "1"}
MACHINES = {
    "C library without FMA": {"GLIBC_TUNABLES": BASELINE["GLIBC_TUNABLES"]},
    "C library without AVX-512": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512DQ"},
    "BLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS for Skylake-X": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "older libraries": BASELINE,
    "elsewhere": ELSEWHERE,
    "all of it, and code for any x86-64": {**BASELINE, **OLDER_CODE, **ELSEWHERE},
}
LAST = list(MACHINES)[-1]
PYTHONS = os.environ.get("MAVFI_PYTHONS", "").split()


SEVERAL_TYPES = {"mavfi.numerics.stored._put"}
"""Functions that are compiled for each kind of values, see `mavfi.numerics.stored`."""


def ends_and_digests(machine: dict[str, str], folder: Path, workers: int = 1, size: str = "full") -> list[str]:
    """Of flights and campaigns, in a process that thinks it runs on another machine."""
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FLIGHTS, str(folder), str(workers), str(PROGRAM), size],
        env={**os.environ, **machine},
        capture_output=True,
        text=True,
        timeout=1800,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    return ends_and_digests({}, tmp_path_factory.mktemp("here"))


@pytest.mark.long
def test_a_small_part_has_the_same_bits_with_older_libraries_elsewhere(tmp_path):
    """The night flies all of it, see below."""
    here = ends_and_digests({}, tmp_path / "here", size="small")
    assert [line.split()[0] for line in here[:3]] == ["success", "collision", "success"]
    assert len(here) == 3 + 2 * 3 * 3
    assert ends_and_digests({**BASELINE, **ELSEWHERE}, tmp_path / "there", size="small") == here


@pytest.mark.machines
def test_they_have_all_effects(here):
    assert [line.split()[0] for line in here[:3]] == ["success", "collision", "success"]
    assert {line.split()[0] for line in here[3 : CAMPAIGNS.start]} >= {"masked", "sdc", "crash"}
    assert [line.split()[:2] for line in here[CAMPAIGNS]] == [["instructions", "True"], ["smoke", "True"]]
    assert [line.split()[0] for line in here[CAMPAIGNS.stop :]] == ["ended"] * (find_spec("cosysairsim") is not None)


@pytest.mark.machines
@pytest.mark.parametrize("name", [name for name in MACHINES if name != LAST])
def test_they_have_the_same_bits(name, here, tmp_path):
    assert ends_and_digests(MACHINES[name], tmp_path) == here


@pytest.mark.machines
def test_they_have_the_same_bits_in_another_folder_with_an_empty_cache_and_two_workers(here, tmp_path):
    """Each function is compiled once, for the oldest machine."""
    there = tmp_path / "another-folder-with-a-long-name" / "of-packages"
    for folder in ("src", "configs"):
        shutil.copytree(ROOT / folder, there / folder, ignore=shutil.ignore_patterns("__pycache__"))
    place = {"PYTHONPATH": str(there / "src"), "XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    assert ends_and_digests({**MACHINES[LAST], **place}, tmp_path / "out", workers=2) == here
    compiled = [path.name.partition("-")[0] for path in (tmp_path / "cache").rglob("*.nbc")]
    assert len(compiled) > 100
    assert {name for name in compiled if compiled.count(name) > 1} <= SEVERAL_TYPES


@pytest.mark.machines
@pytest.mark.skipif(not PYTHONS, reason="MAVFI_PYTHONS: no other interpreters with mavfi are named")
def test_every_python_gives_the_same_ledger(tmp_path):
    """Of faults in states; the space of faults in instructions depends on Python's bytecode, and its version is stored.

    MAVFI_PYTHONS="py312/bin/python py313/bin/python" python -m pytest -m machines tests/core/golden/test_machines.py
    """
    digests = {}
    for number, python in enumerate([sys.executable, *PYTHONS]):
        place = str(tmp_path / str(number))
        for command in (["run", "smoke", "--out", place], ["digest", place]):
            result = subprocess.run(
                [python, "-m", "mavfi", "campaign", *command], capture_output=True, text=True, timeout=900
            )
            assert result.returncode == 0, result.stderr
        digests[python] = result.stdout.split()[-1]
    assert len(set(digests.values())) == 1, digests
