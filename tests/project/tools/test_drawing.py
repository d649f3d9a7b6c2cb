import numpy as np
import pytest
from examples.pictures import drawing

from tests.core.flights.missions import golden, mission


@pytest.fixture(scope="module")
def recorded():
    scenario = mission()
    return scenario, *drawing.record(scenario)


def test_recording_changes_nothing(recorded):
    assert recorded[1].log.digest() == golden().log.digest()


def test_the_planner_is_stepped_again_as_it_was(recorded):
    scenario, flight, tape = recorded
    paths = [(time_us, state) for time_us, state in tape if state.spec.name == "planning.path"]
    planner, path, time_us = drawing.planner_at(scenario, flight, tape, len(paths))
    assert len(paths) > 1 and time_us == paths[-1][0] and path.same_bits(paths[-1][1])
    np.testing.assert_array_equal(
        planner.clearance_map.cells, drawing.clearance_map_at(scenario, flight, tape, time_us).cells
    )


def test_what_did_not_happen_is_refused(recorded):
    scenario, flight, tape = recorded
    with pytest.raises(ValueError, match="plans, not 99"):
        drawing.planner_at(scenario, flight, tape, 99)
    other = scenario.model_copy(update={"seed": 2})
    with pytest.raises(ValueError, match="not that of the flight"):
        drawing.planner_at(other, flight, tape, 99)


def test_pictures_of_the_pages_are_small_and_shown():
    pages = "".join(page.read_text(encoding="utf-8") for page in drawing.FOLDER.glob("*.md"))
    pictures = list(drawing.FOLDER.glob("*.png"))
    assert len(pictures) >= 9
    assert [p.name for p in pictures if f"({p.name})" not in pages or p.stat().st_size > drawing.LARGEST_FILE] == []
