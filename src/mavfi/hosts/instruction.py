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

import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.errors import MavfiError
from mavfi.faults.fault import Fault
from mavfi.faults.instruction import Ended, ForkPoint, MismatchError, Strike
from mavfi.faults.instruction.api import check_fault, digest
from mavfi.faults.instruction.fault import strike_of
from mavfi.faults.instruction.variant import variant_for
from mavfi.hosts.beginning import Beginning, beginning_of, fly_until
from mavfi.hosts.inprocess import Flight, Host
from mavfi.hosts.kernel_faults import DATA, is_in_data
from mavfi.hosts.kernel_output import Output, copied, plain_parts
from mavfi.hosts.struck import WAITING, Case, Report, case_of, flight_of
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
class _Child:
    """What a forked process is there for."""

    point: ForkPoint
    case: Case
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
        self.cases = [case_of(fault, scenario) for fault in faults]
        self.child: _Child | None = None
        self._awaited: dict[str, list[Case]] = {}
        self._down: set[str] = set()
        self._latest: dict[str, State] = {}
        self._updates: list[State] = []
        names = tuple(dict.fromkeys(case.fault.site.field for case in self.cases if case.fault.has_site))
        functions = PLAIN.with_twins(names, lambda name, function: _Twin(self, name, function))
        super().__init__(scenario, None, detector, functions=functions)

    # ---- striking ---------------------------------------------------------------------------------------------------
    def strike(self, case: Case, function: Any, args: tuple[Any, ...]) -> tuple[bool, Any]:
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
            report: Report = pickle.loads(ended.payload)
            if report.missed:
                case.call, case.how = case.call + 1, WAITING
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
            child.point.finish(pickle.dumps(Report(None, None, call_same=True, missed=True)))
        if child.call_same and report is not None and report.site.value_class in DATA:
            child.point.finish(pickle.dumps(Report(None, None, call_same=True)))
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
        golden = self._fly(lambda: False)
        assert golden is not None  # it was not stopped
        return golden, [flight_of(case, golden) for case in self.cases]

    def fly_to_strikes(self) -> tuple[Beginning, list[Case]]:
        """Fly until all has happened that there is to know of the faults; children do not come back."""
        self._fly(self._all_known)
        return beginning_of(self), self.cases

    def _all_known(self) -> bool:
        return self.child is None and not self._awaited and all(case.how != WAITING for case in self.cases)

    def _fly(self, enough: Callable[[], bool]) -> Flight | None:
        """Fly to the end, or until it is enough; a child reports, and ends."""
        try:
            golden = fly_until(self, enough)
        except BaseException:
            if self.child is None:
                raise
            with self.child.point.guard():
                raise
        if self.child is not None:
            assert golden is not None  # for a child it is never enough
            report = Report(golden.log, self.child.output, self.child.call_same)
            self.child.point.finish(pickle.dumps(report))
        return golden


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


def fly_struck(
    scenario: Scenario, faults: Sequence[Fault], detector: Detector | None = None, golden: Flight | None = None
) -> StruckFlights:
    """Fly one mission with each of some faults in instructions.

    Faults in data fork from one golden flight of this process. Others may read or write any memory, so each of these
    flights is forked from a template, see `mavfi.hosts.template`: it gives the same bytes in every process, if
    addresses can be fixed; the record says so (`replayable`).

    Args:
        scenario: The mission.
        faults: See `mavfi.hosts.kernel_faults`.
        detector: What watches; None = nothing.
        golden: The flight of this mission without a fault, with this detector, if it has been flown: then golden
            flights go on only until all faults have struck.

    Raises:
        MismatchError: A fault belongs to other machine code.
        BadInputError: The scenario cannot be flown, or it has no such kernel.
        MavfiError: The golden flight is another one.
    """
    own = [fault for fault in faults if is_in_data(fault)]
    in_data: Iterator[Flight] = iter(())
    if golden is None or own:
        with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
            golden, flights = _fork(StrikingHost(scenario, own, detector), golden)
        in_data = iter(flights)
    return StruckFlights(
        golden,
        [next(in_data) if is_in_data(fault) else _forked(scenario, fault, detector, golden) for fault in faults],
    )


def _fork(host: StrikingHost, golden: Flight | None) -> tuple[Flight, list[Flight]]:
    if golden is None:
        return host.fly_all()
    beginning, cases = host.fly_to_strikes()
    beginning.check(golden.log)
    return golden, [flight_of(case, golden) for case in cases]


def _forked(scenario: Scenario, fault: Fault, detector: Detector | None, golden: Flight) -> Flight:
    case_of(fault, scenario)  # refuses what cannot be struck
    beginning, case, replayable = fly_from_template(scenario, fault, detector)
    beginning.check(golden.log)
    flight = flight_of(case, golden)
    flight.log.injections[0]["replayable"] = replayable
    return flight


def _missed(strike: Strike) -> bool:
    """Whether nothing was there to be changed."""
    if strike.site is None or strike.before is None or strike.after is None:
        return True
    return not strike.hit and not (strike.before ^ strike.after) & ((1 << strike.site.width) - 1)


def _restarted(ended: Ended) -> Report:
    if ended.how != "done":
        raise MavfiError(f"the flight with a restarted node ended with {ended.how} ({ended.detail})")
    report: Report = pickle.loads(ended.payload)
    return report
