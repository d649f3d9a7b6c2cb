"""Faults in registers keep the contract of all levels."""

from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.registers.level import RegisterLevel
from mavfi.flight.host import RunResult
from mavfi.levels.level import Sampled
from mavfi.record import End, FlightRecord
from mavfi.testing import HostContract, LevelContract
from tests.core.unit.analysis.handmade import flown, row


class TestRegister(LevelContract):
    level = RegisterLevel
    faults = [RegisterFault("fp", "read", symbol="f", node="pid", time_us=5, seed=3), RegisterFault()]
    campaign = {"host": "firmware", "mission": {"flight_controller": "betaflight"}}
    golden = {"": Sampled(RunResult(FlightRecord(End.FLOWN, flight_time_s=30.0)))}


class TestLocalHost(HostContract):
    host = "local"
    fault = RegisterFault()


def test_a_row_names_the_registers():
    assert row(flown(), RegisterFault("general", seed=1))["register"] == "general"
