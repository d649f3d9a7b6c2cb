"""The same bits on every x86-64 machine with AVX2 and FMA, whatever numpy and its BLAS pick for a CPU."""

import json
import os
import subprocess
import sys

import pytest

MACHINES = {
    "as it is": {},
    "BLAS for Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
    "BLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS for Skylake-X": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "numpy without AVX2 and AVX-512": {"NPY_DISABLE_CPU_FEATURES": "X86_V3,X86_V4,AVX512_ICL"},
}


def digest(stack: str, machine: dict[str, str]) -> str:
    """Of a golden flight in a process that thinks it runs on another machine."""
    command = [sys.executable, "-W", "ignore", "-m", "mavfi", "fly", "--environment", "factory", "--seed", "0"]
    result = subprocess.run(
        [*command, "--stack", stack, "--json"], env={**os.environ, **machine}, capture_output=True, text=True,
        timeout=300, check=True,
    )  # fmt: skip
    return str(json.loads(result.stdout)["digest"])


@pytest.mark.slow
@pytest.mark.parametrize("stack", ["hardened", pytest.param("published", marks=pytest.mark.long)])
def test_a_flight_has_the_same_bits_for_every_cpu_that_the_libraries_tell_apart(stack):
    assert len({digest(stack, machine) for machine in MACHINES.values()}) == 1
