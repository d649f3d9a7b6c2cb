"""Runs of ledgers flown again on request, each once, in a process of its own."""

import multiprocessing
import signal
from collections import OrderedDict
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mavfi.errors import MavfiError
from mavfi.plugins import plugin_failure

if TYPE_CHECKING:
    from mavfi.campaign.plan import RunSpec
    from mavfi.flight.host import Flight
    from mavfi.report.html.flight_page import FlightPage

MAX_FLIGHTS = 200
"""Largest number of flights whose pages are kept in memory, about 100 kB each; those used last are kept."""


class RunKey(NamedTuple):
    """A flown run: its ledger, its id, and the digest of its flight, which differs if another campaign took its place.

    Attributes:
        directory: Folder of the ledger.
        run_id: Id of the run.
        digest: Digest of the stored flight.
        partner: Run with the same fault in another setting; None = there is none.
    """

    directory: Path
    run_id: str
    digest: str
    partner: str | None


class FlownPage(NamedTuple):
    """The page of a run as JSON, or why there is none; one of them is empty."""

    json: str
    refusal: str


class RequestedFlights:
    """Flies runs again, one at a time, and keeps their pages; a run that is being flown is not flown twice."""

    def __init__(self) -> None:
        self._pages: OrderedDict[RunKey, Future[FlownPage]] = OrderedDict()
        self._process: ProcessPoolExecutor | None = None
        self._workers: set[BaseProcess] = set()

    def page(self, run: RunKey) -> "Future[FlownPage]":
        """The page of a run, ready or under way."""
        if run not in self._pages:
            self._pages[run] = self._fly(run)
        self._pages.move_to_end(run)
        while len(self._pages) > MAX_FLIGHTS:
            self._pages.popitem(last=False)
        return self._pages[run]

    def forget(self, run: RunKey) -> None:
        """Forget a run that was not flown, so that the next request tries it again."""
        self._pages.pop(run, None)

    def close(self) -> None:
        """End the process that flies, also within a flight."""
        if self._process is not None:
            for worker in self._workers:
                worker.terminate()
            self._process.shutdown(wait=False, cancel_futures=True)

    def _fly(self, run: RunKey) -> "Future[FlownPage]":
        # The process keeps its compiled code between flights.  It is spawned: a fork of threads may hang.
        if self._process is None:
            spawning = multiprocessing.get_context("spawn")
            self._process = ProcessPoolExecutor(1, mp_context=spawning, initializer=_leave_ctrl_c_to_the_server)
        others = set(multiprocessing.active_children())
        try:
            flight = self._process.submit(flown_page, run)
            self._workers |= set(multiprocessing.active_children()) - others  # the first flight starts it
            return flight
        except BrokenProcessPool:  # it ended in an earlier flight, e.g. was killed
            self._process = None
            return self._fly(run)


def _leave_ctrl_c_to_the_server() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def flown_page(run: RunKey) -> FlownPage:
    """Fly a run again, with its golden run and its partner, and return its page."""
    from mavfi.report.html.page import as_json

    try:
        return FlownPage(as_json(_page_of(run).to_json()), "")
    except MavfiError as error:
        return FlownPage("", str(error))
    except Exception as error:
        if plugin_failure(error):
            return FlownPage("", plugin_failure(error))
        raise


def _page_of(run: RunKey) -> "FlightPage":
    from mavfi.campaign.replay import explain, flight_again
    from mavfi.campaign.store import Store
    from mavfi.report.html.flight_page import page_of_explanation

    with Store.open(run.directory) as store:
        spec = store.run(run.run_id).spec
        if spec.fault is None:
            return _page_without_fault(run, spec, flight_again(store, spec))
    return page_of_explanation(run.directory, explain(run.directory, run.run_id), run.partner, run.directory)


def _page_without_fault(run: RunKey, spec: "RunSpec", flight: "Flight") -> "FlightPage":
    """The page of a golden run."""
    from mavfi.report.explain import OTHER_DIGEST, Story, detector_name, end_of
    from mavfi.report.html.flight_page import GOLDEN, NO_FAULT, Course, FlightPage

    label = NO_FAULT
    if spec.detector:
        label += f" with detector {detector_name(spec)}"
    story: Story = [("verdict", end_of(flight.log)), ("flight", f"without a fault; {end_of(flight.log)}")]
    if flight.log.digest() != run.digest:
        story.append(("note", OTHER_DIGEST))
    commands = [("fly it again, compare digests", f"mavfi replay {run.directory} {spec.run_id}")]
    context = f"{spec.environment} · seed {spec.seed} · {spec.setting} · {spec.run_id}"
    return FlightPage.of(context, story, commands, [Course(GOLDEN, label, flight.log)], flight.world)
