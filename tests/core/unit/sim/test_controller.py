"""Flight controllers: found by name, called once per period, replaced without a change to the vehicle."""

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.flight.compose import resolve
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fly import fly
from mavfi.flight.from_take_off import FromTakeOff
from mavfi.mission import MissionSpec
from mavfi.sim.cascade import Cascade
from mavfi.sim.engine import GRAVITY
from mavfi.sim.simulator import Simulator
from tests.core.unit.sim.flights import open_world, scenario

HERE = "tests.core.unit.sim.test_controller"


class Called:
    """Our cascade behind the interface: called from Python, period by period."""

    period_us = 4_000
    rewindable = True

    def __init__(self, start):
        self.inner, self.closed = Cascade(start), 0
        for name in ("rotors", "save", "restore"):
            setattr(self, name, getattr(self.inner, name))

    def close(self):
        self.closed += 1


class Fast(Called):
    """At 1 kHz, with full thrust on all rotors, or none, or not a number."""

    period_us = 1_000
    rewindable = False
    thrust = np.inf

    def __init__(self, start):
        self.calls = []
        self.start = start

    def rotors(self, time_us, setpoint, odometry, force):
        self.calls.append((time_us, setpoint.copy(), odometry.copy(), force.copy()))
        return np.full(4, self.thrust)

    def close(self):
        pass


class Odd(Called):
    period_us = 3_000


class Broken:
    period_us = 1_000

    def __init__(self, start):
        raise OSError("no firmware")


def flight(name, **changes):
    return Simulator(open_world(), scenario().model_copy(update={"flight_controller": f"{HERE}:{name}", **changes}))


def test_the_same_controller_flies_the_same_bits_behind_the_interface():
    """The compiled loop and the interface are two ways through the same arithmetic, expiry of a command included."""
    called, compiled = flight("Called"), Simulator(open_world(), scenario())
    for tick, command in enumerate([(2.0, 1.0, 0.5, 0.3), (0.0, -2.0, 0.0, -1.0), (3.0, 0.0, -0.5, 0.0)] * 5):
        for flown_by in (called, compiled):
            flown_by.command(np.array(command), 0.09)
            flown_by.advance((tick + 1) * 100_000)
        assert called.odometry.tobytes() == compiled.odometry.tobytes()
    assert np.linalg.norm(called.odometry[3:6]) > 1.0
    assert called.snapshot()._content() == compiled.snapshot()._content()


def test_a_controller_is_called_once_per_period_with_the_state_and_the_command_in_force():
    flown_by = flight("Fast")
    flown_by.command(np.array([1.0, 2.0, 3.0, 0.5]), 0.002)
    flown_by.advance(8_000)
    times, setpoints, states, forces = zip(*flown_by.controller.calls, strict=True)
    assert times == tuple(range(0, 8_000, 1_000))
    assert [bool(point.any()) for point in setpoints] == [True] * 2 + [False] * 6
    assert states[0].tobytes() == flown_by.controller.start.odometry.tobytes() != states[-1].tobytes()
    assert forces[-1][2] > GRAVITY  # it climbs


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (f"{HERE}:Odd", "its period_us is 3000; allowed: 4000 divided by an integer"),
        (f"{HERE}:Broken", "cannot be built \\(OSError: no firmware\\)"),
        ("none_such", "flight controller 'none_such': not known; allowed: .*cascade"),
    ],
)
def test_a_controller_that_cannot_fly_is_refused_in_one_line(name, text):
    with pytest.raises(BadInputError, match=text):
        Simulator(open_world(), scenario().model_copy(update={"flight_controller": name}))


def test_a_mission_checks_the_name_and_keeps_its_key_without_one():
    with pytest.raises(BadInputError, match="flight controller 'none_such'"):
        resolve(MissionSpec(flight_controller="none_such"))
    plain = resolve(MissionSpec())
    assert "flight_controller" not in plain.to_json()
    other = resolve(MissionSpec(flight_controller=f"{HERE}:Called"))
    assert other.to_json()["flight_controller"] == f"{HERE}:Called" and other.key() != plain.key()


def test_a_controller_without_a_saved_state_is_neither_fast_forwarded_nor_forked():
    mission = resolve(MissionSpec(flight_controller=f"{HERE}:Fast"))
    with pytest.raises(Exception, match="are not fast-forwarded"):
        FastForward(mission)
    with pytest.raises(BadInputError, match="faults in instructions fork the flight"):
        FromTakeOff(mission, [])


def test_the_controller_is_released_when_the_flight_ends(monkeypatch):
    released = []
    monkeypatch.setattr(Fast, "close", lambda self: released.append(self))
    fly(resolve(MissionSpec(flight_controller=f"{HERE}:Fast")))  # full thrust: it flies away
    assert len(released) == 1
