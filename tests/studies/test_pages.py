"""Pages of studies are those of their stored rows."""

import shutil
from importlib import import_module

import pytest

from tools import results


@pytest.mark.parametrize("name", ["real_logs", "bug_reports"])
def test_the_published_page_is_that_of_the_stored_rows(name, monkeypatch, tmp_path):
    study = import_module(f"studies.{name}.__main__")
    page = f"{study.PAGE}.md"
    published = (results.RESULTS / page).read_bytes()
    tables = {path.name: path.read_bytes() for path in (results.TABLES / study.PAGE).iterdir()}

    # the study reads and writes a copy
    shutil.copytree(results.TABLES / study.PAGE, tmp_path / "tables" / study.PAGE)
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    monkeypatch.setattr(results, "TABLES", tmp_path / "tables")
    monkeypatch.setattr(study, "ROOT", tmp_path)
    study.main([])
    assert (tmp_path / page).read_bytes() == published
    assert {path.name: path.read_bytes() for path in (tmp_path / "tables" / study.PAGE).iterdir()} == tables
