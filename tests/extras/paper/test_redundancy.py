import math

import pytest

from mavfi.config import VehicleConfig, shipped
from mavfi.errors import BadInputError
from mavfi.extras.paper.redundancy import (
    CANNOT_HOVER,
    GRAVITY,
    DesignConfig,
    at_ends,
    energy_ratio,
    find_design,
    max_acceleration,
    payload,
    performance,
    safe_speed,
    shipped_designs,
    time_ratio,
)


def design(**changes):
    return DesignConfig(**{"name": "toy", "mass": 1.0, "max_thrust": 20.0, **changes})


# ---- formulas, by hand -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("acceleration", "period", "distance", "speed"),
    [
        (2.0, 0.0, 9.0, 6.0),  # sqrt(2 a d)
        (2.0, 1.0, 8.0, 4.0),  # 4 * 1 + 16 / 4 = 8
        (5.0, 2.0, 25.0, 8.708287),  # 5 (sqrt(4 + 10) - 2)
        (0.0, 1.0, 8.0, 0.0),
        # MAVBench's own range of speeds, with the acceleration and range of its launch files
        (6.0, 0.0, 6.5, 8.832),
        (6.0, 4.0, 6.5, 1.573),
    ],
)
def test_the_safe_speed_is_that_from_which_the_vehicle_stops_in_time(acceleration, period, distance, speed):
    found = safe_speed(acceleration, period, distance)
    assert found == pytest.approx(speed, abs=5e-4)
    if acceleration:
        assert found * period + found**2 / (2 * acceleration) == pytest.approx(distance)


def test_a_long_period_leaves_the_range_over_the_period():
    assert safe_speed(5.0, 1e6, 7.0) == pytest.approx(7e-6, rel=1e-9)


def test_payload_grows_by_a_heat_sink_or_by_a_board_for_each_processor():
    own = {"board_mass": 0.1, "heatsink": 0.01, "processor_power": 4.0}
    assert [payload(design(**own), n) for n in (1, 2, 3)] == pytest.approx([0.14, 0.18, 0.22])
    assert payload(design(replicated="board", **own), 3) == pytest.approx(0.42)


def test_both_laws_of_the_largest_acceleration():
    assert max_acceleration(design(), 1.25) == pytest.approx(16.0 - GRAVITY)
    assert max_acceleration(design(acceleration="tilt"), 1.25) == pytest.approx(
        GRAVITY * math.sqrt((16 / GRAVITY) ** 2 - 1)
    )
    assert max_acceleration(design(), 20.0 / GRAVITY) == max_acceleration(design(), 5.0) == 0.0


def test_ratios_of_time_and_energy():
    one, three = performance(design()), performance(design(), 3)
    assert time_ratio(three, one) == one.speed / three.speed > 1
    assert energy_ratio(three, one) == pytest.approx(one.speed / three.speed * (three.mass / one.mass) ** 1.5)
    assert time_ratio(three, one, speed_limit=1.0) == 1.0, "both fly at the limit"
    between = (one.speed + three.speed) / 2
    assert time_ratio(three, one, between) == pytest.approx(between / three.speed)
    heavy = performance(design(max_thrust=12.0, heatsink=0.02, processor_power=5.0), 3)
    assert heavy.speed == 0 and time_ratio(heavy, one) == CANNOT_HOVER


def test_a_detector_costs_its_share_of_the_period_and_no_mass():
    plain, watched = performance(design()), performance(design(), 1, 0.1)
    assert watched.mass == plain.mass
    assert watched.speed == safe_speed(plain.acceleration, 1.1 * design().action_period, 7.0)


# ---- shipped calibrations ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "dmr", "tmr"),
    [
        ("airsim_uav", 1.028, 1.058),
        ("dji_spark", 1.253, 1.881),
        ("airsim_uav_tdp", 1.026, 1.060),
        ("dji_spark_tdp", 1.120, 1.898),
    ],
)
def test_shipped_calibrations(name, dmr, tmr):
    """Worked out apart from this code: F/m - g, then the positive root."""
    own = find_design(name)
    one = performance(own)
    assert [time_ratio(performance(own, n), one) for n in (2, 3)] == pytest.approx([dmr, tmr], abs=6e-4)


def test_the_airsim_uav_is_the_vehicle_that_missions_fly():
    flown, own = shipped("vehicles", VehicleConfig, "airsim_quad"), find_design("airsim_uav")
    assert own.mass == flown.mass
    assert own.max_thrust == pytest.approx(4 * flown.max_rotor_thrust)


def test_every_band_and_input_of_the_shipped_designs_has_a_source():
    for own in shipped_designs():
        inputs = {"mass", "max_thrust", "board_mass", "processor_power", "heatsink", "action_period", "sensing_range"}
        assert set(own.sources) == inputs
        assert all(band.low <= getattr(own, key) <= band.high for key, band in own.bands.items())


# ---- bands and input ---------------------------------------------------------------------------------------------
def test_the_ends_of_a_band_change_one_parameter():
    own = design(bands={"max_thrust": {"low": 9.0, "high": 30.0}})
    low, high = at_ends(own, "max_thrust")
    assert low is None, "it cannot hover"
    assert high == own.model_copy(update={"max_thrust": 30.0})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\nmass: 1\n", "key 'max_thrust': is required"),
        ("name: x\nmass: 1\nmax_thrust: 5\n", "5 N: cannot hover; allowed: above the weight with one processor, 10.9"),
        ("name: x\nmass: 1\nmax_thrust: 20\nthrust: 3\n", "unknown key 'thrust'"),
        ("name: x\nmass: 1\nmax_thrust: 20\nbands: {masses: {low: 1, high: 2}}\n", "'masses': not known; allowed: "),
        ("name: x\nmass: 1\nmax_thrust: 20\nsources: {m: me}\n", "sources: 'm': not known"),
        ("name: x\nmass: 1\nmax_thrust: 20\nbands: {mass: {low: 3, high: 2}}\n", "low: 3: allowed: at most high, 2"),
    ],
)
def test_a_wrong_vehicle_file_is_refused(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInputError) as raised:
        find_design(str(path))
    assert str(path) in str(raised.value) and message in str(raised.value)
