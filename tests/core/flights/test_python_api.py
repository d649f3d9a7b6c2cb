"""The page of the Python API, and the study in `examples`."""

import re
import runpy

import pytest

import mavfi
from tools.build_notebook import PAGE
from tools.markers import ROOT


def test_names_of_the_page_are_public():
    named = set(re.findall(r"\bmavfi\.(\w+)", PAGE.read_text(encoding="utf-8")))
    assert named <= set(dir(mavfi))


@pytest.mark.slow
def test_the_study_prints_its_table_and_draws_its_figure(tmp_path, capsys):
    study = runpy.run_path(str(ROOT / "examples" / "waypoint_study.py"))
    study["main"](str(tmp_path / "study"))
    shown = capsys.readouterr().out
    assert "dr_gaussian" in shown and "success_low" in shown
    assert (tmp_path / "study" / "success.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_figure_that_is_not_there_is_refused(tmp_path):
    runs = mavfi.run(mavfi.Campaign(name="one", environments=("sparse",), missions=1, faults=1, null_runs=0), tmp_path)
    with pytest.raises(mavfi.BadInputError, match="figure 'success': these runs have nothing to show"):
        mavfi.figure(runs.where(setting="golden"), "success")
    with pytest.raises(mavfi.BadInputError, match="figure 'map': not known; allowed: success, flight_time, kernels"):
        mavfi.figure(runs, "map")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"detector": 3}, "^detector builtins:int: allowed: an object whose class inherits mavfi.Detector$"),
        ({"fault_seed": 3}, "^fault_seed: 3: no fault to draw; allowed: with the text of a fault$"),
    ],
)
def test_what_cannot_be_flown_is_one_line(arguments, message):
    with pytest.raises(mavfi.BadInputError, match=message):
        mavfi.fly(environment="sparse", **arguments)
