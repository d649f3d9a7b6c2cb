import pytest

from tools.markers import between, fill

EMPTY = "above\n<!-- table:begin -->\n<!-- table:end -->\nbelow\n"


def test_a_block_replaces_the_one_before():
    filled = between(EMPTY, "table", "| a |\n")
    assert filled == "above\n<!-- table:begin -->\n| a |\n<!-- table:end -->\nbelow\n"
    assert between(filled, "table", "") == between(EMPTY, "table", "")


@pytest.mark.parametrize("page", ["", "<!-- table:end --> <!-- table:begin -->", "<!-- table:begin -->"])
def test_a_page_without_its_markers_is_refused(page):
    with pytest.raises(ValueError, match="once each"):
        between(page, "table", "| a |")


def test_a_page_is_written_whole_or_not_at_all(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(EMPTY, encoding="utf-8")
    with pytest.raises(ValueError, match=r"page\.md: must hold <!-- other:begin -->"):
        fill(page, {"table": "| a |", "other": ""})
    assert page.read_text(encoding="utf-8") == EMPTY
