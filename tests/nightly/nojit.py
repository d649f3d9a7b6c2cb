"""The tests of kernels and numerics once more, as plain Python: what numba compiles is what is written.

    python -m tests.nightly.nojit

Numba is switched off (NUMBA_DISABLE_JIT=1).  Machine words then warn where they wrap around, which compiled code does
in silence, so such warnings are no errors here.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
CHOSEN = (
    "tests/core/unit/numerics",
    "tests/core/unit/detectors/test_acceptance.py",
    "tests/core/unit/detectors/test_estimates.py",
    "tests/core/unit/pipeline/test_control.py",
    "tests/core/unit/sim/test_contact.py",
    "tests/core/reference/kernels",
    "tests/core/reference/planning/test_twins.py",
    "tests/core/reference/planning/test_nearest.py",
    "tests/core/reference/octomap/test_octree.py",
    "tests/core/reference/detectors",
    "tests/core/reference/sim/test_clearance.py",
    "tests/core/properties/test_bits.py",
    "tests/core/properties/test_voxels.py",
)
LEAST = 100
"""Tests that must pass; fewer means that some are no longer found."""
CANARY = "from mavfi.numerics.bits import sign_field; raise SystemExit(hasattr(sign_field, 'py_func'))"
"""A compiled function has its plain twin as an attribute."""


def run(*arguments):
    """A Python of its own without the compiler; its exit code and what it wrote."""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=environment, check=False, text=True, stdout=subprocess.PIPE)
    return done.returncode, done.stdout


def main():
    """Run the tests; answers how many passed, and raises SystemExit if one did not or if they are too few."""
    if run("-c", CANARY)[0] != 0:
        raise SystemExit("the compiler is not switched off")
    code, text = run("-m", "pytest", "-q", "-m", "not slow", "-W", "ignore::RuntimeWarning", *CHOSEN)
    match = re.search(r"(\d+) passed", text)
    passed = int(match[1]) if match else 0
    if code != 0 or passed < LEAST:
        raise SystemExit(f"{text}\n{passed} passed without the compiler; wanted: {LEAST} at least, and none that fails")
    return passed


if __name__ == "__main__":
    sys.stdout.write(f"{main()} tests passed without the compiler\n")
