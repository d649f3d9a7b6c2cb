"""The page of recorded flights is that of its stored rows."""

from studies.real_logs.__main__ import EXCERPT, main, stored_tables
from tools import results


def test_the_published_page_is_that_of_the_stored_rows(monkeypatch, tmp_path):
    published = (results.RESULTS / "real-logs.md").read_text(encoding="utf-8")
    tables = stored_tables()
    monkeypatch.setattr("studies.real_logs.__main__.stored_tables", lambda: tables)
    monkeypatch.setattr("studies.real_logs.__main__.ROOT", tmp_path)
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    monkeypatch.setattr(results, "TABLES", tmp_path / "tables")
    main([])
    assert (tmp_path / "real-logs.md").read_text(encoding="utf-8") == published
    assert EXCERPT.markdown(tables["logs"]) in published
