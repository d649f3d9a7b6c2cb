"""What is known of a fault in an instruction on its way through a flight, and the record that comes of it."""

import math
from dataclasses import dataclass
from typing import Any

from mavfi.faults.fault import Fault
from mavfi.faults.instruction import InstructionFault, Strike
from mavfi.flight_log import FlightLog
from mavfi.hosts.inprocess import Flight
from mavfi.hosts.kernel_faults import DATA, PLANNERS, check_kernel, planned_of
from mavfi.hosts.kernel_output import Output, first_difference
from mavfi.mission import Scenario

WAITING = "not_reached"
"""How a case stands whose instruction has not come yet."""


@dataclass(frozen=True, slots=True)
class Report:
    """What a child leaves.

    Attributes:
        log: Its record; None where nothing differed at the end of the struck call.
        output: Of the struck step; None where the kernel made none.
        call_same: Whether result and arguments of the struck call are bit for bit the golden ones.
        missed: Whether the call ended before the instruction came, or that instruction's value has no such bit.
    """

    log: FlightLog | None
    output: Output | None
    call_same: bool
    missed: bool = False


@dataclass(slots=True)
class Case:
    """One fault on its way.

    Attributes:
        fault: As drawn.
        planned: What is struck.
        restart_us: After which time a node that died answers again (us).
        kernel: The kernel of the pipeline that is struck.
        call: The call of its function that is struck.
        time_us: When (us).
        strike: What happened at the instruction.
        how: How the call ended, or `WAITING`.
        detail: Signal, budget or exception.
        report: What the child left that flew on.
        golden: What the kernel gives in that step without the fault.
    """

    fault: Fault
    planned: InstructionFault
    restart_us: int
    kernel: str
    call: int
    time_us: int = 0
    strike: Strike | None = None
    how: str = WAITING
    detail: str = ""
    report: Report | None = None
    golden: Output | None = None


def case_of(fault: Fault, scenario: Scenario) -> Case:
    """A fault that nothing has happened of yet.

    Raises:
        BadInputError: The mission has no such kernel.
    """
    kernel = fault.site.state
    check_kernel(kernel, scenario.planner.name)
    node = "planner" if kernel in PLANNERS else kernel
    if not fault.has_site:
        return Case(fault, InstructionFault("", "", 0, call=-1), 0, node, -1)
    planned, restart_s = planned_of(fault)
    return Case(fault, planned, round(1e6 * restart_s), node, planned.call)


def flight_of(case: Case, golden: Flight) -> Flight:
    """The flight with the fault, beside the golden one."""
    log = golden.log if case.report is None or case.report.log is None else case.report.log
    meta = log.meta | {"kernel_outcome": _outcome(case, golden.log)}
    if case.how in ("crash", "hang", "exception"):
        meta["due_end"] = {"status": "due", "success": False}
    log = FlightLog(log.rows, log.status, log.events, [_injection(case)], log.alarms, meta)
    return Flight(log, None, golden.world, golden.pipeline)


def _outcome(case: Case, golden: FlightLog) -> dict[str, Any]:
    """What the kernel did: against its own golden output where both made a step, else against the whole flight."""
    report, difference = case.report, None
    how = case.how
    if how == "done" and report is not None:
        output = report.output
        if report.log is None:
            same = True
        elif output is not None and case.golden is not None:
            same, difference = output.same(case.golden), first_difference(case.golden, output)
        else:
            same = report.call_same and report.log.digest() == golden.digest()
        how = "masked" if same else "sdc"
    return {"outcome": how, "detail": case.detail, "first_difference": difference}


def _injection(case: Case) -> dict[str, Any]:
    """The record of a strike."""
    fault, planned, strike = case.fault, case.planned, case.strike
    data = {
        "level": "instruction", "site": str(fault.site), "time_s": case.time_us / 1e6, "bit": fault.bit,
        "before": None, "after": None, "hit": strike is not None and strike.hit, "kernel": fault.site.state,
        "function": fault.site.field, "stratum": fault.stratum, "replayable": True,
    }  # fmt: skip
    if strike is None or strike.site is None:
        return data
    site = strike.site
    return data | {
        "before": _number(strike.number(strike.before)), "after": _number(strike.number(strike.after)),
        "call": case.call, "index": planned.index, "opcode": site.opcode, "type": site.kind, "width": site.width,
        "value_class": site.value_class, "replayable": site.value_class in DATA, "file": site.file, "line": site.line,
        "inlined": [f"{file}:{line}" for file, line in site.frames[1:]],
        "variable": site.variable or "", "ir_sha256": planned.ir_sha256, "bits": list(planned.bits),
        "model": planned.model,
    }  # fmt: skip


def _number(value: float | int | None) -> float | int | str | None:
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
