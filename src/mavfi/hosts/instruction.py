"""Flights with a fault in an instruction of a kernel: they fork from one golden flight at the struck calls.

The golden flight runs plain kernels.  At a struck call it waits while a forked child makes the call with the fault and
finishes the flight.  Where the child dies (crash, hang, exception), a second child goes on from the same instant as a
ROS graph would: the node's result is lost, and after the restart latency it is there again with fresh memory.  Then the
golden flight itself goes on, to the next struck call.

A detector's false alarm before the fault makes kernels run again, and so shifts the calls: the call that was drawn may
then be shorter than the instruction's index, or have a narrower value there.  In flights with a detector the fault
strikes the first call from there on that has such a bit, as faults in states strike the first publication at or after
an instant.
"""

import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.errors import MavfiError
from mavfi.faults.fault import Fault
from mavfi.faults.instruction import Ended, ForkPoint, InstructionFault, MismatchError, Strike
from mavfi.faults.instruction.api import check_fault, digest
from mavfi.faults.instruction.fault import strike_of
from mavfi.faults.instruction.variant import variant_for
from mavfi.flight_log import FlightLog
from mavfi.hosts.inprocess import Flight, Host
from mavfi.hosts.kernel_faults import DATA, PLANNERS, check_kernel, is_in_data, planned_of
from mavfi.hosts.kernel_output import Output, copied, first_difference, plain_parts
from mavfi.hosts.template import fly_from_template
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.ppc import PERIODIC, build_pipeline
from mavfi.states import STATES, State

TIMEOUT = 60.0
"""Wall-clock limit of a struck flight (s): for what the budget of instructions does not see."""
_PLANNING = ("planner", "trajectory")
_NODES = {kernel: _PLANNING for kernel in _PLANNING}
"""Kernels that share memory, and so die together."""


@dataclass(slots=True)
class _Case:
    """One fault on its way."""

    fault: Fault
    planned: InstructionFault
    restart_us: int
    kernel: str
    call: int
    time_us: int = 0
    strike: Strike | None = None
    how: str = "not_reached"
    detail: str = ""
    report: "_Report | None" = None
    golden: Output | None = None


@dataclass(frozen=True, slots=True)
class _Report:
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
class _Child:
    """What a forked process is there for."""

    point: ForkPoint
    case: _Case
    dead: bool
    call_same: bool = False
    output: Output | None = None


class _Twin:
    """A kernel's function: plain, but for struck calls."""

    def __init__(self, host: "StrikingHost", name: str, function: Callable[..., Any]) -> None:
        self._host, self._name, self._function, self._calls = host, name, function, 0

    def __call__(self, *args: Any) -> Any:
        call, self._calls = self._calls, self._calls + 1
        for case in self._host.cases:
            if case.call == call and case.fault.site.field == self._name and self._host.child is None:
                struck, result = self._host.strike(case, self._function, args)
                if struck:
                    return result
        return self._function(*args)


class StrikingHost(Host):
    """A golden flight from which flights with faults fork.

    Args:
        scenario: The mission.
        faults: In instructions of its kernels.
        detector: What watches all of these flights.
    """

    def __init__(self, scenario: Scenario, faults: Sequence[Fault], detector: Detector | None = None) -> None:
        self.cases = [_case(fault, scenario) for fault in faults]
        self.child: _Child | None = None
        self._awaited: dict[str, list[_Case]] = {}
        self._down: set[str] = set()
        self._latest: dict[str, State] = {}
        self._updates: list[State] = []
        names = tuple(dict.fromkeys(case.fault.site.field for case in self.cases if case.fault.has_site))
        functions = PLAIN.with_twins(names, lambda name, function: _Twin(self, name, function))
        super().__init__(scenario, None, detector, functions=functions)

    # ---- striking ---------------------------------------------------------------------------------------------------
    def strike(self, case: _Case, function: Any, args: tuple[Any, ...]) -> tuple[bool, Any]:
        """Fork at a struck call.

        Args:
            case: The fault.
            function: The compiled function.
            args: Of the call.

        Returns:
            In the golden flight False; in a child True, and the result of the call.
        """
        variant = variant_for(function, args)
        try:
            check_fault(case.planned, variant, function)
        except MismatchError:
            if self.detector is None:
                raise
            case.call += 1  # calls have shifted: this one has arguments of other types
            return False, None
        variant.own_report()
        case.time_us = self.now
        point = ForkPoint()
        ended = point.split(TIMEOUT)
        if ended is None:
            self.child = _Child(point, case, dead=False)
            return True, self._struck_call(variant, function, args)
        case.strike = strike_of(case.planned, variant.report())
        case.how, case.detail = ended.how, ended.detail
        if ended.how == "done":
            report: _Report = pickle.loads(ended.payload)
            if report.missed:
                case.call, case.how = case.call + 1, "not_reached"
                return False, None
            case.report = report
        else:
            point = ForkPoint()
            ended = point.split(TIMEOUT)
            if ended is None:
                self.child = _Child(point, case, dead=True)
                return True, function(*args)
            case.report = _restarted(ended)
        self._awaited.setdefault(case.kernel, []).append(case)
        return False, None

    def _struck_call(self, variant: Any, function: Any, args: tuple[Any, ...]) -> Any:
        """The call with the fault; a child whose data came out the same ends here: the rest is the golden flight."""
        child = self._in_child()
        planned = child.case.planned
        copies = tuple(copied(argument) for argument in args)
        golden = digest(plain_parts((function(*copies), copies)))
        result = variant.inject(planned.index, *planned.masks, planned.budget, *args)
        child.call_same = digest(plain_parts((result, args))) == golden
        report = variant.report()
        if self.detector is not None and _missed(strike_of(planned, report)):
            child.point.finish(pickle.dumps(_Report(None, None, call_same=True, missed=True)))
        if child.call_same and report is not None and report.site.value_class in DATA:
            child.point.finish(pickle.dumps(_Report(None, None, call_same=True)))
        return result

    def _in_child(self) -> _Child:
        assert self.child is not None  # only children come here
        return self.child

    def finish(self, kernel: Kernel, states: list[State], now: int, latency_us: int) -> None:
        """Publish a kernel's results later; those of struck steps are noted, those of dead nodes are lost."""
        child = self.child
        if child is None:
            for case in self._awaited.pop(kernel.name, ()):
                case.golden = Output.of(kernel, states)
        elif child.case.kernel == kernel.name:
            if child.dead:
                child.dead = False
                self._die(kernel.name, now, child.case.restart_us)
                return
            if child.output is None:
                child.output = Output.of(kernel, states)
        if kernel.name not in self._down:
            super().finish(kernel, states, now, latency_us)

    # ---- death and restart of a node --------------------------------------------------------------------------------
    def _die(self, kernel: str, now: int, restart_us: int) -> None:
        names = _NODES.get(kernel, (kernel,))
        self._down.update(names)
        for name in names:
            self.busy[name] = None
        for state in list(self.redo):
            if STATES[state].writer in names:
                del self.redo[state]  # the recomputation died with the node: what it publishes next is judged anew
        self.at(now + restart_us, "restarted", kernel)

    def restarted(self, now: int, kernel: str) -> None:
        """A node is there again: fresh memory, the whole map, and the last message of each state that it reads."""
        names = _NODES.get(kernel, (kernel,))
        fresh = build_pipeline(self.config)
        for name in names:
            self.kernels[name] = fresh[name]
            self._down.discard(name)
            self.busy.pop(name, None)
        for state, readers in self.readers.items():
            self.readers[state] = [self.kernels[reader.name] for reader in readers]
        for name in names:
            self._resume(self.kernels[name], now)

    def _resume(self, kernel: Kernel, now: int) -> None:
        due = False
        node = _NODES.get(kernel.name, (kernel.name,))
        for name in kernel.reads:
            if STATES[name].writer in node:
                continue  # its own outputs, or what passed within the node: a path planned long ago is not flown anew
            messages = self._updates if name == "perception.map_update" else [self._latest.get(name)]
            for state in messages:
                due = (state is not None and kernel.receive(state, now)) or due
        if self.marks:
            kernel.mark()  # what it was sent is not taken back by a recomputation of the step under way
        if due and kernel.name not in PERIODIC:
            self.start(kernel, now)

    def done(self, now: int, name: str, states: list[State]) -> None:
        """The latency of a kernel has passed; what a dead node was about to publish is lost."""
        if name not in self._down:
            super().done(now, name, states)

    def publish(self, state: State, now: int) -> None:
        """Consumers see a value; it is kept for nodes that start again."""
        self._latest[state.spec.name] = state
        if state.spec.name == "perception.map_update":
            self._updates.append(state)
        super().publish(state, now)

    # ---- ends -------------------------------------------------------------------------------------------------------
    def fly_all(self) -> tuple[Flight, list[Flight]]:
        """The golden flight, and the flights with the faults, in their order; children do not come back."""
        try:
            golden = self.fly()
        except BaseException:
            if self.child is None:
                raise
            with self.child.point.guard():
                raise
        if self.child is not None:
            report = _Report(golden.log, self.child.output, self.child.call_same)
            self.child.point.finish(pickle.dumps(report))
        return golden, [self._flight(case, golden) for case in self.cases]

    def _flight(self, case: _Case, golden: Flight) -> Flight:
        log = golden.log if case.report is None or case.report.log is None else case.report.log
        outcome = _outcome(case, golden.log)
        meta = log.meta | {"kernel_outcome": outcome}
        if case.how in ("crash", "hang", "exception"):
            meta["due_end"] = {"status": "due", "success": False}
        log = FlightLog(log.rows, log.status, log.events, [_injection(case)], log.alarms, meta)
        return Flight(log, None, golden.world, golden.pipeline)


@dataclass(frozen=True, slots=True)
class StruckFlights:
    """What `fly_struck` gives back.

    Attributes:
        golden: The flight without a fault; its pipeline is also that of the others.
        flights: With the faults, in their order. `log.meta` has `kernel_outcome`, and `due_end` where the kernel
            crashed, hung or raised: the log is then that of the flight in which its node was started again.
    """

    golden: Flight
    flights: list[Flight] = field(default_factory=list)


def fly_struck(scenario: Scenario, faults: Sequence[Fault], detector: Detector | None = None) -> StruckFlights:
    """Fly one mission with each of some faults in instructions.

    Faults in data fork from one golden flight of this process. Others may read or write any memory, so each of these
    flights is forked from a template, see `mavfi.hosts.template`: it gives the same bytes in every process, if
    addresses can be fixed; the record says so (`replayable`).

    Args:
        scenario: The mission.
        faults: See `mavfi.hosts.kernel_faults`.
        detector: What watches; None = nothing.

    Raises:
        MismatchError: A fault belongs to other machine code.
        BadInputError: The scenario cannot be flown, or it has no such kernel.
    """
    own = [fault for fault in faults if is_in_data(fault)]
    with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
        golden, flights = StrikingHost(scenario, own, detector).fly_all()
    flown = iter(flights)
    return StruckFlights(
        golden,
        [next(flown) if is_in_data(fault) else _forked(scenario, fault, detector, golden) for fault in faults],
    )


def _forked(scenario: Scenario, fault: Fault, detector: Detector | None, golden: Flight) -> Flight:
    _case(fault, scenario)  # refuses what cannot be struck
    log = fly_from_template(scenario, fault, detector, golden.log.digest())
    return Flight(log, None, golden.world, golden.pipeline)


def _case(fault: Fault, scenario: Scenario) -> _Case:
    kernel = fault.site.state
    check_kernel(kernel, scenario.planner.name)
    node = "planner" if kernel in PLANNERS else kernel
    if not fault.has_site:
        return _Case(fault, InstructionFault("", "", 0, call=-1), 0, node, -1)
    planned, restart_s = planned_of(fault)
    return _Case(fault, planned, round(1e6 * restart_s), node, planned.call)


def _missed(strike: Strike) -> bool:
    """Whether nothing was there to be changed."""
    if strike.site is None or strike.before is None or strike.after is None:
        return True
    return not strike.hit and not (strike.before ^ strike.after) & ((1 << strike.site.width) - 1)


def _restarted(ended: Ended) -> _Report:
    if ended.how != "done":
        raise MavfiError(f"the flight with a restarted node ended with {ended.how} ({ended.detail})")
    report: _Report = pickle.loads(ended.payload)
    return report


def _outcome(case: _Case, golden: FlightLog) -> dict[str, Any]:
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


def _injection(case: _Case) -> dict[str, Any]:
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
