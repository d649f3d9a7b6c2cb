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
from mavfi.hosts.instruction import fly_struck
from mavfi.mission import Scenario
from mavfi.states import State


@dataclass(frozen=True, slots=True)
class Publication:
    """One value that consumers saw, and when (us)."""

    time_us: int
    state: State


@dataclass(slots=True)
class Watched:
    """A flight, and all that was published in it, in order; nothing of a flight that ended in a forked process."""

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
        if fault is not None and fault.level == "instruction":
            self.flight = fly_struck(scenario, [fault], detector).flights[0]
            return self.flight
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
    """The first publication in which two flights differ: the n-th of a state in one beside the n-th in the other.

    Attributes:
        state: Which state.
        field: Which field, with its element; "" where the value is the same and only the instant differs, or where
            one of the flights has no such publication.
        golden_us: When the golden flight published it; None = it did not.
        injected_us: When the other one did; None = it did not.
        golden: Value in the golden flight; None without a field.
        injected: Value in the other one; None without a field.
    """

    state: str
    field: str
    golden_us: int | None
    injected_us: int | None
    golden: object = None
    injected: object = None

    @property
    def time_us(self) -> int:
        """When the flights began to differ: the earlier of the two instants."""
        return min(time for time in (self.golden_us, self.injected_us) if time is not None)


def first_difference(golden: list[Publication], injected: list[Publication]) -> Difference | None:
    """The first publication that differs in value or instant; None if flights are the same, bit for bit.

    Publications are compared by state and number, so that one that is held back is found beside its own twin.

    Args:
        golden: All publications of one flight, in order.
        injected: Of the other one.
    """
    numbered = _numbered(golden), _numbered(injected)
    found: Difference | None = None
    for key in dict.fromkeys((*numbered[0], *numbered[1])):  # in the order of the data flow: it decides between equals
        first, second = (publications.get(key) for publications in numbered)
        times = [publication.time_us for publication in (first, second) if publication is not None]
        if found is not None and min(times) >= found.time_us:
            continue
        found = _difference(key[0], first, second) or found
    return found


def _numbered(publications: list[Publication]) -> dict[tuple[str, int], Publication]:
    """Publications by state and number, in order."""
    counts: dict[str, int] = {}
    found = {}
    for publication in publications:
        name = publication.state.spec.name
        counts[name] = counts.get(name, 0) + 1
        found[name, counts[name]] = publication
    return found


def _difference(name: str, first: Publication | None, second: Publication | None) -> Difference | None:
    if first is None or second is None:
        times = (None if publication is None else publication.time_us for publication in (first, second))
        return Difference(name, "", *times)
    if not first.state.same_bits(second.state):
        field, before, after = _field(first.state, second.state)
        return Difference(name, field, first.time_us, second.time_us, before, after)
    if first.time_us != second.time_us:
        return Difference(name, "", first.time_us, second.time_us)
    return None


def _field(first: State, second: State) -> tuple[str, object, object]:
    """First field whose bits differ, and its values; lists of different lengths differ in their number of elements."""
    spec = second.spec
    if len(first.elements) != len(second.elements):
        return "number of elements", len(first.elements), len(second.elements)
    for before, after, is_list in ((first.header, second.header, False), (first.elements, second.elements, True)):
        for name in after.dtype.names or ():
            row = _first_row(before[name], after[name])
            if row is not None:
                return f"{name}[{row}]" if is_list else name, before[name][row].item(), after[name][row].item()
    raise AssertionError(f"{spec.name}: bits differ and no field does")


def _first_row(before: np.ndarray, after: np.ndarray) -> int | None:
    """First element whose bits differ; NaNs and zeros compare as bits."""
    size = before.dtype.itemsize
    bits = [np.ascontiguousarray(values).view(np.uint8).reshape(-1, size) for values in (before, after)]
    rows = np.flatnonzero((bits[0] != bits[1]).any(axis=1))
    return int(rows[0]) if len(rows) else None
