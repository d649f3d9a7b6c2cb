import math
from dataclasses import asdict, replace

import pytest

from mavfi.outcomes import (
    COSTLIER,
    DUE,
    HEALTHY,
    LONGER,
    LOST,
    ControlEffect,
    ControlErrors,
    Effect,
    control_of,
    effect_of,
    energy,
)
from mavfi.record import End, EnergyTerms, FlightRecord, KernelEffect

A, B = FlightRecord(End.FLOWN, digest="a"), FlightRecord(End.FLOWN, digest="b")
UNFLOWN, DEAD = FlightRecord(End.UNKNOWN, error="ZeroDivisionError"), FlightRecord(End.DUE, error="died each time")


@pytest.mark.parametrize(
    ("golden", "injected", "effect"),
    [
        (A, A, Effect.MASKED),
        (A, B, Effect.SDC),
        (A, DEAD, Effect.CRASH),
        (None, DEAD, Effect.CRASH),
        (None, A, Effect.UNKNOWN),
        (A, UNFLOWN, Effect.UNKNOWN),
        (UNFLOWN, UNFLOWN, Effect.UNKNOWN),
        (DEAD, A, Effect.UNKNOWN),
    ],
)
def test_the_effect_of_a_fault_on_a_flight(golden, injected, effect):
    assert effect_of(golden, injected) is effect


def test_what_protected_code_found_is_not_silent():
    assert effect_of(A, replace(B, kernel=KernelEffect("detected"))) is Effect.DETECTED
    assert effect_of(A, replace(A, kernel=KernelEffect("detected"))) is Effect.MASKED


def test_effects_have_labels_and_sentences():
    labels = ["masked", "sdc", "crash", "hang", "exception", "detected", "not_activated", "unknown"]
    assert [effect.label for effect in Effect] == labels
    assert all(effect.value.endswith(".") for effect in Effect)
    assert {effect.label for effect in DUE} == {"crash", "hang", "exception"}


# ---- classes of a firmware's missions ----------------------------------------------------------------------------
CALM = ControlErrors(0.3, 0.02, 0.4, 0.05)


def mission(errors=CALM, status="success", time_s=40.0, digest="b", powered_s=None, **changes):
    """Record of a mission; `powered_s`: time of hovering that takes its energy (s)."""
    terms = EnergyTerms(duration_s=time_s if powered_s is None else powered_s)
    extra = {} if errors is None else {ControlErrors.KEY: asdict(errors)}
    return FlightRecord(End.FLOWN, status, digest, time_s, energy=terms, extra=extra, **changes)


def dead(effect):
    return replace(mission(LOST, "collision"), end=End.DUE, kernel=KernelEffect(effect, "SIGSEGV"))


def test_the_errors_of_a_record_are_those_stored_infinite_ones_too():
    wild = replace(CALM, velocity=math.inf)
    read = FlightRecord.from_json(mission(wild).to_json())
    assert ControlErrors.of(read) == wild
    assert ControlErrors.of(mission(None)) is None


GOLDEN = mission(digest="a")
OTHER_ROUTE = mission(time_s=45.0)


@pytest.mark.parametrize(
    ("injected", "expected"),
    [
        (mission(digest="a"), ControlEffect.IDENTICAL),
        (OTHER_ROUTE, ControlEffect.SLIGHT),
        (mission(status="collision"), ControlEffect.DEGRADED),  # follows all commands into an obstacle
        (mission(status="timeout"), ControlEffect.DEGRADED),
        (mission(replace(CALM, attitude=math.radians(4.1))), ControlEffect.DEGRADED),
        (mission(replace(CALM, attitude=math.radians(4.1)), "timeout"), ControlEffect.DEGRADED),
        (mission(replace(CALM, attitude=math.radians(4.1)), "collision"), ControlEffect.LOST),
        (mission(replace(CALM, velocity=1.6), "fly_away"), ControlEffect.LOST),
        (mission(replace(CALM, tilt=math.radians(61.0))), ControlEffect.LOST),  # recovers, and arrives
        (mission(replace(CALM, velocity=4.7), "collision"), ControlEffect.LOST),  # falls without tilting
        (mission(CALM, "invalid_state"), ControlEffect.LOST),
        (dead("crash"), ControlEffect.ENDS),
        (dead("hang"), ControlEffect.HANGS),
    ],
)
def test_the_class_of_a_mission_is_the_worst_that_applies(injected, expected):
    assert control_of(GOLDEN, injected) is expected


@pytest.mark.parametrize("name", ["tilt", "attitude", "velocity", "yaw_rate"])
@pytest.mark.parametrize(
    ("limits", "within", "beyond"),
    [(HEALTHY, ControlEffect.SLIGHT, ControlEffect.DEGRADED), (LOST, ControlEffect.DEGRADED, ControlEffect.LOST)],
)
def test_a_limit_itself_is_within(name, limits, within, beyond):
    limit = getattr(limits, name)
    assert control_of(GOLDEN, mission(replace(CALM, **{name: limit}))) is within
    assert control_of(GOLDEN, mission(replace(CALM, **{name: math.nextafter(limit, 9.0)}))) is beyond


@pytest.mark.parametrize("error", [math.nan, math.inf])
def test_an_error_that_is_not_finite_is_none_of_a_vehicle_in_control(error):
    assert control_of(GOLDEN, mission(replace(CALM, yaw_rate=error))) is ControlEffect.LOST


def test_time_and_energy_count_beyond_what_another_route_takes():
    longest, most = (1.0 + LONGER) * 40.0, (1.0 + COSTLIER) * 40.0
    assert control_of(GOLDEN, mission(time_s=longest)) is ControlEffect.SLIGHT
    assert control_of(GOLDEN, mission(time_s=longest + 0.02)) is ControlEffect.DEGRADED
    assert energy(mission(powered_s=most).energy) == pytest.approx((1.0 + COSTLIER) * energy(GOLDEN.energy))
    assert control_of(GOLDEN, mission(powered_s=most - 0.02)) is ControlEffect.SLIGHT
    assert control_of(GOLDEN, mission(powered_s=most + 0.02)) is ControlEffect.DEGRADED
    assert control_of(GOLDEN, mission(time_s=20.0)) is ControlEffect.SLIGHT


def test_a_mission_that_its_golden_run_loses_too_is_not_lost_by_the_fault():
    golden = mission(digest="a", status="timeout", time_s=150.0)
    assert control_of(golden, mission(status="collision")) is ControlEffect.SLIGHT
    assert control_of(golden, mission(replace(CALM, velocity=2.0), "collision")) is ControlEffect.LOST
    assert control_of(golden, mission(time_s=400.0)) is ControlEffect.SLIGHT


@pytest.mark.parametrize(
    ("golden", "injected"),
    [
        (None, OTHER_ROUTE),
        (UNFLOWN, OTHER_ROUTE),
        (GOLDEN, UNFLOWN),
        (GOLDEN, mission(None)),
        (GOLDEN, mission(kernel=KernelEffect("detected"))),
    ],
)
def test_what_cannot_be_compared_or_was_not_measured_has_no_class(golden, injected):
    assert control_of(golden, injected) is None


def test_limits_of_control_lie_in_order():
    assert not HEALTHY.beyond(LOST)
    assert LOST.beyond(HEALTHY)
    assert not CALM.beyond(HEALTHY)
