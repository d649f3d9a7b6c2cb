"""Coupling `observer`: consumers see the value first, what is asked for happens one step later."""

import pytest

from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from tests.core.flights.missions import Scripted, each_autopilot, fault, golden, mission

OBSERVER = RecoveryPolicy("observer")


@each_autopilot
def test_a_detector_that_only_watches_changes_nothing(autopilot):
    flight = fly(mission(autopilot), None, Scripted(), recovery=OBSERVER)
    assert flight.log.digest() == golden(autopilot).log.digest()
    assert flight.log.alarms == []


def test_consumers_have_seen_the_value_that_raises_the_alarm():
    """The wrong command is flown for one control period; as a gate the detector would have kept it away."""
    wrong = fault("control.command", "vy", 3.0, 62)
    observed = fly(mission(), wrong, Scripted("control.command", n=151), recovery=OBSERVER)
    gated = fly(mission(), wrong, Scripted("control.command", n=151))
    (hit,) = observed.log.injections
    assert hit.after in observed.log.column("command_vy")
    assert hit.after not in gated.log.column("command_vy")
    assert [alarm.outcome for alarm in observed.log.alarms] == ["repaired"]


@pytest.mark.parametrize(
    ("state", "stage", "n"),
    [
        ("control.command", "control", 100),
        ("planning.waypoint", "planning", 5),
        ("planning.path", "planning", 1),
        ("planning.trajectory", "planning", 1),
        ("perception.collision_status", "perception", 5),
    ],
)
def test_the_stage_computes_again_one_step_later(state, stage, n):
    detector = Scripted(state, n=n, stage=stage)
    flight = fly(mission(), None, detector, recovery=OBSERVER)
    (alarm,) = flight.log.alarms
    assert (alarm.action, alarm.state) == ("recompute", state)
    assert alarm.outcome in ("repaired", "accepted")
    assert flight.log.meta["recompute_us"][stage] > 0
    ((alarmed_us, _),) = detector.alarmed
    again = [time_us for time_us, name in detector.accepted if name == state and time_us > alarmed_us]
    assert again[0] > alarmed_us
    assert flight.log.status.label == "success"


def test_perception_uses_the_same_image_again():
    detector = Scripted("perception.collision_status", n=5, stage="perception")
    fly(mission(), None, detector, recovery=OBSERVER)
    ((alarmed_us, _),) = detector.alarmed
    later = [name for time_us, name in detector.accepted if time_us >= alarmed_us and "odometry" not in name]
    first = next(name for name in later[1:] if name.startswith(("sensor", "perception")))
    assert first == "perception.point_cloud"


@pytest.mark.parametrize(("request_", "action"), [({"stop": True}, "stop"), ({"abandon_waypoint": True}, "abandon")])
def test_the_setpoint_generator_obeys_at_its_next_step(request_, action):
    flight = fly(mission(), None, Scripted("control.command", n=200, **request_), recovery=OBSERVER)
    (alarm,) = flight.log.alarms
    assert (alarm.action, alarm.outcome) == (action, "replaced")
    assert flight.log.meta["recompute_us"]["control"] > 0


def test_an_alarm_for_another_stage_has_that_stage_run_again():
    flight = fly(mission(), None, Scripted("planning.waypoint", n=5, stage="control"), recovery=OBSERVER)
    (alarm,) = flight.log.alarms
    assert alarm.outcome == "accepted"
    assert flight.log.meta["recompute_us"] == {"perception": 0, "planning": 0, "control": 460}
