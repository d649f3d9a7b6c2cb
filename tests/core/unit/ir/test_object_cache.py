"""Keys and entries of the cache of machine code."""

import numba
import numpy as np
import pytest

from mavfi.ir import sources as object_cache
from mavfi.ir.sources import ObjectCache
from tests.core.unit.faults.instruction.kernels import closure

FLOAT = (numba.float64,)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(object_cache, "code_folder", lambda: tmp_path / "code")
    return ObjectCache("some", tmp_path)


def test_functions_that_differ_in_what_they_enclose_differ_in_their_keys(cache):
    arrays = np.zeros(3), np.ones(3)
    keys = {
        cache.key(closure(factor), FLOAT) for factor in (1.0, 2.0, 2, True, None, *arrays, closure(1.0), closure(2.0))
    }
    assert len(keys) == 9
    assert cache.key(closure(2.0), FLOAT) == cache.key(closure(2.0), FLOAT)
    assert cache.key(closure(2.0), FLOAT) != cache.key(closure(2.0), FLOAT, b"more")


def test_the_text_of_the_package_that_makes_the_code_is_in_the_key(cache, tmp_path):
    before = cache.key(closure(2.0), FLOAT)
    other = tmp_path / "other"
    other.mkdir()
    (other / "maker.py").write_text("1", encoding="utf-8")
    assert ObjectCache("some", other).key(closure(2.0), FLOAT) != before


def test_an_entry_is_read_back_until_its_source_changes(cache, tmp_path):
    source = tmp_path / "source.txt"
    source.write_text("one", encoding="utf-8")
    assert cache.load("key") is None
    cache.store("key", b"data", {str(source)})
    assert cache.load("key") == b"data"
    source.write_text("two", encoding="utf-8")
    assert cache.load("key") is None
