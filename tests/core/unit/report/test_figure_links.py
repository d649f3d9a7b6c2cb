"""Each point, box, curve and path of a figure opens exactly the runs that are counted or drawn in it."""

from urllib.parse import parse_qs

import pytest
from matplotlib.collections import PathCollection, PolyCollection

from mavfi.extras.paper import views as v
from mavfi.report import figures, links
from tests.core.unit.report.test_figures import golden, runs

ARM = {"setting": "dr_gaussian", "arm": "gaussian", "detector": "gaussian"}


def linked(axes, kind=None):
    """Links of a panel, by kind: points, areas, lines."""
    urls = []
    for wanted in (PathCollection, PolyCollection):
        if kind in (None, wanted):
            urls += [
                url
                for collection in axes.collections
                if isinstance(collection, wanted)
                for url in collection.get_urls()
                if url
            ]
    return urls + [line.get_url() for line in axes.lines if kind is None and line.get_url()]


def ids(url):
    """Ids of the runs that a link opens."""
    if url.startswith(links.RUN):
        return [url.removeprefix(links.RUN)]
    return parse_qs(url.removeprefix(links.RUNS))["ids"][0].split()


def opened(urls):
    return sorted(sorted(ids(url)) for url in urls)


def behind(*groups):
    return sorted(sorted(group["run_id"]) for group in groups)


@pytest.fixture(scope="module")
def flown_by_hand():
    """Two environments, an arm, three populations, lost missions, and runs that could not be judged."""
    rows = []
    for environment in ("sparse", "dense"):
        rows += [golden(environment=environment, flight_time_s=38.0 + seed) for seed in range(3)]
        rows.append(golden(environment=environment, setting="golden_gaussian", arm="gaussian", detector="gaussian"))
        for setting in ({}, ARM):
            for index, target in enumerate(("waypoint", "cloud", "waypoint", "cloud", "waypoint")):
                common = {
                    "environment": environment,
                    "target": target,
                    "state": f"planning.{target}",
                    **setting,
                    "flight_time_s": 40.0 + index,
                    "inflation": 0.01 * index if index != 1 else None,
                    "success": index != 1,
                    "index": index,
                }
                rows.append(common)
                rows.append({**common, "population": "mantissa", "bit_class": "mantissa", "index": 10 + index})
            rows.append({"environment": environment, "judged": False, "success": False, **setting})
    return runs(*rows)


@pytest.fixture(scope="module")
def instructions_by_hand():
    rows = [golden(flight_time_s=38.0)]
    for index, kernel in enumerate(("pid", "octomap", "pid")):
        common = {
            "level": "instruction",
            "population": "all_bits",
            "kernel": kernel,
            "flight_time_s": 40.0 + index,
            "success": index != 2,
        }
        rows += [common, {**common, **ARM}]
    return runs(*rows)


@pytest.mark.parametrize(
    ("name", "select", "column"),
    [("kernels", v.by_kernel, "kernel"), ("states", v.by_state, "target"), ("bit_fields", v.by_bits, "bits")],
)
def test_rows_open_their_missions_and_boxes_those_that_succeed(
    flown_by_hand, instructions_by_hand, name, select, column
):
    campaign_runs = instructions_by_hand if name == "kernels" else flown_by_hand
    shown = select(campaign_runs)
    panels = figures.figure(campaign_runs, name).axes
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
