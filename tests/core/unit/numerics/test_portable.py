"""Libraries that choose code by the processor choose the same in `call_portably`, whatever the caller has chosen."""

import os

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from mavfi.errors import MachineError
from mavfi.numerics.portable import call_portably


def chosen(matrix):
    """The code of the BLAS, the dispatched features of NumPy, and a product that the BLAS has computed."""
    product = matrix @ matrix
    from numpy._core._multiarray_umath import __cpu_features__ as features

    blas = {info["architecture"] for info in threadpool_info() if info["internal_api"] == "openblas"}
    return blas, features["X86_V3"], os.environ["GLIBC_TUNABLES"], product


def fails():
    raise ValueError("too few samples")


@pytest.mark.parametrize("outside", ["Haswell", "SkylakeX"])
def test_the_oldest_code_is_taken_whatever_the_caller_has(monkeypatch, outside):
    monkeypatch.setenv("OPENBLAS_CORETYPE", outside)
    matrix = np.random.default_rng(1).normal(size=(40, 40))
    blas, newer, libc, product = call_portably(chosen, matrix)
    assert blas == {"Nehalem"} and not newer and "-FMA" in libc
    assert np.abs(product - matrix @ matrix).max() < 1e-12


def test_a_process_that_fails_says_why():
    with pytest.raises(MachineError, match="fails: its process failed .*too few samples"):
        call_portably(fails)
