import math
import struct
from dataclasses import replace

import pytest

from mavfi.analysis.statistics import Estimate, EventRate, Rate
from mavfi.report import numbers, text
from tests.core.unit.analysis.handmade import ABOUT, GOLDEN, UNKNOWN, flown, golden, injected, null, runs


def test_rate_with_count():
    assert text.rate(Rate(30, 28 / 30, 0.787, 0.982, 28)) == "93.3 [78.7, 98.2] 28/30"
    assert text.rate(Rate(8, 0.5, 0.25, 0.75)) == "50.0 [25.0, 75.0] n=8", "of a weighted rate no count"


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (None, "rate", "—"),
        ("no estimate", "percent with interval", "no estimate"),
        (0.917, "rate", "91.7"),
        (Rate(6, -1 / 6, -0.571, 0.265), "percent with interval", "-16.7 % [-57.1, 26.5]"),
        (Rate(6, 0.1, 0.02, 0.2), "points", "+10.0 [2.0, 20.0]"),
        (EventRate(7, 0.36, 19.3, 5.7, 39.8, 36.2), "per hour", "19.3 [5.7, 39.8]"),
        (21404.7, "number .1f kJ", "21.4 kJ"),
        (0.000488, "number .3g", "0.000488"),
        (0.0000023, "small percent", "0.00023 %"),
        (Rate(9, 0.01, -0.2, 0.22), "number difference", "not shown [-20, 22]"),
        (Rate(9, -0.3, -0.4, -0.05), "number difference", "-30.0 [-40, -5.0]"),
        (Estimate(0.0, 0.0, 6.2e-12), "estimate", "0 [0, 6.2e-12]"),
    ],
)
def test_cells(value, form, shown):
    assert text.cell(value, form) == shown


@pytest.mark.parametrize(
    ("bound", "shown"),
    [(1.0, "100 %"), (0.995, "100 %"), (0.7764, "78 %"), (0.0141, "1.5 %"), (0.00190, "0.19 %"), (0.0, "0 %")],
)
def test_an_upper_bound_is_rounded_up(bound, shown):
    assert numbers.upper_percent(bound) == shown


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        (2.5, 1e300, ("2.5", "1e+300")),
        (2.7495712345, 2.7495712346, ("2.7495712345", "2.7495712346")),
        (0.0, -0.0, ("0", "-0")),
        (1.5, "inf", ("1.5", "inf")),
    ],
)
def test_as_short_as_shows_the_difference(before, after, expected):
    assert numbers.change(before, after) == expected


def test_nans_are_shown_by_their_bits():
    (other,) = struct.unpack(">d", bytes.fromhex("7ff8000000000001"))
    assert numbers.change(math.nan, other) == ("nan (0x7ff8000000000000)", "nan (0x7ff8000000000001)")


def test_null_runs_are_reported_either_way():
    assert text.null_line(runs(golden(1))) == "Null runs: none flown."
    assert text.null_line(runs(golden(1), null(1, GOLDEN))).startswith("Null runs: all 1 with an empty mask")
    broken = runs(golden(1), golden(2), null(1, flown()), null(2, GOLDEN))
    assert "1 of 2 DIFFER" in text.null_line(broken)
    assert broken.null["run_id"][0] in text.null_line(broken)


def test_null_runs_with_other_alarms_differ():
    alarmed = runs(golden(1), null(1, replace(GOLDEN, alarms_total=1)))
    assert "1 of 1 DIFFER" in text.null_line(alarmed)
    assert text.has_failed_checks(alarmed) and not text.has_failed_checks(runs(golden(1), null(1, GOLDEN)))


def test_runs_that_could_not_be_judged_are_named():
    assert text.checks(runs(golden(1))) == ["Null runs: none flown."]
    campaign_runs = runs(golden(1), injected(1, UNKNOWN))
    unknown = f"Unknown: 1 runs could not be judged: {campaign_runs.injected['run_id'][0]}"
    assert text.checks(campaign_runs) == ["Null runs: none flown.", unknown]


def test_a_campaign_that_is_not_complete_or_on_design_seeds_says_so():
    assert not any("Not complete" in line or "design seeds" in line for line in text.header(ABOUT))
    lines = text.header({**ABOUT, "done": 1, "on_design_seeds": True})
    assert any("Not complete" in line for line in lines)
    assert any("design seeds" in line for line in lines)


def test_a_markdown_grid_aligns_numbers_and_escapes_bars():
    assert text.markdown_grid(("a", "n"), [("x|y", "1")], left=1) == "| a | n |\n| --- | ---: |\n| x\\|y | 1 |"
    assert text.markdown_grid(("a", "b"), []) == "| a | b |\n| --- | --- |"
