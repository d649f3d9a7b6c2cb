"""Runs made by hand: specs and records that no flight gives."""

from dataclasses import replace

from mavfi.analysis.runs import Runs
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.store import Run
from mavfi.faults.fault import FaultSite
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.state.fault import StateFault
from mavfi.record import AlarmRecord, End, EnergyTerms, FlightRecord, Injection, KernelEffect

FAULT = StateFault(FaultSite("planning.waypoint", "x"), 1, 62, "sign_exponent", 0.1875)
INSTRUCTION = InstructionFault("mavfi.pid.track", "ab", 7, bits=(3,), kernel="pid", entry="track", stratum="sign")
GOLDEN = FlightRecord(End.FLOWN, "success", "g", 50.0, 100.0, EnergyTerms(duration_s=50.0))
UNKNOWN = FlightRecord(End.UNKNOWN, error="KeyError")
DUE = FlightRecord(End.DUE, error="the process died each time")
ABOUT = {
    "name": "handmade",
    "title": "campaign handmade",
    "lines": ["9 missions"],
    "profile": "published",
    "on_design_seeds": False,
    "monitored_set": "paper-13",
    "versions": {"numba": "2", "mavfi": "1"},
    "digest": "d" * 64,
    "done": 9,
    "total": 9,
    "each": "stage",
}


def flown(success=True, *, activated=True, time_s=0.3, alarms=(), **changes):
    """Record of a run with a fault; by default another flight than the golden one."""
    status = "success" if success else "collision"
    injection = Injection("state", "planning.waypoint.x", time_s, 62, 1.0, 2.0, activated)
    return replace(
        GOLDEN, **{"status": status, "digest": "x", "injections": (injection,), "alarms": tuple(alarms), **changes}
    )


def died(effect="crash", success=True):
    """Record of a run whose kernel died and whose node was started again."""
    return flown(success, kernel=KernelEffect(effect, "SIGSEGV"))


def alarm(time_s, state="planning.waypoint"):
    return AlarmRecord(time_s, "fake", state, "planning")


def golden(seed, record=GOLDEN, *, arm="", environment="sparse"):
    setting = f"golden_{arm}" if arm else "golden"
    return Run(RunSpec("golden", setting, environment, seed, "key", arm, arm, "paper" if arm else ""), record)


def injected(seed, record, fault=FAULT, *, arm="", index=None, target="planning", environment="sparse"):
    setting = f"dr_{arm}" if arm else "fi"
    profile = "paper" if arm else ""
    position = seed if index is None else index
    return Run(
        RunSpec("injected", setting, environment, seed, "key", arm, arm, profile, "", target, position, fault), record
    )


def null(seed, record, fault=FAULT):
    return Run(RunSpec("null", "null", "sparse", seed, "key", target="null", index=seed, fault=fault), record)


def runs(*entries, **about):
    return Runs.of(entries, {**ABOUT, **about})


def row(record, fault=FAULT, twin=GOLDEN):
    """Row of one run with a fault."""
    entries = [golden(1, twin)] if twin is not None else []
    return list(runs(*entries, injected(1, record, fault)).injected)[0]
