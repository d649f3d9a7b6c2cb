"""A page keeps the tables of other processors."""

from tools import processors
from tools.markers import between


def test_the_own_table_is_replaced_and_those_of_others_stay(monkeypatch):
    page = "before\n<!-- cost:begin -->\n<!-- cost:end -->\nafter\n"
    for processor, value in (("one", 1), ("two", 2), ("two B", 3), ("one", 4)):
        monkeypatch.setattr(processors, "processor", lambda processor=processor: processor)
        table = f"text {value}\n\n| a |\n|---|\n| {value} |"
        page = between(page, "cost", processors.with_others(table, page, "cost"))
    blocks = page.removeprefix("before\n<!-- cost:begin -->\n").removesuffix("\n<!-- cost:end -->\nafter\n").split("**")
    assert blocks[1::2] == ["one", "two B", "two"]
    for block, value in zip(blocks[2::2], (4, 3, 2), strict=True):
        assert block.strip() == f"text {value}\n\n| a |\n|---|\n| {value} |"
    assert "1" not in page
