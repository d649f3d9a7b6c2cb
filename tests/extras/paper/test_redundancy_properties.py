"""Properties of the performance model behind Fig. 8."""

import math

from hypothesis import assume, given
from hypothesis import strategies as st

from mavfi.extras.paper.redundancy import (
    GRAVITY,
    DesignConfig,
    energy_ratio,
    payload,
    performance,
    safe_speed,
    time_ratio,
)

REAL = {"allow_nan": False, "allow_infinity": False}
accelerations = st.floats(1e-3, 50, **REAL)
periods = st.floats(0, 10, **REAL)
ranges = st.floats(0.1, 100, **REAL)


@st.composite
def designs(draw):
    mass, power, per_watt = (
        draw(st.floats(0.05, 20, **REAL)),
        draw(st.floats(0.1, 50, **REAL)),
        draw(st.floats(0, 0.05, **REAL)),
    )
    weight = GRAVITY * (mass + 0.085 + power * per_watt)
    return DesignConfig(
        name="drawn",
        mass=mass,
        max_thrust=draw(st.floats(1.01, 4, **REAL)) * weight,
        processor_power=power,
        heatsink=per_watt,
        action_period=draw(periods),
        sensing_range=draw(ranges),
        acceleration=draw(st.sampled_from(["excess_thrust", "tilt"])),
        replicated=draw(st.sampled_from(["processor", "board"])),
    )


@given(designs(), st.integers(1, 5))
def test_more_redundancy_never_makes_a_vehicle_lighter_faster_or_cheaper_to_fly(design, copies):
    few, many = performance(design, copies), performance(design, copies + 1)
    assert payload(design, copies + 1) >= payload(design, copies)
    assert many.mass >= few.mass
    assert many.speed <= few.speed
    one = performance(design)
    assert 1 <= time_ratio(few, one) <= time_ratio(many, one)
    assert energy_ratio(many, one) >= time_ratio(many, one)


@given(designs(), st.floats(0, 1, **REAL), st.floats(0, 1, **REAL))
def test_more_overhead_never_makes_a_vehicle_faster(design, some, more):
    assert performance(design, 1, some + more).speed <= performance(design, 1, some).speed


@given(accelerations, periods, ranges)
def test_a_vehicle_at_its_safe_speed_stops_within_its_range_and_not_before(acceleration, period, distance):
    speed = safe_speed(acceleration, period, distance)
    assert math.isclose(speed * period + speed**2 / (2 * acceleration), distance, rel_tol=1e-9)


@given(accelerations, accelerations, periods, periods, ranges, ranges)
def test_the_safe_speed_grows_with_acceleration_and_range_and_falls_with_the_period(a, b, s, t, c, d):
    (low_a, high_a), (short, long), (near, far) = sorted((a, b)), sorted((s, t)), sorted((c, d))
    assume(far > near)
    assert safe_speed(low_a, long, near) <= safe_speed(high_a, short, far) * (1 + 1e-12)


@given(designs(), st.floats(0.01, 100, **REAL))
def test_a_speed_limit_never_makes_redundancy_dearer(design, limit):
    one, three = performance(design), performance(design, 3)
    assert 1 <= time_ratio(three, one, limit) <= time_ratio(three, one)
