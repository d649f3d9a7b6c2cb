"""A message that is lost in transit costs what depended on it, and no more."""

import numpy as np
import pytest

from mavfi.faults.fault import FaultSite
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from mavfi.levels.state.fault import StateFault
from tests.core.flights.missions import Scripted, golden, mission

LOST_AT_S = 3.0


@pytest.mark.parametrize(
    "site", ["sensor.depth.length_range", "perception.point_cloud.length_x", "perception.map_update.length_voxel"]
)
def test_after_a_lost_scan_the_camera_takes_its_next_image(site):
    state, _, field = site.rpartition(".")
    flight = fly(mission(), StateFault(FaultSite(state, field), int(1e6 * LOST_AT_S), 31), profile=True)
    (injection,) = flight.log.injections
    assert injection.activated and injection.details["lost"]
    assert round(1e6 * injection.time_s) not in flight.profile.times_us[state]  # nobody received it
    images = 1e-6 * flight.profile.times_us["sensor.depth"]
    assert np.diff(images).max() < 0.6 and images[-1] > LOST_AT_S + 3.0  # one each 0.1 to 0.3 s without the fault


@pytest.mark.parametrize(
    "site",
    [
        "perception.point_cloud.length_x",
        "perception.map_update.length_voxel",
        "planning.path.length_z",
        "planning.trajectory.length_x",
    ],
)
def test_the_producer_sends_a_message_again_that_nobody_can_read(site):
    state, field = site.rsplit(".", 1)
    flight = fly(
        mission(), StateFault(FaultSite(state, field), 0, 31), Scripted(), recovery=RecoveryPolicy(grain="message")
    )
    assert flight.log.injections[0].details["lost"]
    (alarm,) = flight.log.alarms
    assert (alarm.source, alarm.state, alarm.action, alarm.outcome) == ("unreadable", state, "resend", "repaired")
    np.testing.assert_array_equal(flight.log.rows, golden().log.rows)


@pytest.mark.parametrize(
    ("state", "field", "grain"), [("planning.path", "length_z", "kernel"), ("sensor.depth", "length_range", "message")]
)
def test_it_is_not_sent_again_by_another_policy_nor_by_a_sensor(state, field, grain):
    fault = StateFault(FaultSite(state, field), 0, 31)
    flight = fly(mission(), fault, Scripted(), recovery=RecoveryPolicy(grain=grain))
    assert flight.log.injections[0].details["lost"] and flight.log.alarms == []


def test_a_node_whose_messages_nobody_can_read_is_restarted():
    fault = StateFault(FaultSite("planning.path", "length_z"), 0, 31, times=3)
    recovery = RecoveryPolicy(grain="message", same_twice="escalate")
    actions = [
        (alarm.action, alarm.outcome) for alarm in fly(mission(), fault, Scripted(), recovery=recovery).log.alarms
    ]
    assert actions == [("resend", "rejected"), ("recompute", "rejected"), ("restart", "restarted")]
