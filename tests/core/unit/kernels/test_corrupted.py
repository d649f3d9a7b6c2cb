import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.core.unit.kernels.cases import CASES, corrupted

ROOT = Path(__file__).parents[4]
LONGEST_CALL = 5.0
"""Of one kernel (s): a guard against hanging, not a measurement."""


@pytest.mark.parametrize("name", CASES)
def test_sound_arguments_give_a_sound_result(name):
    case = CASES[name]
    arguments = case.arguments()
    assert case.sound(case.function(*arguments), arguments)


@pytest.mark.parametrize("name", CASES)
def test_corrupted_numbers_never_hang_a_kernel_and_give_the_same_defined_result_twice(name):
    case = CASES[name]
    case.function(*case.arguments())
    for (label, arguments), (_, again) in zip(corrupted(case), corrupted(case), strict=True):
        start = time.process_time()
        result = case.function(*arguments)
        assert time.process_time() - start < LONGEST_CALL, label
        assert case.sound(result, arguments), f"{label}: {result}"
        assert repr(case.function(*again)) == repr(result), label
        for first, second in zip(arguments, again, strict=True):
            if hasattr(first, "tobytes"):
                assert first.tobytes() == second.tobytes(), label


@pytest.mark.slow
@pytest.mark.long
def test_corrupted_numbers_never_lead_out_of_bounds(request):
    cache = request.config.cache.mkdir("numba_boundscheck")
    path = os.pathsep.join((str(ROOT / "src"), str(ROOT)))
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-m", "tests.core.unit.kernels.cases"],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 1000
