import pytest
from examples.pictures import drawing

from tests.core.flights.missions import golden, mission


@pytest.fixture(scope="module")
def recorded():
    scenario = mission()
    return scenario, *drawing.record(scenario)


def test_recording_changes_nothing(recorded):
    assert recorded[1].log.digest() == golden().log.digest()


def test_pictures_of_the_pages_are_small_and_shown():
    pages = "".join(page.read_text(encoding="utf-8") for page in drawing.FOLDER.glob("*.md"))
    pictures = list(drawing.FOLDER.glob("*.png"))
    assert pictures
    assert [p.name for p in pictures if f"({p.name})" not in pages or p.stat().st_size > drawing.LARGEST_FILE] == []
