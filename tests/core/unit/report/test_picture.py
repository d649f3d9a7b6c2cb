import pytest

from mavfi.errors import BadInputError
from mavfi.faults.fault import FaultSite
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.levels.state.fault import StateFault
from mavfi.mission import MissionSpec
from mavfi.record import AlarmRecord
from mavfi.report.picture import draw_flight


@pytest.fixture(scope="module")
def flights():
    scenario = resolve(MissionSpec(environment="dense", seed=7))
    return fly(scenario), fly(scenario, StateFault(FaultSite("planning.waypoint", "y"), 10_000_000, 60))


def texts_of(path):
    """Text of an SVG file whose letters are drawn as shapes: matplotlib names each string in a comment."""
    return path.read_text(encoding="utf-8")


def test_a_flight_with_a_fault_shows_more(flights, tmp_path):
    golden, injected = flights
    assert injected.log.injections[0].activated
    assert draw_flight(tmp_path / "golden.png", golden).read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    alone = texts_of(draw_flight(tmp_path / "alone.svg", golden))
    both = texts_of(draw_flight(tmp_path / "both.svg", injected, golden, golden, detector="gaussian"))
    assert "#d55e00" in both.lower()
    assert "#d55e00" not in alone.lower()
    for label in ("golden run", "with the fault", "with the fault and detector gaussian", "fault"):
        assert f"<!-- {label} -->" in both
    assert "<!-- fault -->" not in alone
    assert f"<!-- flight: goal at {golden.log.column('time')[-1]:.1f} s -->" in alone


def test_a_watched_flight_is_labelled_and_its_alarms_are_marked(flights, tmp_path):
    golden, injected = flights
    at = injected.log.injections[0].time_s
    injected.log.alarms = [AlarmRecord(time_s, "x", "planning.waypoint", "planning") for time_s in (1.0, at)]
    try:
        text = texts_of(draw_flight(tmp_path / "watched.svg", injected, golden, detector="my.module:Mine"))
        for label in ("with the fault and detector my.module:Mine", "alarm at the fault", "other alarm"):
            assert f"<!-- {label} -->" in text
    finally:
        injected.log.alarms = []
    text = texts_of(draw_flight(tmp_path / "golden.svg", golden, detector="gaussian (paper)"))
    assert "<!-- detector gaussian (paper) -->" in text and "fault" not in text


def test_a_place_that_cannot_be_written(flights, tmp_path):
    with pytest.raises(BadInputError, match="cannot be written"):
        draw_flight(tmp_path / "absent" / "x.png", flights[0])
