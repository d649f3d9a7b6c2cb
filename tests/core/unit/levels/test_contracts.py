"""mavfi's own levels keep the contract of all levels."""

import numpy as np

from mavfi.faults.changes import parse_text
from mavfi.faults.fault import FaultSite
from mavfi.flight.host import Flight, RunResult
from mavfi.levels.instruction import InstructionLevel
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.level import Sampled
from mavfi.levels.memory import MemoryLevel
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.message import MessageLevel
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.sensor import SensorLevel
from mavfi.levels.sensor.fault import SensorFault
from mavfi.levels.state import StateLevel
from mavfi.levels.state.fault import StateFault
from mavfi.record import End, FlightRecord, Profile
from mavfi.states import STATES
from mavfi.testing import HostContract, LevelContract

PROFILE = Profile(
    {name: np.arange(9, dtype=np.int64) for name in STATES}, {name: np.full(9, 3, np.int32) for name in STATES}
)
FAULTS = [MemoryFault("pid", "remaining", None, "f8", 20_000, number) for number in range(4)]


class TestState(LevelContract):
    level = StateLevel
    faults = [
        StateFault(FaultSite("planning.waypoint", "x"), 20_000_000, 62),
        StateFault(FaultSite("planning.trajectory", "x", 3), 5, 60, lasts_s=1.5, share=0.2, width=4, times=3, seed=7),
        StateFault(FaultSite("control.command", "vx"), bit=None, lasts_s=float("inf")),
        StateFault(FaultSite("control.command", "vx"), 5, change=parse_text("set=nan:times=3:every=2@0..9")),
        StateFault(FaultSite("planning.waypoint", "y"), 7, 62, seed=7, change=parse_text("flip:share=0.5@index>3")),
    ]
    golden = {"": Sampled(Flight(None, PROFILE))}


class TestMessage(LevelContract):
    level = MessageLevel
    faults = [
        MessageFault("planning.path", time_us=3_000_000, change=parse_text("drop:times=4")),
        MessageFault("control.command", seed=5, change=parse_text("delay=0.2:times=0:share=0.1")),
    ]
    golden = {"": Sampled(Flight(None, PROFILE))}


class TestMemory(LevelContract):
    level = MemoryLevel
    faults = [*FAULTS, MemoryFault("waypoint", "points", 33, "f8", 20_000_000)]
    golden = {"": Sampled(None, faults={("memory", ""): FAULTS})}


class TestInstruction(LevelContract):
    level = InstructionLevel
    faults = [
        InstructionFault("", "ab" * 32, 42, 7, (3, 60), budget=10, kernel="pid", entry="track", model="bits"),
        InstructionFault("m.f", "ab" * 32, 42, value=1 << 90),
    ]
    campaign = {"sampling": {"kernels": ["pid"]}}
    golden = {"": Sampled(None, faults={("pid", ""): faults})}


class TestSensor(LevelContract):
    level = SensorLevel
    faults = [SensorFault("gyro", "drift", 10_000_000), SensorFault("motor", "garbage", 5, 2.0, 3, seed=4)]
    golden = {"": Sampled(RunResult(FlightRecord(End.FLOWN, flight_time_s=30.0)))}


class TestLocalHost(HostContract):
    host = "local"
