import polars as pl
import pytest

from mavfi.analysis.rows import SCHEMA
from mavfi.analysis.runs import Runs
from mavfi.report import campaign_figures as figures

COMMON = {
    "kind": "injected",
    "setting": "fi",
    "arm": "",
    "detector": "",
    "detector_profile": "",
    "environment": "dense",
    "level": "state",
    "population": "sign_exponent",
    "weight": 1.0,
    "judged": True,
    "success": True,
    "target": "",
    "state": "",
    "kernel": "",
}


def runs(*rows, campaign=None):
    full = [
        {**COMMON, "run_id": f"run-{seed}", "seed": seed, "world": f"dense {seed}", "index": seed, **row}
        for seed, row in enumerate(rows)
    ]
    return Runs(pl.DataFrame(full, schema=SCHEMA), {}, campaign or {"profile": "published"})


def golden(**row):
    return {"kind": "golden", "setting": "golden", "population": "all", "level": "", **row}


@pytest.mark.parametrize(("level", "population"), [("state", "sign_exponent"), ("instruction", "all_bits")])
def test_success_at_every_level_with_counts_the_paper_and_words(level, population):
    rows = [
        golden(),
        golden(),
        {"level": level, "population": population, "success": False},
        {"level": level, "population": population},
        {
            "level": level,
            "population": population,
            "setting": "dr_gaussian",
            "arm": "gaussian",
            "detector": "gaussian",
            "detector_profile": "paper",
        },
    ]
    figure = figures.success(runs(*rows))
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "golden run",
        "fault",
        "fault + gaussian",
        "the paper",
    ]
    figure.draw_without_rendering()
    assert legend.get_window_extent().x1 <= figure.bbox.x1, "whole also with one environment"
    counts = figure.axes[0].get_xticklabels(minor=True)
    assert [text.get_text() for text in counts] == ["2", "2", "1"], "number of missions below each point"


def test_failures_are_censored():
    values = [0.0, 0.5, None, None]
    axes = figures.flight_time(runs(*({"inflation": value, "success": value is not None} for value in values))).axes[0]
    assert axes.lines[0].get_ydata().max() == 0.5
    assert axes.get_title(loc="left") == "dense, n = 4" or axes.get_title() == "dense, n = 4"


def test_the_whole_curve_of_flight_times_is_in_sight():
    axes = figures.flight_time(runs(*({"inflation": value} for value in (-0.17, 0.0, 0.5)))).axes[0]
    left, right = axes.get_xlim()
    assert left < -0.17 and right > 0.5
    assert [axes.xaxis.get_major_formatter()(share, 0) for share in (-0.06, -0.001, 0.0, 0.06)] == [
        "-6 %",
        "0 %",
        "0 %",
        "+6 %",
    ]
