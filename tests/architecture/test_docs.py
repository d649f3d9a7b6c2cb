"""The documentation keeps up with the code."""

import re
from pathlib import Path

import pytest

from docs import build_pages
from tests.architecture.source import ROOT, modules

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
DOCS = ROOT / "docs"


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("page", ["whats-here.md", "fault-model.md", "ros.md"])
def test_written_pages_say_what_the_code_says(page):
    assert text(DOCS / page) == build_pages.pages()[DOCS / page], "run `make docs`"


def test_whats_here_has_a_line_for_every_module():
    named = set(re.findall(r"^- `([\w/]+\.py)` — \S", build_pages.whats_here(), flags=re.MULTILINE))
    assert named == {name for name in modules() if not name.endswith("__init__.py")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", text(page))
    local = [target for target in targets if "://" not in target]
    assert [target for target in local if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_make_targets_that_are_named_exist(page):
    targets = set(re.findall(r"^([a-z-]+):", text(ROOT / "Makefile"), flags=re.MULTILINE))
    named = set(re.findall(r"`make ([a-z-]+)", text(page))) | set(
        re.findall(r"^ *make ([a-z-]+)", text(page), re.MULTILINE)
    )
    assert named - targets == set()


def test_decisions_are_numbered_without_gaps_and_say_their_status():
    records = sorted((DOCS / "adr").glob("*.md"))
    assert [int(record.name[:4]) for record in records] == list(range(1, len(records) + 1))
    for record in records:
        assert "Status:" in text(record) and "## Consequences" in text(record), record.name


def test_a_block_replaces_the_one_before():
    page = "above\n<!-- table:begin -->\n<!-- table:end -->\nbelow\n"
    filled = build_pages.between(page, "table", "| a |\n")
    assert filled == "above\n<!-- table:begin -->\n| a |\n<!-- table:end -->\nbelow\n"
    assert build_pages.between(filled, "table", "") == build_pages.between(page, "table", "")


def test_the_readme_has_one_place_for_the_table():
    assert "| a |" in build_pages.between(text(ROOT / "README.md"), "table", "| a |")


@pytest.mark.parametrize("page", ["", "<!-- table:end --> <!-- table:begin -->", "<!-- table:begin -->"])
def test_a_page_without_its_markers_is_refused(page):
    with pytest.raises(ValueError, match="once each"):
        build_pages.between(page, "table", "| a |")
