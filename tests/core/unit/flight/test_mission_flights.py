"""Which flights of a mission are fast-forwarded, and what becomes of those that cannot be flown."""

import pytest

from mavfi.extras.registers.fault import RegisterFault
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fly import fly
from mavfi.flight.host import ArmSetup
from mavfi.flight.mission_flights import LocalHost
from mavfi.sim.simulator import Simulator
from tests.core.flights.missions import fault, mission

WRONG_SPEED = fault("control.command", "vx", 4.0, 62)
EMPTY_MASK = fault("control.command", "vx", 4.0)


@pytest.mark.parametrize(
    ("host", "injected", "is_wanted"),
    [
        (LocalHost(), EMPTY_MASK, True),  # its purpose is to exercise the injector
        (LocalHost(), WRONG_SPEED, False),
        (LocalHost(lambda world, scenario: Simulator(world, scenario)), WRONG_SPEED, True),
    ],
    ids=["null fault", "not wanted", "another vehicle"],
)
def test_what_is_not_fast_forwarded_is_flown_from_take_off(monkeypatch, host, injected, is_wanted):
    monkeypatch.setattr(FastForward, "fly", None)
    flights = host.mission({"": ArmSetup(mission())}, fast_forward=is_wanted)
    ((_, flight),) = flights.injected([("", injected)])
    assert flight.log.digest() == fly(mission(), injected).log.digest()


def test_an_exception_or_an_impossible_fault_ends_its_own_run_only(monkeypatch):
    flights = LocalHost().mission({"": ArmSetup(mission())})
    flights.golden("")
    with monkeypatch.context() as patch:
        patch.setattr(FastForward, "fly", lambda *_: 1 / 0)
        [(_, error)] = flights.injected([("", WRONG_SPEED)])
    assert isinstance(error, ZeroDivisionError)
    ended = dict(flights.injected([("", RegisterFault()), ("", WRONG_SPEED)]))
    assert "level 'register': allowed: combined, instruction, memory, message, sensor, state" in str(ended[0])
    assert ended[1].log.digest() == fly(mission(), WRONG_SPEED).log.digest()
