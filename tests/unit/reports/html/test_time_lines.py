import math

import numpy as np
import pytest

from mavfi.campaign.divergence import Publication
from mavfi.faults.fault import FaultSite, StateFault
from mavfi.reports.html.time_lines import AFTER, BEFORE, MOST, SAMPLES, time_lines
from mavfi.states import new_state

AT = 5.0
FAULT = StateFault(FaultSite("planning.waypoint", "x"), 5_000_000, 62)


def waypoints(change=lambda time_s: 0.0, period_us=20_000):
    found = []
    for time_us in range(0, 12_000_000, period_us):
        state = new_state("planning.waypoint")
        state.header["x"], state.header["y"] = 1e-6 * time_us + change(1e-6 * time_us), 2.0
        found.append(Publication(time_us, state))
    return found


def test_the_injected_field_comes_first_then_what_differs():
    golden, injected = waypoints(), waypoints(lambda time_s: 3.0 if time_s >= AT else 0.0)
    for publication in injected:
        publication.state.header["vz"] = 1.0 if publication.time_us > 5_100_000 else 0.0
    lines = time_lines({"golden": golden, "injected": injected}, AT, FAULT)
    assert [line["label"] for line in lines] == ["planning.waypoint.x", "planning.waypoint.vz"]
    assert [line["site"] for line in lines] == [True, False]
    assert lines[0]["unit"] == "m"


def test_only_the_surroundings_of_the_fault_are_kept():
    lines = time_lines({"golden": waypoints(), "injected": waypoints()}, AT, FAULT)
    times, values = lines[0]["data"]["golden"]
    assert AT - BEFORE - 0.05 < times[0] <= AT - BEFORE and AT + AFTER - 0.05 < times[-1] <= AT + AFTER
    assert values == pytest.approx(times)


def test_values_that_are_not_finite_can_be_written_as_json():
    values = {5.0: math.nan, 5.02: math.inf}
    injected = waypoints(lambda time_s: values.get(round(time_s, 3), 0.0))
    _, seen = time_lines({"golden": waypoints(), "injected": injected}, AT, FAULT)[0]["data"]["injected"]
    assert None in seen and 1e300 in seen


def test_there_are_never_more_lines_or_samples_than_fit():
    generator = np.random.default_rng(1)
    injected = waypoints(period_us=2000)
    for publication in injected:
        for name in publication.state.header.dtype.names:
            publication.state.header[name] = generator.integers(0, 9)
    lines = time_lines({"golden": waypoints(period_us=2000), "injected": injected}, AT, FAULT)
    assert len(lines) == MOST
    assert len(lines[0]["data"]["golden"][0]) <= SAMPLES


def test_without_publications_there_is_nothing_to_show():
    assert time_lines({"golden": waypoints(), "injected": []}, AT, FAULT) == []
    assert time_lines({"injected": waypoints()}, AT, FAULT) == []
