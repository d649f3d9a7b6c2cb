"""What the language offers beyond the pipeline's kernels: instrumented with the same results, or refused by name."""

import numpy as np
import pytest
from numba import int64
from numba.typed import Dict

from mavfi.ir.injection.variant import variant_for
from mavfi.ir.module import NotInstrumentableError
from mavfi.levels.instruction import count, draw, run_forked
from mavfi.levels.instruction.api import digest
from mavfi.numerics.jit import kernel_jit
from tests.core.unit.faults.instruction.kernels import solved
from tests.night import at_night


@kernel_jit
def fibonacci(n):
    return n if n < 2 else fibonacci(n - 1) + fibonacci(n - 2)


@kernel_jit
def new_array(n):
    made = np.zeros((n, 2), np.float32)
    made[:, 1] = np.arange(n) * 0.5
    return made


@kernel_jit
def complex_product(z):
    return z * z + np.exp(z)


@kernel_jit
def dictionary(n):
    squares = Dict.empty(int64, int64)
    for i in range(n):
        squares[i] = i * i
    return squares[n - 1] + len(squares)


@kernel_jit
def vectorised(a, b):
    return np.sqrt(a * a + b * b).sum()


@kernel_jit
def classic(code):
    if code == 1:
        return 10
    if code == 2:
        return 25
    if code == 3:
        return -4
    if code == 7:
        return 77
    return 0


MATRIX = np.array([[3.0, 1.0], [1.0, 2.0]])
FEATURES = {
    fibonacci: (12,),
    new_array: (9,),
    complex_product: (1.5 + 0.25j,),
    solved: (MATRIX, np.ones(2)),
    dictionary: (9,),
    vectorised: (np.linspace(0, 1, 50), np.linspace(1, 2, 50)),
    classic: (7,),
}


@pytest.mark.parametrize(
    "kernel",
    [fibonacci, *at_night(new_array, complex_product, solved, dictionary, vectorised, classic)],
    ids=lambda kernel: kernel.py_func.__name__,
)
def test_results_are_the_same_bits(kernel):
    args = FEATURES[kernel]
    wanted = digest((kernel(*args), args))
    result, total = variant_for(kernel, args).count(*args)
    assert total > 0
    assert digest((result, args)) == wanted


@pytest.mark.slow
@pytest.mark.parametrize("kernel", [fibonacci, vectorised], ids=lambda k: k.py_func.__name__)
def test_faults_are_activated(kernel):
    args = FEATURES[kernel]
    outcomes = [run_forked(kernel, fault, *args) for fault in draw(kernel, 5, *args, seed=2)]
    assert all(outcome.injection.activated for outcome in outcomes)


@kernel_jit
def printing(n):
    print(n)  # noqa: T201
    return n


def test_what_needs_python_is_refused():
    with pytest.raises(NotInstrumentableError, match="printing: cannot be instrumented: "):
        count(printing, 3)
