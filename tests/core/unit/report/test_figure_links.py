"""Each point, box, curve and path of a figure opens exactly the runs that are counted or drawn in it."""

from urllib.parse import parse_qs

import polars as pl
import pytest
from matplotlib.collections import PathCollection, PolyCollection

from mavfi.analysis.listing import with_flights
from mavfi.analysis.runs import Runs
from mavfi.extras.paper import views as v
from mavfi.extras.paper.figures import path_cases
from mavfi.report import figures, links
from tests.core.unit.report.test_figures import golden, runs

ARM = {"setting": "dr_gaussian", "arm": "gaussian", "detector": "gaussian"}


def linked(axes, kind=None):
    """Links of a panel, by kind: points, areas, lines."""
    found = []
    for wanted in (PathCollection, PolyCollection):
        if kind in (None, wanted):
            found += [url for one in axes.collections if isinstance(one, wanted) for url in one.get_urls() if url]
    return found + [line.get_url() for line in axes.lines if kind is None and line.get_url()]


def ids(url):
    """Ids of the runs that a link opens."""
    if url.startswith(links.RUN):
        return [url.removeprefix(links.RUN)]
    return parse_qs(url.removeprefix(links.RUNS))["ids"][0].split()


def opened(urls):
    return sorted(sorted(ids(url)) for url in urls)


def behind(*groups):
    return sorted(sorted(own["run_id"]) for own in groups)


@pytest.fixture(scope="module")
def flown_by_hand():
    """Two environments, an arm, three populations, lost missions, and runs that could not be judged."""
    rows = []
    for environment in ("sparse", "dense"):
        rows += [golden(environment=environment, flight_time_s=38.0 + seed) for seed in range(3)]
        rows.append(golden(environment=environment, setting="golden_gaussian", arm="gaussian", detector="gaussian"))
        for setting in ({}, ARM):
            for place, target in enumerate(("waypoint", "cloud", "waypoint", "cloud", "waypoint")):
                common = {
                    "environment": environment,
                    "target": target,
                    "state": f"planning.{target}",
                    **setting,
                    "flight_time_s": 40.0 + place,
                    "inflation": 0.01 * place if place != 1 else None,
                    "success": place != 1,
                    "index": place,
                }
                rows.append(common)
                rows.append({**common, "population": "mantissa", "bit_class": "mantissa", "index": 10 + place})
            rows.append({"environment": environment, "judged": False, "success": False, **setting})
    return runs(*rows)


@pytest.fixture(scope="module")
def instructions_by_hand():
    rows = [golden(flight_time_s=38.0)]
    for place, kernel in enumerate(("pid", "octomap", "pid")):
        common = {
            "level": "instruction",
            "population": "all_bits",
            "kernel": kernel,
            "flight_time_s": 40.0 + place,
            "success": place != 2,
        }
        rows += [common, {**common, **ARM}]
    return runs(*rows)


def test_points_of_success_open_the_missions_of_the_rate(flown_by_hand):
    judged = flown_by_hand.where("judged", pl.col("population").is_in(["all", "sign_exponent"]))
    judged = judged.where(pl.col("setting") != "golden_gaussian")
    [axes] = figures.figure(flown_by_hand, "success").axes
    assert opened(linked(axes)) == behind(*judged.groups("environment", "setting").values())


def test_curves_of_flight_time_open_all_missions_of_which_they_show_the_share(flown_by_hand):
    panels = figures.figure(flown_by_hand, "flight_time").axes
    for axes, environment in zip(panels, ("sparse", "dense"), strict=True):
        own = flown_by_hand.injected.where("judged", environment=environment, population="sign_exponent")
        assert opened(linked(axes)) == behind(*own.groups("setting").values())
        assert axes.get_title(loc="left") == f"{environment}, n = {len(ids(linked(axes)[0]))}"


@pytest.mark.parametrize(
    ("name", "select", "column"),
    [("kernels", v.by_kernel, "kernel"), ("states", v.by_state, "target"), ("bit_fields", v.by_bits, "bits")],
)
def test_rows_open_their_missions_and_boxes_those_that_succeed(
    flown_by_hand, instructions_by_hand, name, select, column
):
    own = instructions_by_hand if name == "kernels" else flown_by_hand
    shown = select(own)
    panels = figures.figure(own, name).axes
    for times, success, environment in zip(panels[::2], panels[1::2], shown.values("environment"), strict=True):
        groups = shown.where(environment=environment).groups(column).values()
        assert opened(linked(success)) == behind(*groups)
        assert opened(linked(times)) == behind(*(part.where("success") for part in groups))
        counts = [int(label.get_text().rpartition("= ")[2].rstrip(")")) for label in times.get_yticklabels()]
        assert sorted(counts) == sorted(len(ids(url)) for url in linked(success))


@pytest.mark.parametrize("name", ["states", "bit_fields", "flight_time_distribution"])
def test_dots_name_their_runs_in_order(flown_by_hand, name):
    times = dict(zip(flown_by_hand["run_id"], flown_by_hand["flight_time_s"], strict=True))
    upright = name == "flight_time_distribution"
    drawn = [
        line
        for axes in figures.figure(flown_by_hand, name).axes
        for line in axes.lines
        if (line.get_gid() or "").startswith(links.DOTS)
    ]
    assert drawn
    for line in drawn:
        named = line.get_gid().removeprefix(links.DOTS).split()
        assert list(line.get_ydata() if upright else line.get_xdata()) == [times[run_id] for run_id in named]


def test_each_path_opens_its_run(flown):
    own = Runs.read(flown)
    own = with_flights(own, flown, figures.drawing("trajectories").cases(own))
    panels = figures.figure(own, "trajectories").axes
    for place, case in enumerate(path_cases(own)):
        drawn = [run_id for run_id in (case.golden, case.fault, case.recovered) if run_id]
        for axes in panels[2 * place : 2 * place + 2]:
            assert linked(axes) == [f"#run/{run_id}" for run_id in drawn]
