import pytest

from mavfi.campaign.analysis.statistics import EventRate, Rate
from mavfi.campaign.analysis.table import Column, Table
from mavfi.reports import text


def test_rate_with_count():
    assert text.rate(Rate(30, 28 / 30, 0.787, 0.982, 28)) == "93.3 [78.7, 98.2] 28/30"


def test_weighted_rate_has_no_count():
    assert text.rate(Rate(8, 0.5, 0.25, 0.75)) == "50.0 [25.0, 75.0] n=8"


def test_absent_figures():
    nothing = Rate(0, None, None, None, 0)
    assert text.rate(None) == text.rate(nothing) == text.percent(None) == text.number(None) == text.ABSENT


def test_changes_carry_a_sign():
    assert text.signed_percent(0.5) == "+50.0 %"
    assert text.signed_percent(-0.015) == "-1.5 %"


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (None, "rate", "—"), ("undefined", "percent with interval", "undefined"), (0.917, "rate", "91.7 %"),
        (Rate(6, -1 / 6, -0.571, 0.265), "percent with interval", "-16.7 % [-57.1, 26.5]"),
        (Rate(6, 0.1, 0.02, 0.2), "points", "+10.0 [2.0, 20.0]"), (Rate(4, 0.25, 0.1, 0.5, 1), "percent", "25.0 %"),
        (EventRate(7, 0.36, 19.3, 5.7, 39.8, 36.2), "per hour", "19.3 [5.7, 39.8]"), (0.090647, "percent 2", "9.06 %"),
        (21404.7, "number .1f kJ", "21.4 kJ"), (42.89, "number .1f s", "42.9 s"), (0.000488, "number .3g", "0.000488"),
        (12.0, "number g", "12"), (7, "number", "7"), ("fi", "text", "fi"), (0.0000023, "small percent", "0.00023 %"),
        ({"perception": 0.0096, "control": 1e-6}, "small percents", "0.96 % / 0.0001 %"),
    ],
)  # fmt: skip
def test_cells(value, form, shown):
    assert text.cell(value, form) == shown


def test_hidden_columns_are_for_files():
    table = Table("t", "T", (Column("a", "A"), Column("b", "B", hidden=True)), [("x", "y")])
    columns, rows = text.shown(table)
    assert ([column.key for column in columns], rows) == (["a"], [["x"]])
