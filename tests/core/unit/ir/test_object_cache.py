"""Keys and entries of the cache of machine code."""

import pytest

from mavfi.ir import sources as object_cache
from mavfi.ir.sources import ObjectCache


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(object_cache, "code_folder", lambda: tmp_path / "code")
    return ObjectCache("some", tmp_path)


def test_an_entry_is_read_back_until_its_source_changes(cache, tmp_path):
    source = tmp_path / "source.txt"
    source.write_text("one", encoding="utf-8")
    assert cache.load("key") is None
    cache.store("key", b"data", {str(source)})
    assert cache.load("key") == b"data"
    source.write_text("two", encoding="utf-8")
    assert cache.load("key") is None
