import math

import numpy as np
import pytest

from mavfi.campaign.divergence import TimedState
from mavfi.report.html.flight_page import LINE_SAMPLES, MOST_LINES, time_lines
from mavfi.report.html.page import AFTER, BEFORE
from mavfi.states import new_state

AT = 5.0
SITE = "planning.waypoint.x"


def waypoints(change=lambda time_s: 0.0, period_us=20_000):
    found = []
    for time_us in range(0, 12_000_000, period_us):
        state = new_state("planning.waypoint")
        state.header["x"], state.header["y"] = 1e-6 * time_us + change(1e-6 * time_us), 2.0
        found.append(TimedState(time_us, state))
    return found


def test_the_injected_field_comes_first_then_what_differs():
    golden, injected = waypoints(), waypoints(lambda time_s: 3.0 if time_s >= AT else 0.0)
    for publication in injected:
        publication.state.header["vz"] = 1.0 if publication.time_us > 5_100_000 else 0.0
    lines = time_lines({"golden": golden, "injected": injected}, AT, SITE)
    assert [line["label"] for line in lines] == ["planning.waypoint.x", "planning.waypoint.vz"]
    assert [line["site"] for line in lines] == [True, False]
    assert lines[0]["unit"] == "m"


@pytest.mark.parametrize("site", ["octomap.insert_scan", "memory:planner.decisions.acted_seq", "xmm0", ""])
def test_of_other_faults_only_what_differs_is_shown(site):
    injected = waypoints(lambda time_s: 3.0 if time_s >= AT else 0.0)
    lines = time_lines({"golden": waypoints(), "injected": injected}, AT, site)
    assert [(line["label"], line["site"]) for line in lines] == [("planning.waypoint.x", False)]


@pytest.mark.parametrize(
    ("wrong", "shown"),
    [
        ("planning.waypoint.y", ["planning.waypoint.y", "planning.waypoint.x"]),
        ("planning.waypoint.elements", ["planning.waypoint.x"]),
        ("planning.waypoint.", ["planning.waypoint.x"]),
    ],
)
def test_the_first_wrong_field_of_an_injected_kernel_comes_first(wrong, shown):
    injected = waypoints(lambda time_s: 3.0 if time_s >= AT else 0.0)
    lines = time_lines({"golden": waypoints(), "injected": injected}, AT, "pid.track", wrong)
    assert [(line["label"], line["site"]) for line in lines] == [(label, False) for label in shown]


def test_an_element_of_a_list_is_followed():
    def trajectories(value):
        state = new_state("planning.trajectory", 3)
        state.elements["x"][2] = value
        return [TimedState(5_000_000, state)]

    published = {"golden": trajectories(1.0), "injected": trajectories(9.0)}
    (line,) = time_lines(published, AT, "planning.trajectory.x[2]")
    assert line["label"] == "planning.trajectory.x[2]" and line["data"]["injected"] == [[5.0], [9.0]]


def test_only_the_surroundings_of_the_fault_are_kept():
    lines = time_lines({"golden": waypoints(), "injected": waypoints()}, AT, SITE)
    times, values = lines[0]["data"]["golden"]
    assert AT - BEFORE - 0.05 < times[0] <= AT - BEFORE and AT + AFTER - 0.05 < times[-1] <= AT + AFTER
    assert values == pytest.approx(times)


def test_a_field_that_is_rarely_published_is_shown_in_the_whole_window():
    def rarely(value):
        return [
            publication
            for publication in waypoints(lambda time_s: value * (time_s >= AT))
            if publication.time_us in (2_000_000, 5_000_000)
        ] + trailing()

    def trailing():
        return [TimedState(time_us, new_state("control.command")) for time_us in (8_000_000, 12_000_000)]

    line = time_lines({"golden": rarely(0.0), "injected": rarely(3.0)[:3]}, AT, SITE)[0]
    assert line["window"] == [AT - BEFORE, AT + AFTER]
    assert line["data"]["golden"] == [[4.0, 5.0, 9.0], [2.0, 5.0, 5.0]]
    assert line["data"]["injected"] == [[4.0, 5.0, 8.0], [2.0, 8.0, 8.0]]  # its flight ends


def test_values_that_are_not_finite_can_be_written_as_json():
    values = {5.0: math.nan, 5.02: math.inf}
    injected = waypoints(lambda time_s: values.get(round(time_s, 3), 0.0))
    _, seen = time_lines({"golden": waypoints(), "injected": injected}, AT, SITE)[0]["data"]["injected"]
    assert None in seen and 1e300 in seen


def test_there_are_never_more_lines_or_samples_than_fit():
    generator = np.random.default_rng(1)
    injected = waypoints(period_us=2000)
    for publication in injected:
        for name in publication.state.header.dtype.names:
            publication.state.header[name] = generator.integers(0, 9)
    lines = time_lines({"golden": waypoints(period_us=2000), "injected": injected}, AT, SITE)
    assert len(lines) == MOST_LINES
    assert len(lines[0]["data"]["golden"][0]) <= LINE_SAMPLES


def test_without_publications_there_is_nothing_to_show():
    assert time_lines({"golden": waypoints(), "injected": []}, AT, SITE) == []
    assert time_lines({"injected": waypoints()}, AT, SITE) == []
