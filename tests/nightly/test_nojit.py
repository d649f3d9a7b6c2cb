"""`make nightly ONLY=nojit` among the tests."""

import pytest

from tests.nightly import nojit


@pytest.mark.slow
@pytest.mark.long
def test_kernels_pass_their_tests_as_plain_python():
    assert nojit.main() >= nojit.LEAST


def test_the_canary_tells_compiled_code_from_plain(monkeypatch):
    assert nojit.run("-c", nojit.CANARY)[0] == 0
    compiled = "import os; del os.environ['NUMBA_DISABLE_JIT']; " + nojit.CANARY
    assert nojit.run("-c", compiled)[0] == 1
    monkeypatch.setattr(nojit, "run", lambda *arguments: (1, ""))
    with pytest.raises(SystemExit, match="not switched off"):
        nojit.main()


@pytest.mark.parametrize(("code", "text"), [(1, "3 failed, 380 passed"), (0, "12 passed"), (0, "no tests ran")])
def test_failing_and_missing_tests_are_noticed(monkeypatch, code, text):
    monkeypatch.setattr(nojit, "run", lambda *arguments: (0, "") if arguments[0] == "-c" else (code, text))
    with pytest.raises(SystemExit, match="passed without the compiler"):
        nojit.main()
