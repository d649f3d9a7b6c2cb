from pathlib import Path

import pytest

from mavfi.config import EnvironmentConfig
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, FaultSite
from mavfi.hosts.compose import make_scenario
from mavfi.hosts.inprocess import fly
from mavfi.reports.picture import draw_flight

SCAN = Path(__file__).parents[4] / "shared" / "data" / "geb079.bt"
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def flights():
    scenario = make_scenario("dense", 7)
    fault = Fault("state", FaultSite("planning.waypoint", "y"), 10_000_000, 60)
    return fly(scenario), fly(scenario, fault)


def test_a_golden_flight(flights, tmp_path):
    path = draw_flight(tmp_path / "golden.png", flights[0])
    assert path.read_bytes().startswith(PNG)


def test_a_flight_with_a_fault_shows_more(flights, tmp_path):
    golden, injected = flights
    assert injected.log.injections[0]["hit"]
    alone = draw_flight(tmp_path / "alone.svg", golden).read_text(encoding="utf-8")
    both = draw_flight(tmp_path / "both.svg", injected, golden, golden).read_text(encoding="utf-8")
    assert "#d55e00" in both.lower()
    assert "#d55e00" not in alone.lower()


def test_a_place_that_cannot_be_written(flights, tmp_path):
    with pytest.raises(BadInputError, match="cannot be written"):
        draw_flight(tmp_path / "absent" / "x.png", flights[0])


@pytest.mark.slow
@pytest.mark.skipif(not SCAN.is_file(), reason="the scanned building is not beside the repository")
def test_a_scanned_building(tmp_path):
    scenario = make_scenario(str(SCAN), 0, start=(-5.0, 0.0, 1.2), goal=(1.0, -0.8, 0.9))
    assert isinstance(scenario.environment, EnvironmentConfig)
    path = draw_flight(tmp_path / "scan.png", fly(scenario))
    assert path.read_bytes().startswith(PNG)
