"""`mavfi docs`: a page by name, or what to do."""

import pytest

from mavfi.cli import docs, run


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A site of three pages, one of which shows a file of the repository."""
    for name in ("index", "concepts/fault-model", "files/src/fault-model"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / f"{name}.html").write_text('<h2 id="tutorials">', encoding="utf-8")
    monkeypatch.setattr(docs, "SITE", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "address"),
    [
        ([], "index.html"),
        (["tutorials"], "index.html#tutorials"),
        (["fault-model"], "concepts/fault-model.html"),
        (["concepts/fault-model"], "concepts/fault-model.html"),
    ],
)
def test_a_page_is_opened_by_its_name(site, capsys, monkeypatch, arguments, address):
    opened = []
    monkeypatch.setattr(docs.webbrowser, "open", lambda url: not opened.append(url))
    assert run(["docs", *arguments]) == 0 and opened == [f"{site.as_uri()}/{address}"]
    assert run(["docs", *arguments, "--path"]) == 0 and len(opened) == 1
    assert capsys.readouterr().out == f"{opened[0]}\n"


def test_a_page_that_is_not_there_is_one_line(site, capsys):
    assert run(["docs", "falt-model"]) == 2
    assert "page 'falt-model': not known (did you mean 'fault-model'?)" in capsys.readouterr().err
    (site / "index.html").unlink()
    assert run(["docs"]) == 2
    error = capsys.readouterr().err
    assert f"{site}: the pages are not built; read " in error and "docs/README.md, or build them" in error
