"""Flies a stored run again while looking at everything that is published."""

from dataclasses import dataclass

import numpy as np

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import fly_again
from mavfi.campaign.store import Store
from mavfi.campaign.tools import host_tools
from mavfi.campaign.worker import Tools
from mavfi.detectors.detector import Detector
from mavfi.faults.fault import Fault
from mavfi.hosts.inprocess import Flight, fly
from mavfi.mission import Scenario
from mavfi.states import State


@dataclass(frozen=True, slots=True)
class Publication:
    """One value that consumers saw, and when (us)."""

    time_us: int
    state: State


@dataclass(slots=True)
class Watched:
    """A flight, and all that was published in it, in order."""

    flight: Flight
    publications: list[Publication]


class _Watcher:
    """A host for one flight that keeps what is published."""

    def __init__(self) -> None:
        self.flight: Flight | None = None
        self.publications: list[Publication] = []

    def __call__(
        self, scenario: Scenario, fault: Fault | None, detector: Detector | None, *, want_profile: bool
    ) -> Flight:
        self.flight = fly(scenario, fault, detector, want_profile=want_profile, observer=self._note)
        return self.flight

    def _note(self, state: State, time_us: int) -> None:
        self.publications.append(Publication(time_us, state.copy()))


def fly_watched(store: Store, spec: RunSpec) -> Watched:
    """Fly a run of a ledger again.

    Args:
        store: The ledger.
        spec: The run.

    Raises:
        SpecMismatchError: The detector's model is no longer the one that the run flew with.
    """
    watcher = _Watcher()
    tools = host_tools()
    fly_again(store, spec, Tools(watcher, tools.load_detector, tools.make_scenario))
    assert watcher.flight is not None  # fly_again has flown
    return Watched(watcher.flight, watcher.publications)


@dataclass(frozen=True, slots=True)
class Difference:
    """The first thing in which two flights differ.

    Attributes:
        time_us: When the second published it.
        state: Which state.
        field: Which field, with its element; "" where they differ in the order or the instant of publications.
        golden: Value in the first.
        injected: Value in the second.
    """

    time_us: int
    state: str
    field: str
    golden: object
    injected: object


def first_difference(golden: list[Publication], injected: list[Publication]) -> Difference | None:
    """The first publication in which two flights differ; None if they are the same, bit for bit."""
    for first, second in zip(golden, injected, strict=False):
        name = second.state.spec.name
        if first.state.spec is not second.state.spec or first.time_us != second.time_us:
            before = f"{first.state.spec.name} at {1e-6 * first.time_us:.3f} s"
            return Difference(second.time_us, name, "", before, f"{name} at {1e-6 * second.time_us:.3f} s")
        if not first.state.same_bits(second.state):
            return _field(first.state, second.state, second.time_us)
    if len(golden) == len(injected):
        return None
    longer = max(golden, injected, key=len)[min(len(golden), len(injected))]
    ends = ("ended", "went on") if len(injected) > len(golden) else ("went on", "ended")
    return Difference(longer.time_us, longer.state.spec.name, "", *ends)


def _field(first: State, second: State, time_us: int) -> Difference:
    spec = second.spec
    if len(first.elements) != len(second.elements):
        counts = (f"{len(state.elements)} elements" for state in (first, second))
        return Difference(time_us, spec.name, "", *counts)
    for before, after, is_list in ((first.header, second.header, False), (first.elements, second.elements, True)):
        for name in after.dtype.names or ():
            row = _first_row(before[name], after[name])
            if row is not None:
                label = f"{name}[{row}]" if is_list else name
                return Difference(time_us, spec.name, label, before[name][row].item(), after[name][row].item())
    raise AssertionError(f"{spec.name}: bits differ and no field does")


def _first_row(before: np.ndarray, after: np.ndarray) -> int | None:
    """First element whose bits differ; NaNs and zeros compare as bits."""
    size = before.dtype.itemsize
    bits = [np.ascontiguousarray(values).view(np.uint8).reshape(-1, size) for values in (before, after)]
    rows = np.flatnonzero((bits[0] != bits[1]).any(axis=1))
    return int(rows[0]) if len(rows) else None
