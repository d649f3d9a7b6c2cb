"""Streams of published states that look like flights, without a simulator."""

import numpy as np

from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.training import Recorder
from mavfi.states import State, floats, new_state

TICK_US = 20_000
HOLD_TICKS = 25
PROVENANCE = {"stack": "published", "platform": "i9-9940x", "v_max": 3.0, "planner": "rrt_connect", "flights": 12}
_BOX = ((0.0, -10.0, 1.0), (60.0, 10.0, 11.0))
_COMMON = {
    "v_max": 3.0,
    "a_max": 5.0,
    "flight": _BOX,
    "goal": (30.0, 0.0, 3.0),
    "control_period": 0.02,
    "planner_latency": 0.073,
    "plan_latency": 0.083,
    "velocity_lag": 0.4,
}
LIMITS = {
    "published": MissionLimits(
        held=True, every_map=False, point_period=0.5, look_ahead=0.3, slowdown_cap=10.0, **_COMMON
    ),
    "hardened": MissionLimits(
        held=False, every_map=True, point_period=0.02, look_ahead=0.0, command_limit=1.08, **_COMMON
    ),
}


def status(time_to_collision: float, sequence: int) -> State:
    state = new_state("perception.collision_status")
    state.header["time_to_collision"] = time_to_collision
    state.header["future_collision_seq"] = sequence
    return state


def waypoint(position, velocity, yaw=0.0, trajectory=1, index=0, duration=0.5) -> State:
    state = new_state("planning.waypoint")
    values = floats(state.header, 11)
    values[:3], values[3], values[4:7], values[10] = position, yaw, velocity, duration
    state.header["trajectory_seq"], state.header["index"] = trajectory, index
    return state


def command(velocity, yaw_rate=0.0) -> State:
    state = new_state("control.command")
    values = floats(state.header, 5)
    values[:3], values[3], values[4] = velocity, yaw_rate, 0.1
    return state


def odometry(position, velocity) -> State:
    state = new_state("sensor.odometry")
    values = floats(state.header, 7)
    values[:3], values[3:6], values[6] = position, velocity, 1.0
    return state


def flight(seed: int, ticks: int = 1500) -> list[tuple[State, int]]:
    """Everything that a flight along random way-points publishes, in order.

    A new trajectory starts at the vehicle every few seconds, after a collision was predicted; its way-points lie at the
    end of half-second intervals that are flown with their velocity.
    """
    random = np.random.default_rng(seed)
    vehicle, speed = np.array([random.uniform(0, 5), random.uniform(-20, 20), 3.0]), np.zeros(3)
    point, velocity, heading = vehicle.copy(), np.zeros(3), random.uniform(-0.5, 0.5)
    events, trajectory, index, sequence, replan, warning = [], 0, 0, 0, 0, 0
    for tick in range(ticks):
        time_us = tick * TICK_US
        events.append((odometry(vehicle, speed), time_us))
        if tick % 15 == 0:
            predicted = 0 < replan - tick <= 16
            sequence += predicted
            warning = tick if predicted else warning
            events.append((status(random.uniform(3, 9) if predicted else 30.0, sequence), time_us))
        if tick == replan:
            trajectory, index, point = trajectory + 1, 0, vehicle.copy()
            heading = random.uniform(-0.8, 0.8)
            replan += HOLD_TICKS * int(random.integers(8, 20))
        if (tick - replan) % HOLD_TICKS == 0:
            heading += random.uniform(-0.3, 0.3)
            pace = random.uniform(1.5, 3.0)
            velocity = np.array([pace * np.cos(heading), pace * np.sin(heading), random.uniform(-0.2, 0.2)])
            point = point + 0.5 * velocity
            events.append((waypoint(point, velocity, heading, trajectory, index), time_us))
            index += 1
        wanted = velocity + 0.3 * (point - vehicle - velocity * (0.02 * (HOLD_TICKS - (tick - replan) % HOLD_TICKS)))
        speed = speed + 0.1 * (wanted - speed)
        vehicle = vehicle + 0.02 * speed
        events.append((command(wanted + random.normal(0, 0.01, 3), random.normal(0, 0.05)), time_us))
    return events


def record(events):
    recorder = Recorder()
    recorder.start()
    for state, time_us in events:
        assert recorder.check(state, time_us) is None
        recorder.accept(state, time_us)
    return recorder.recording()


def fly(detector, events):
    """All alarms: (index of the event, alarm); every publication is accepted as it is."""
    detector.start()
    alarms = []
    for number, (state, time_us) in enumerate(events):
        alarm = detector.check(state, time_us)
        if alarm is not None:
            alarms.append((number, alarm))
        detector.accept(state, time_us)
    return alarms


def strike(events, number, field, value):
    """The same events, one field of one of them changed."""
    state, time_us = events[number]
    struck = state.copy()
    struck.header[field] = value
    return [*events[:number], (struck, time_us), *events[number + 1 :]]


def later(events, name, count):
    """Index of the publication number `count` of a state."""
    return [number for number, (state, _) in enumerate(events) if state.spec.name == name][count]
