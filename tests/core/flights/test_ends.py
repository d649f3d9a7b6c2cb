import numpy as np
import pytest

from mavfi.config import EnvironmentConfig
from mavfi.errors import BadInputError
from mavfi.flight.compose import new_loop
from mavfi.flight.fly import fly
from mavfi.flight.loop import Listener
from mavfi.mission import FLY_AWAY_MARGIN, MissionStatus
from mavfi.sim.simulator import Simulator
from tests.core.flights.missions import FAR_GOAL, GOAL, each_autopilot, golden, mission


@pytest.mark.slow
@pytest.mark.parametrize(
    ("autopilot", "expected"),
    [("published", MissionStatus.NO_PATH), ("hardened", MissionStatus.NO_PATH)],
)
def test_in_a_closed_yard_no_path_is_found(autopilot, expected):
    yard = EnvironmentConfig(name="yard", generator="tests.core.flights.missions:walled")
    scenario = mission(autopilot).model_copy(update={"environment": yard, "goal": (60.0, 0.0, 3.0)})
    few = scenario.autopilot.model_copy(update={"max_failed_plans": 6})
    flight = fly(scenario.model_copy(update={"autopilot": few}))
    assert flight.log.status is expected
    assert flight.log.count("plan_failed") > 6


def test_the_time_limit_ends_a_flight(monkeypatch):
    monkeypatch.setattr("mavfi.flight.loop.time_limit", lambda *_: 2.0)
    flight = fly(mission())
    assert flight.log.status is MissionStatus.TIMEOUT
    assert flight.log.column("time")[-1] == pytest.approx(2.0)
    assert flight.log.meta["time_limit_s"] == 2.0


def test_a_blind_vehicle_collides():
    class Blind(Simulator):
        """The depth image says that nothing is there."""

        def depth(self):
            ranges, pose = super().depth()
            return np.full_like(ranges, np.inf), pose

    flight = new_loop(mission(goal=FAR_GOAL), make_plant=Blind).fly()
    assert flight.log.status is MissionStatus.COLLISION


def judge(odometry, now=1_000_000, failed_plans=0):
    loop = new_loop(mission())
    for index, value in odometry.items():
        loop.plant.odometry[index] = value
    return loop.judge.status(loop.plant, failed_plans, now)


@pytest.mark.parametrize(
    ("odometry", "expected"),
    [
        ({}, None),
        ({0: np.nan}, MissionStatus.INVALID_STATE),
        ({12: np.inf}, MissionStatus.INVALID_STATE),
        ({0: GOAL[0], 1: GOAL[1], 2: GOAL[2] + 1.9}, MissionStatus.SUCCESS),
        ({0: GOAL[0], 1: GOAL[1], 2: GOAL[2] + 2.1}, None),
        ({0: 120.0 + FLY_AWAY_MARGIN + 0.1}, MissionStatus.FLY_AWAY),
        ({1: -30.0 - FLY_AWAY_MARGIN - 0.1}, MissionStatus.FLY_AWAY),
        ({2: 12.0 + FLY_AWAY_MARGIN - 0.1}, None),
    ],
)
def test_the_vehicles_state_is_judged(odometry, expected):
    assert judge(odometry) is expected


def test_the_arrival_radius_is_that_of_the_mission():
    loop = new_loop(mission(arrival_radius=8.0))
    loop.plant.odometry[:3] = np.add(GOAL, (0.0, 0.0, 7.9))
    assert loop.judge.status(loop.plant, 0, 1_000_000) is MissionStatus.SUCCESS
    loop.plant.odometry[:3] = np.add(GOAL, (0.0, 0.0, 8.1))
    assert loop.judge.status(loop.plant, 0, 1_000_000) is None
    with pytest.raises(BadInputError, match="where it counts as reached; allowed: 20 m or more"):
        new_loop(mission(goal=(15.0, -3.0, 3.0), arrival_radius=20.0))


def test_failed_plans_and_time_are_judged():
    limit = golden().log.meta["time_limit_s"] * 1e6
    assert judge({}, failed_plans=mission().autopilot.max_failed_plans) is None
    assert judge({}, failed_plans=mission().autopilot.max_failed_plans + 1) is MissionStatus.NO_PATH
    assert judge({}, int(limit)) is MissionStatus.TIMEOUT
    assert judge({}, int(limit) - 20_000) is None


def test_a_real_warning_of_mujoco_is_an_event_and_ends_the_flight():
    loop = new_loop(mission())

    def break_physics(now):
        if now == 2_000_000:
            loop.plant._data.qvel[0] = 1e12

    breaker = Listener()
    breaker.before_tick = break_physics
    loop.listeners.append(breaker)
    log = loop.fly().log
    assert log.status in (MissionStatus.INVALID_STATE, MissionStatus.FLY_AWAY)
    assert any("BADQVEL" in event.data["text"] for event in log.events if event.kind == "warning")
    assert log.column("time")[-1] <= 2.04


@each_autopilot
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_reference_that_is_not_a_number_never_reaches_the_vehicle_and_heals(axis, autopilot):
    class Corrupt:
        """A fault injector of another kind: puts NaN into one way-point."""

        done = spent = False

        def __call__(self, state, time_us):
            if not self.done and time_us > 5_000_000 and state.spec.name == "planning.waypoint":
                self.done = True
                state = state.copy()
                state.header[axis] = np.nan
            return state

        def finish(self):
            return []

    loop = new_loop(mission(autopilot))
    loop.taps.injector = Corrupt()
    flight = loop.fly()
    assert flight.log.meta["rejected_commands"] > 0
    assert np.isfinite(flight.log.columns("x", "y", "z", "vx", "vy", "vz")).all()
    assert flight.log.status in (MissionStatus.SUCCESS, MissionStatus.COLLISION)
    assert flight.log.column("time")[-1] < 40.0
