"""Figures of the paper on runs made by hand, and Fig. 7 on flights that were flown."""

import polars as pl
import pytest

from mavfi.analysis.listing import with_flights
from mavfi.analysis.runs import Runs
from mavfi.errors import BadInputError
from mavfi.extras.paper.figures import path_cases
from mavfi.report import figures
from tests.core.unit.report.test_figures import golden, runs


def texts(axes):
    return [label.get_text() for label in axes.get_yticklabels()]


def instruction(kernel, **row):
    return {"level": "instruction", "population": "all_bits", "kernel": kernel, "flight_time_s": 40.0, **row}


@pytest.mark.parametrize("name", ["kernels", "states", "bit_fields", "flight_time_distribution", "trajectories"])
def test_nothing_to_show_is_no_figure(name):
    with pytest.raises(BadInputError, match=f"figure '{name}': these runs have nothing to show in it"):
        figures.figure(runs(golden()), name)


def test_figures_that_are_not_known_are_refused():
    with pytest.raises(BadInputError, match="figure 'none': not known; allowed: success, flight_time, kernels"):
        figures.figure(runs(), "none")


@pytest.mark.slow
@pytest.mark.long
def test_paths_are_drawn_from_flights_that_the_caller_has_flown_again(flown, tmp_path):
    campaign_runs = Runs.read(flown)
    drawing = figures.drawing("trajectories")
    assert drawing.draw(campaign_runs) is None, "nothing is flown to draw"
    wanted = drawing.cases(campaign_runs)
    again = with_flights(campaign_runs, flown, wanted)
    assert set(again.flights) == set(wanted) and len(path_cases(campaign_runs)) == 2
    for run_id, flight in again.flights.items():
        assert (
            flight.log.digest()
            == campaign_runs.frame.row(by_predicate=pl.col("run_id") == run_id, named=True)["digest"]
        )
    made = figures.figure(again, "trajectories")
    assert len(made.axes) == 4, "from above and in 3-D, perception and planning"
    for index, case in enumerate(path_cases(campaign_runs)):
        path = again.flights[case.fault].log.columns("x", "y")
        line = made.axes[2 * index].lines[1]
        assert line.get_xdata().tolist() == path[:, 0].tolist()
    [file] = figures.draw(again, tmp_path, ["trajectories"], "tiny_")
    assert file == "tiny_trajectories.png" and (tmp_path / file).stat().st_size > 50_000
