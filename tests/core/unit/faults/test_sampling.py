from dataclasses import replace

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, FaultSite
from mavfi.levels.state.drawing import draw, draw_in_message, group_target, stage_target
from mavfi.levels.state.fault import StateFault
from mavfi.record import Profile
from mavfi.states import PPC_STAGES, STATES


def profile(**counts: int) -> Profile:
    times = {name.replace("__", "."): np.arange(5, dtype=np.int64) * 100_000 for name in counts}
    return Profile(times, {name.replace("__", "."): np.full(5, count, np.int32) for name, count in counts.items()})


WAYPOINTS = profile(planning__waypoint=0)


def test_only_states_that_exist_are_drawn():
    assert "control.tracking" in stage_target("control", "published").fields
    assert "control.tracking" not in stage_target("control", "hardened").fields
    monitored = stage_target("planning", "published", "paper-13")
    assert monitored.fields == {"planning.waypoint": ("x", "y", "z", "yaw", "vx", "vy", "vz")}
    for stage in PPC_STAGES:
        assert all(STATES[name].exists_with("truth") for name in stage_target(stage, "published").fields)
    with_filter = stage_target("perception", "published", localization="estimator").fields
    assert with_filter["perception.odometry"] == ("x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz")
    assert set(with_filter) - {"perception.odometry"} == set(stage_target("perception", "published").fields)
    assert group_target("mine", ["sensor.imu.fx"], "estimator").fields == {"sensor.imu": ("fx",)}
    with pytest.raises(BadInputError, match="group 'mine': sensor.imu.fx: only flights with localization estimator"):
        group_target("mine", ["sensor.imu.fx"])


def test_the_same_address_gives_the_same_fault_and_another_address_another():
    target = stage_target("planning", "published")
    some = profile(planning__waypoint=0, planning__path=4, planning__trajectory=9)
    faults = {
        (seed, index, environment): draw(target, "mantissa", some, seed, environment, index)
        for seed in range(5)
        for index in range(5)
        for environment in ("sparse", "dense")
    }
    again = draw(target, "mantissa", some, 3, "dense", 2)
    assert again == faults[3, 2, "dense"]
    assert len({(f.site, f.time_us, f.bit) for f in faults.values()}) > 20


def test_classes_of_bits_are_drawn_alike_and_a_flag_has_its_only_bit():
    target = group_target("x", ["planning.waypoint.x"])
    bits = np.array([draw(target, "classes", WAYPOINTS, seed).bit for seed in range(900)])
    counts = [np.sum(bits == 63), np.sum((bits >= 52) & (bits < 63)), np.sum(bits < 52)]
    assert all(abs(count - 300) < 3.5 * np.sqrt(200) for count in counts)
    flag = group_target("flag", ["perception.collision_status.collision"])
    assert draw(flag, "classes", profile(perception__collision_status=0), 1).bit == 0


def test_a_state_that_was_never_published_is_kept_as_no_site():
    fault = draw(stage_target("control", "published"), "sign_exponent", Profile(), 1, 0)
    assert fault.time_us == NO_SITE
    assert not fault.has_site
    assert fault.where.state in ("control.command", "control.tracking")
    assert fault.bit is not None


def test_an_element_is_drawn_only_from_publications_that_carry_some():
    target = group_target("path", ["planning.path.x"])
    some = Profile(
        {"planning.path": np.array([10, 20, 30], np.int64)}, {"planning.path": np.array([0, 3, 0], np.int32)}
    )
    drawn = [draw(target, "sign_exponent", some, seed, 0) for seed in range(60)]
    assert {fault.time_us for fault in drawn} == {20}
    assert {fault.where.element for fault in drawn} == {0, 1, 2}


def test_weights_count_the_fields_that_a_stratum_leaves_out():
    names = ["time_to_collision", "future_collision_seq", "collision"]
    target = group_target("status", [f"perception.collision_status.{name}" for name in names])
    expected = {"time_to_collision": 52 / 64 * 2 / 3, "future_collision_seq": 31 / 32 * 2 / 3}
    drawn = [draw(target, "mantissa", Profile(), seed, 0) for seed in range(40)]
    assert {fault.where.field: fault.weight for fault in drawn} == pytest.approx(expected)


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(BadInputError, match="stage 'vision'"):
        stage_target("vision", "published")
    with pytest.raises(BadInputError, match="no field has bits of the stratum"):
        group_target("flag", ["perception.collision_status.collision"]).within("mantissa")
    with pytest.raises(BadInputError, match="names no site"):
        group_target("empty", [])
    with pytest.raises(BadInputError, match="state 'planning.waipoint': not known"):
        group_target("typo", ["planning.waipoint.x"])
    with pytest.raises(BadInputError, match="monitored set"):
        stage_target("control", "published", "all-99")


FLIGHT = Profile(
    {
        "perception.collision_status": np.array([400, 900], np.int64),
        "perception.point_cloud": np.array([100, 300, 500], np.int64),
        "planning.path": np.array([90, 390, 490, 890], np.int64),
        "planning.trajectory": np.array([100, 400, 500, 900], np.int64),
        "planning.waypoint": np.arange(110, 1000, 20, dtype=np.int64),
        "control.command": np.arange(0, 20_000, 20, dtype=np.int64),
    },
    {
        "perception.collision_status": np.zeros(2, np.int32),
        "perception.point_cloud": np.full(3, 7, np.int32),
        "planning.path": np.array([4, 0, 3, 3], np.int32),
        "planning.trajectory": np.array([9, 0, 7, 8], np.int32),
        "planning.waypoint": np.zeros(45, np.int32),
        "control.command": np.zeros(1000, np.int32),
    },
)
"""A flight of four plans, the second of which failed."""


def instants(site, when, flight=FLIGHT, seeds=2000):
    target = group_target("some", [site])
    return np.array([draw(target, "mantissa", flight, seed, 0, when=when).time_us for seed in range(seeds)])


@pytest.mark.parametrize(
    ("site", "times"),
    [
        ("planning.trajectory.x", [100, 500, 900]),
        ("planning.path.x", [90, 490, 890]),
        ("planning.waypoint.x", [110, 510, 910]),
    ],
)
def test_a_coin_per_finished_plan_hits_the_first_with_one_half_and_the_last_with_the_rest(site, times):
    drawn = instants(site, "published")
    shares = [np.mean(drawn == time) for time in times]
    assert shares == pytest.approx([1 / 2, 1 / 4, 1 / 4], abs=0.04)
    assert sum(shares) == pytest.approx(1.0)


def test_one_command_in_a_hundred_is_hit_and_the_last_of_a_short_flight():
    drawn = instants("control.command.vx", "published") / 20
    # the probability that the first 100 commands pass is 0.99^100 = 0.366
    assert np.mean(drawn >= 100) == pytest.approx(0.99**100, abs=0.04)
    short = Profile({"control.command": np.array([0, 20])}, {"control.command": np.zeros(2, np.int32)})
    assert np.mean(instants("control.command.vx", "published", short) == 20) == pytest.approx(0.99, abs=0.01)


def test_perception_is_hit_at_the_first_predicted_collision():
    assert set(instants("perception.collision_status.time_to_collision", "published", seeds=20)) == {400}
    assert set(instants("perception.point_cloud.x", "published", seeds=20)) == {500}


def test_the_second_plan_counts_if_it_failed_and_a_flight_of_one_plan_has_no_site():
    expected = {"planning.waypoint.x": 410, "planning.path.x": 490, "control.command.vx": 400}
    for site, time in expected.items():
        assert set(instants(site, "second_plan", seeds=20)) == {time}
    one_plan = Profile(
        {**FLIGHT.times_us, "planning.trajectory": np.array([100])},
        {**FLIGHT.counts, "planning.trajectory": np.array([9], np.int32)},
    )
    assert set(instants("planning.waypoint.x", "second_plan", one_plan, seeds=20)) == {NO_SITE}
    message = draw_in_message("planning.waypoint", "mantissa", FLIGHT, 3, when="second_plan")
    assert message.time_us == 410
    assert not draw_in_message("planning.waypoint", "mantissa", one_plan, 3, when="second_plan").has_site


def test_uniform_draws_are_those_of_stored_campaigns():
    trajectory = Profile(
        {"planning.trajectory": np.arange(10) * 1000}, {"planning.trajectory": np.arange(10, dtype=np.int32)}
    )
    fault = draw(group_target("t", ["planning.trajectory.x"]), "mantissa", trajectory, 3, "sparse", 1)
    assert fault == StateFault(FaultSite("planning.trajectory", "x", 0), 6000, 21, "mantissa", 0.8125, 3)
    fault = draw_in_message("planning.trajectory", "mantissa", trajectory, 3, "sparse", 1)
    assert (fault.site, fault.time_us, fault.bit) == ("planning.trajectory.yaw[2]", 9000, 23)


def test_the_components_of_a_vector_are_hit_together_in_independent_bits_of_the_stratum():
    target = group_target("some", ["planning.trajectory.vy", "planning.trajectory.yaw"])
    bits = []
    for seed in range(300):
        alone = draw(target, "sign_exponent", FLIGHT, seed, 0)
        fault = draw(target, "sign_exponent", FLIGHT, seed, 0, together=True)
        assert replace(fault, also=()) == alone
        assert [name for name, _ in fault.also] == (["vx", "vz"] if fault.where.field == "vy" else [])
        bits += [(fault.bit, *(bit for _, bit in fault.also))] if fault.also else []
    for position in range(3):
        assert {drawn[position] for drawn in bits} == set(range(52, 64))
    assert np.abs(np.corrcoef(np.array(bits).T) - np.eye(3)).max() < 0.3
