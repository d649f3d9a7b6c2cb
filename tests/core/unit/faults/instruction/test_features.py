"""What the language offers beyond the pipeline's kernels: instrumented with the same results, or refused by name."""

import numpy as np
import pytest
from numba import int64
from numba.typed import Dict, List

from mavfi.faults.levels.instruction import NotInstrumentableError, count, draw, run_forked
from mavfi.faults.levels.instruction.api import digest
from mavfi.faults.levels.instruction.variant import variant_for
from mavfi.numerics.jit import kernel_jit
from tests.core.unit.faults.instruction.kernels import solved


@kernel_jit
def fibonacci(n):
    return n if n < 2 else fibonacci(n - 1) + fibonacci(n - 2)


@kernel_jit
def new_array(n):
    made = np.zeros((n, 2), np.float32)
    made[:, 1] = np.arange(n) * 0.5
    return made


@kernel_jit
def two_results(x, flag):
    return (x + 1.5, not flag, x > 0.0)


@kernel_jit
def complex_product(z):
    return z * z + np.exp(z)


@kernel_jit
def small_integers(values):
    total = np.uint8(0)
    for value in values:
        total = np.uint8(total * np.uint8(3) + value)
    return total


@kernel_jit
def sorted_sum(values):
    ordered = np.sort(values)
    return ordered[0] - ordered[-1] + ordered.sum()


@kernel_jit
def listed(n):
    numbers = List.empty_list(int64)
    for i in range(n):
        numbers.append(i * i)
    return numbers[n // 2] + len(numbers)


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
def text_length(n):
    return len("abc" * n)


@kernel_jit
def strided(values):
    return values[::2].sum() + values.T.sum()


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
    two_results: (0.5, True),
    complex_product: (1.5 + 0.25j,),
    small_integers: (np.arange(40, dtype=np.uint8),),
    sorted_sum: (np.random.default_rng(0).normal(size=70),),
    solved: (MATRIX, np.ones(2)),
    listed: (9,),
    dictionary: (9,),
    vectorised: (np.linspace(0, 1, 50), np.linspace(1, 2, 50)),
    text_length: (3,),
    strided: (np.arange(24.0).reshape(4, 6)[:, ::3],),
    classic: (7,),
}


REPEATED = (two_results, sorted_sum, listed, text_length, strided)
"""More of what others show: results and loops of the pipeline's kernels, of arrays, and of containers with counted
references."""


def marked(kernel):
    marks = [pytest.mark.long] if kernel in REPEATED else []
    return pytest.param(kernel, marks=marks, id=kernel.py_func.__name__)


@pytest.mark.parametrize("kernel", [marked(kernel) for kernel in FEATURES])
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
