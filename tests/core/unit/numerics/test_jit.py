"""Where compiled code is kept: one file for each signature, no index."""

import os

import numba
import numpy as np
import pytest
from numba.core.caching import NullCache

from mavfi.numerics import jit
from mavfi.numerics.jit import entry, in_turns, kernel_jit
from tests.core.unit.faults.instruction.kernels import closure

compiled_only = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of compiled code, empty at first."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "code"))
    return tmp_path / "code"


def calls(factor, value=3.0):
    """The result of a function with a factor that it encloses, and how many signatures came from the cache."""
    function = closure(factor)
    result = function(value)
    return result, sum(function.stats.cache_hits.values())


@compiled_only
def test_code_is_compiled_once_for_a_content_and_a_signature(folder):
    assert calls(2.0) == (6.0, 0)
    first = {path: path.read_bytes() for path in folder.iterdir()}
    assert [path.suffix for path in first] == [".nbc"]
    assert calls(2.0) == (6.0, 1)
    assert calls(5.0) == (15.0, 0)
    assert calls(2.0, 3) == (6.0, 0)
    assert len(list(folder.iterdir())) == 3
    assert all(path.read_bytes() == content for path, content in first.items()), "files of others are left alone"


@compiled_only
def test_of_two_processes_that_need_a_function_one_compiles_it(folder):
    processes = []
    for _ in range(2):
        process = os.fork()
        if process == 0:
            code = -1
            try:
                with in_turns():
                    result, hits = calls(2.0)
                code = hits if result == 6.0 else code
            finally:
                os._exit(code)
        processes.append(process)
    hits = [os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) for process in processes]
    assert sorted(hits) == [0, 1]


@compiled_only
def test_a_damaged_file_is_compiled_again(folder):
    calls(2.0)
    (file,) = folder.iterdir()
    content = file.read_bytes()
    for damaged in (b"", content[:100], b"no code"):
        file.write_bytes(damaged)
        assert calls(2.0) == (6.0, 0)
    assert calls(2.0) == (6.0, 1)


@compiled_only
def test_without_a_folder_nothing_is_kept(folder):
    folder.write_text("a file")
    assert calls(2.0) == calls(2.0) == (6.0, 0)


def test_the_code_that_was_not_used_for_the_longest_time_is_deleted(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "_MOST_BYTES", 250)
    for age, name in enumerate("abcd"):
        (tmp_path / "folder").mkdir(exist_ok=True)
        path = tmp_path / "folder" / f"{name}.nbc"
        path.write_bytes(bytes(100))
        os.utime(path, (1e9 - age, 1e9 - age))
    with (tmp_path / "folder" / "d.nbc").open("rb") as file:
        jit._mark_as_used(file.fileno())
    jit._delete_oldest.__wrapped__(tmp_path)
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == ["a.nbc", "d.nbc"]


@compiled_only
def test_a_function_is_compiled_once_for_literals_and_integers_of_any_size():
    @kernel_jit
    def callee(number, flag):
        return 2 * number if flag else number

    @kernel_jit
    def caller(values, small):
        return callee(3, True) + callee(values[0], values[0] > 1) + callee(small[0], False)

    caller._cache = NullCache()  # an earlier run of this test left its code, and loading it compiles no callee
    assert caller(np.array([4]), np.array([5], np.int32)) == 6 + 8 + 5
    assert [str(signature) for signature in callee.signatures] == ["(int64, bool)"]


def test_a_user_without_a_home_has_a_folder_that_no_other_can_write(monkeypatch, tmp_path):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(jit.Path, "home", no_home)
    monkeypatch.setattr(jit.tempfile, "gettempdir", lambda: str(tmp_path))
    user_folder = tmp_path / f"mavfi-{os.getuid()}"
    assert jit._cache_root() == user_folder and user_folder.stat().st_mode & 0o777 == 0o700
    user_folder.chmod(0o777)
    assert not jit._cache_root().exists()
    user_folder.rmdir()
    user_folder.symlink_to(tmp_path)
    assert not jit._cache_root().exists()


@compiled_only
def test_an_entry_takes_arguments_of_its_types_alone():
    @kernel_jit
    def first(values, add):
        return values[0] + add

    direct = entry(first, np.zeros(3), 0)
    assert direct(np.array([2.0, 9.0]), 5) == 7.0
    with pytest.raises(TypeError):
        direct(np.zeros(3, np.float32), 5)
    with pytest.raises(TypeError):
        direct([2.0], 5)
