from dataclasses import replace

from mavfi.campaign.flights import Row
from mavfi.campaign.plan import RunSpec
from mavfi.faults.fault import Fault, FaultSite
from mavfi.reports.telling import choose

FAULT = Fault("state", FaultSite("planning.waypoint", "x"), 0, 62)


def _row(index, success, *, arm="", time=100.0, distance=50.0):
    setting = f"dr_{arm}" if arm else "fi"
    spec = RunSpec(2, setting, "sparse", 10_000, "key", "planning", index, FAULT, arm=arm, detector=arm)
    record = {"end": "flown", "success": success, "flight_time_s": time, "energy_j": 1.0, "distance_m": distance}
    golden = {"success": True, "flight_time_s": 100.0, "energy_j": 1.0}
    return Row(spec, record, golden, golden)


def test_a_failure_that_a_detector_heals_tells_most():
    rows = [_row(0, False, distance=90.0), _row(1, False), _row(1, True, arm="gaussian"), _row(2, True, time=200.0)]
    assert choose(rows) == (rows[1], rows[2])


def test_then_a_failure_then_the_slowest():
    failed, slow = _row(0, False), _row(1, True, time=150.0)
    assert choose([slow, failed]) == (failed, None)
    assert choose([slow, _row(2, True)]) == (slow, None)


def test_nothing_to_tell():
    assert choose([]) is None
    assert choose([_row(0, True, time=100.5)]) is None


def test_missions_whose_golden_flight_fails_tell_nothing_of_the_fault():
    row = _row(0, False)
    assert choose([replace(row, golden={"success": False})]) is None
