"""Failures of sensors and motors are drawn by unit, with exact shares of their types."""

from collections import Counter

import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.resolve import resolve
from mavfi.config import parse
from mavfi.errors import BadInputError
from mavfi.flight.host import RunResult
from mavfi.levels.level import Sampled, draws_of
from mavfi.levels.sensor.fault import FAILING, UNITS
from mavfi.record import End, FlightRecord

GOLDEN = {"": Sampled(RunResult(FlightRecord(End.FLOWN, flight_time_s=30.0)))}


def campaign(mission=None, **sampling):
    data = {"name": "c", "environments": ["sparse"], "missions": 4, "faults": 160, "mission": mission or {}}
    return parse(Campaign, {**data, "sampling": {"level": "sensor", **sampling}}, "campaign.yaml")


def faults(of, golden=GOLDEN):
    sampler = resolve(of).sampler
    return sampler.draw([draw for _, draw in draws_of(sampler.blocks("sparse"), range(4))], "sparse", golden)


def test_types_have_equal_shares_and_instants_and_motors_are_uniform():
    motor_faults = [fault for fault in faults(campaign()) if fault.unit == "motor"]
    assert Counter(fault.kind for fault in motor_faults) == dict.fromkeys(FAILING, 20)
    assert set(Counter(fault.instance for fault in motor_faults)) == {1, 2, 3, 4}
    times = [fault.time_us for fault in motor_faults]
    assert 0 <= min(times) < 3_000_000 and 27_000_000 < max(times) < 30_000_000 and len(set(times)) > 150
    assert {fault.lasts_s for fault in motor_faults} == {float("inf")}


def test_by_default_the_units_that_the_mission_reads():
    assert set(UNITS) - {fault.unit for fault in faults(campaign())} == {"accelerometer"}
    assert {fault.unit for fault in faults(campaign({"localization": "estimator"}))} == set(UNITS)
    with pytest.raises(BadInputError, match="accelerometer: localization truth"):
        campaign(units=["accelerometer"])


def test_a_null_run_changes_nothing_and_units_alternate():
    sampler = resolve(campaign(units=["gyro", "motor"])).sampler
    nulls = [sampler.null(index, 10_000, "sparse", GOLDEN) for index in range(3)]
    assert [fault.unit for fault in nulls] == ["gyro", "motor", "gyro"] and {fault.kind for fault in nulls} == {"ok"}
    assert not sampler.null(0, 0, "sparse", {}).has_site


@pytest.mark.parametrize(
    ("sampling", "text"),
    [
        ({"units": ["radar"]}, "'radar': not known; allowed: gyro"),
        ({"types": ["ok"]}, "'ok': not known; allowed: off"),
        ({"lasts_s": 0}, "allowed: above 0"),
    ],
)
def test_what_is_not_allowed(sampling, text):
    with pytest.raises(BadInputError, match=text):
        campaign(**sampling)


def test_an_unquoted_off_is_a_type():
    """YAML 1.1 reads it as false."""
    assert campaign(types=[False, "stuck"]).sampling.types == ("off", "stuck")
