"""Fault injection, anomaly detection and recovery for autonomous UAVs, measured on whole missions.

The public names below are imported at first use, so that `import mavfi` is fast; see `mavfi.api`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mavfi.version import __version__

_PUBLIC = {
    "fly": "mavfi.api",
    "draw": "mavfi.api",
    "run": "mavfi.api",
    "load": "mavfi.api",
    "compare": "mavfi.api",
    "table": "mavfi.api",
    "figure": "mavfi.api",
    "allow_plugins": "mavfi.plugins",
    "MissionSpec": "mavfi.mission",
    "Scenario": "mavfi.mission",
    "MissionStatus": "mavfi.mission",
    "StateFault": "mavfi.levels.state.fault",
    "InstructionFault": "mavfi.levels.instruction.fault",
    "MessageFault": "mavfi.levels.message.fault",
    "MemoryFault": "mavfi.levels.memory.fault",
    "RegisterFault": "mavfi.extras.registers.fault",
    "FaultSite": "mavfi.faults.fault",
    "Fault": "mavfi.faults.fault",
    "SensorFault": "mavfi.levels.sensor.fault",
    "Injection": "mavfi.record",
    "FlightLog": "mavfi.record",
    "FlightRecord": "mavfi.record",
    "Effect": "mavfi.outcomes",
    "QoF": "mavfi.outcomes",
    "STATES": "mavfi.states",
    "KERNELS": "mavfi.states",
    "Campaign": "mavfi.campaign.config",
    "Runs": "mavfi.analysis.runs",
    "Alarm": "mavfi.detectors.detector",
    "Detector": "mavfi.detectors.detector",
    "FlightResult": "mavfi.report.flight_result",
    "BadInputError": "mavfi.errors",
    "MavfiError": "mavfi.errors",
}

__all__ = ["__version__", *_PUBLIC]

if TYPE_CHECKING:
    from mavfi.analysis.runs import Runs as Runs
    from mavfi.api import compare as compare
    from mavfi.api import draw as draw
    from mavfi.api import figure as figure
    from mavfi.api import fly as fly
    from mavfi.api import load as load
    from mavfi.api import run as run
    from mavfi.api import table as table
    from mavfi.campaign.config import Campaign as Campaign
    from mavfi.detectors.detector import Alarm as Alarm
    from mavfi.detectors.detector import Detector as Detector
    from mavfi.errors import BadInputError as BadInputError
    from mavfi.errors import MavfiError as MavfiError
    from mavfi.extras.registers.fault import RegisterFault as RegisterFault
    from mavfi.faults.fault import Fault as Fault
    from mavfi.faults.fault import FaultSite as FaultSite
    from mavfi.levels.instruction.fault import InstructionFault as InstructionFault
    from mavfi.levels.memory.fault import MemoryFault as MemoryFault
    from mavfi.levels.message.fault import MessageFault as MessageFault
    from mavfi.levels.sensor.fault import SensorFault as SensorFault
    from mavfi.levels.state.fault import StateFault as StateFault
    from mavfi.mission import MissionSpec as MissionSpec
    from mavfi.mission import MissionStatus as MissionStatus
    from mavfi.mission import Scenario as Scenario
    from mavfi.outcomes import Effect as Effect
    from mavfi.outcomes import QoF as QoF
    from mavfi.plugins import allow_plugins as allow_plugins
    from mavfi.record import FlightLog as FlightLog
    from mavfi.record import FlightRecord as FlightRecord
    from mavfi.record import Injection as Injection
    from mavfi.report.flight_result import FlightResult as FlightResult
    from mavfi.states import KERNELS as KERNELS
    from mavfi.states import STATES as STATES


def __getattr__(name: str) -> Any:  # noqa: ANN401 (one of the names above)
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
