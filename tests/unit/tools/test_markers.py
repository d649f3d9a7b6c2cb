import pytest

from tools.markers import anchors, between, contents, fill

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


def test_sections_that_would_have_the_same_anchor_are_numbered():
    titles = ("The planner RRT*", "The planner RRT", "Depth noise of 2 %")
    assert anchors(titles) == dict(
        zip(titles, ("the-planner-rrt", "the-planner-rrt-1", "depth-noise-of-2-"), strict=True)
    )
    assert contents("Parts", titles[1:]).splitlines() == [
        "Parts:", "", "- [The planner RRT](#the-planner-rrt)", "- [Depth noise of 2 %](#depth-noise-of-2-)",
    ]  # fmt: skip
