"""`make nightly ONLY=nojit` among the tests."""

import pytest

from tests.nightly import nojit


@pytest.mark.slow
@pytest.mark.long
def test_kernels_pass_their_tests_as_plain_python():
    assert nojit.main() >= nojit.LEAST


def test_a_compiler_that_is_not_switched_off_is_noticed(monkeypatch):
    assert nojit.run("-c", nojit.CANARY)[0] == 0
    assert nojit.run("-c", "import os; del os.environ['NUMBA_DISABLE_JIT']; " + nojit.CANARY)[0] == 1
