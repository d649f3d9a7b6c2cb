"""Four public bug reports of autopilots, each in one short flight; their rates: studies/bug_reports."""

import math

import numpy as np
import pytest

from mavfi.flight.compose import prepare
from mavfi.flight.fly import fly
from mavfi.levels.level import parse
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.report.explain import injection_lines
from tests.core.flights.missions import GOAL, golden

SPEC = MissionSpec(environment="dense", seed=1, autopilot="published", goal=GOAL)


def flown(text, detector=None):
    """The flight with a fault, and the values of its field as consumers receive them, with their instants (s)."""
    setup = prepare(SPEC, detector)
    fault, _ = parse(text).draw(setup, 0)
    values = []

    def record(state, now):
        if state.spec.name == fault.where.state:
            values.append((now / 1e6, state.value(fault.where.field)))

    flight = fly(setup.scenario, fault, setup.detector(), recovery=setup.recovery, recorders=[record])
    return flight.log, np.array(values)


@pytest.mark.parametrize(
    ("report", "text"),
    [
        ("ArduPilot 19382", "state:control.command.yaw_rate:set=nan@3..4"),
        ("PX4 3001", "state:control.command.vx:set=nan@3..4"),
        ("PX4 7510", "state:planning.waypoint.z:set=nan@3..4"),
    ],
)
def test_values_that_are_not_numbers_cost_time_and_raise_an_alarm(report, text):
    log, values = flown(text)
    is_struck = (values[:, 0] >= 3.0) & (values[:, 0] <= 4.0)
    np.testing.assert_array_equal(np.isnan(values[:, 1]), is_struck, report)
    (injection,) = log.injections
    assert math.isnan(injection.after) and injection.details["publications"] == is_struck.sum()
    assert log.digest() != golden().log.digest() and log.status is MissionStatus.SUCCESS
    if "command" in text:
        assert log.meta["rejected_commands"] == is_struck.sum()
    ((_, line),) = injection_lines(injection, parse(text).resolve(0, "published"), log)
    count = "" if is_struck.sum() == 1 else f", {is_struck.sum()} publications"
    assert "set=nan, at 3." in line and line.endswith(f"→ nan{count}")

    alarmed, seen = flown(text, "recommended")
    state = text.split(":")[1].rpartition(".")[0]
    assert any(alarm.state == state and 3.0 <= alarm.time_s <= 4.0 for alarm in alarmed.alarms)
    assert np.isnan(seen[:, 1]).sum() < is_struck.sum(), "the detector withholds them"


def test_a_producer_that_sends_nothing_else_any_more_loses_the_mission():
    log, _ = flown("state:control.command.vx:set=nan@3..")
    assert log.status is MissionStatus.TIMEOUT


def test_outliers_of_the_position_on_one_axis():
    text = "state:sensor.odometry.y:bias=20:every=25@2.."
    log, values = flown(text)
    struck = np.arange(100, len(values), 25)
    jumps = np.abs(np.diff(values[:, 1])) > 15.0
    assert set(np.flatnonzero(jumps)) <= {*(struck - 1), *struck} and jumps.sum() >= 2 * len(struck) - 1
    alarmed, _ = flown(text, "recommended")
    assert log.injections[0].details["publications"] == len(struck) and len(alarmed.alarms) > 0
