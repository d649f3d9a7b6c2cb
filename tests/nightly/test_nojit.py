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


@pytest.mark.parametrize(
    ("canary", "code", "text", "message"),
    [
        (1, 0, "999 passed", "not switched off"),
        (0, 1, "3 failed, 999 passed", "passed without the compiler"),
        (0, 0, "12 passed", "passed without the compiler"),
    ],
)
def test_failing_and_missing_tests_are_noticed(monkeypatch, canary, code, text, message):
    monkeypatch.setattr(nojit, "run", lambda *words: (canary, "") if words[0] == "-c" else (code, text))
    with pytest.raises(SystemExit, match=message):
        nojit.main()
