"""Where compiled code is kept: one file for each signature, no index."""

import os

import numba
import numpy as np
import pytest

from mavfi.numerics import jit
from mavfi.numerics.jit import SignatureFiles, entry, kernel_jit


class Index:
    """What Numba hands over: where, of what source."""

    def __init__(self, folder, stamp):
        self._cache_path, self._index_name, self._source_stamp = str(folder), "module.name-1.py311.nbi", stamp


@pytest.fixture
def files(tmp_path):
    return SignatureFiles.in_place_of(Index(tmp_path, "source"))


def test_what_was_saved_is_loaded(files):
    files.save(("int64", "cpu"), b"code")
    files.save(("float64", "cpu"), b"other")
    assert files.load(("int64", "cpu")) == b"code"
    assert files.load(("float64", "cpu")) == b"other"
    assert files.load(("int32", "cpu")) is None


def test_saving_one_signature_leaves_the_files_of_the_others(files, tmp_path):
    files.save("one", b"code")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    files.save("two", b"code")
    assert all(path.read_bytes() == content for path, content in before.items())
    assert len(list(tmp_path.iterdir())) == 2


def test_code_of_another_source_or_version_is_not_loaded_but_replaced(files, tmp_path, monkeypatch):
    files.save("key", b"code")
    newer = SignatureFiles.in_place_of(Index(tmp_path, "changed source"))
    assert newer.load("key") is None
    newer.save("key", b"newer")
    assert newer.load("key") == b"newer"
    assert files.load("key") is None
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr(newer, "_version", "0.0")
    assert newer.load("key") is None


def test_another_key_in_the_same_file_is_not_taken_for_it(files, monkeypatch):
    monkeypatch.setattr(SignatureFiles, "_name", lambda self, key: "same")
    files.save("one", b"code")
    assert files.load("two") is None


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_kernels_are_kept_that_way():
    @kernel_jit
    def doubled(values):
        return 2.0 * values[0]

    assert doubled(np.ones(1)) == 2.0
    assert isinstance(doubled._cache._cache_file, SignatureFiles)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_function_is_compiled_once_for_literals_and_integers_of_any_size():
    @kernel_jit
    def callee(number, flag):
        return 2 * number if flag else number

    @kernel_jit
    def caller(values, small):
        return callee(3, True) + callee(values[0], values[0] > 1) + callee(small[0], False)

    assert caller(np.array([4]), np.array([5], np.int32)) == 6 + 8 + 5
    assert [str(signature) for signature in callee.signatures] == ["(int64, bool)"]


def test_a_user_without_a_home_has_a_folder_that_no_other_can_write(monkeypatch, tmp_path):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(jit.Path, "home", no_home)
    monkeypatch.setattr(jit.tempfile, "gettempdir", lambda: str(tmp_path))
    own = tmp_path / f"mavfi-{os.getuid()}"
    assert jit._cache_root() == own and own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)
    assert not jit._cache_root().exists()
    own.rmdir()
    own.symlink_to(tmp_path)
    assert not jit._cache_root().exists()


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
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


def test_the_entry_of_a_plain_function_is_that():
    def plain(value):
        return value

    assert entry(plain, 3) is plain
