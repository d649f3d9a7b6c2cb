"""Executor on Dask workers, on one machine or many: a mission is a task; only the campaign's process writes.

A Dask worker flies in a separate process, which a fault may crash.  Items of a mission are sent to the campaign as
events during the flights.
"""

import contextlib
import itertools
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pickle import dumps, loads
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

from mavfi.campaign.executors.executor import Done, Lost
from mavfi.campaign.executors.local import TIME_LIMIT
from mavfi.campaign.executors.process import Raised, Worker, is_last
from mavfi.campaign.fingerprint import difference, fingerprint
from mavfi.errors import BadInputError, MachineError, MavfiError, not_installed
from mavfi.extras.dask.worker import start_worker
from mavfi.plugins import allow_names, allowed_names

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

LOOPBACK = "127.0.0.1"
_TASKS_PER_THREAD = 2
"""Tasks per worker thread: one in progress, one waiting."""
_SEND_EVERY_S = 0.5
"""Least time between two events with the items of a mission."""
_LOOK_EVERY_S = 1.0
"""Time between two looks at the tasks."""
_PATIENCE_S = 60.0
"""Time-out for the last items of an ended task, and for the connection to a scheduler."""

_GONE = "the Dask scheduler is gone"

T = TypeVar("T")
R = TypeVar("R")


class DaskExecutor:
    """Runs missions on the workers of a Dask scheduler.

    Args:
        scheduler: Its address, e.g. "tcp://10.0.0.1:8786" or "tls://..." (certificates: Dask's configuration); "" = a
            cluster of processes on this machine, which listens on the loopback interface only.
        workers: Number of processes of the local cluster.

    Raises:
        NotInstalledError: Dask is not installed.
        BadInputError: `workers` is below 1.
    """

    forks = False

    def __init__(self, scheduler: str = "", workers: int = 2) -> None:
        try:
            import distributed  # noqa: F401 - an extra
        except ImportError:
            raise not_installed("--executor dask", "distributed", "cluster") from None
        if workers < 1:
            raise BadInputError(f"executor 'dask': workers: {workers}: allowed: >= 1")
        self._scheduler = scheduler
        self._has_connected = False
        self.workers = workers
        if scheduler:
            self.workers = 0  # as many as the cluster has

    def map(
        self, function: Callable[[T], Iterator[R]], missions: Iterable[T]
    ) -> Generator[tuple[T, Sequence[R | Done | Lost]], None, None]:
        """See `Executor.map`.

        Raises:
            BadInputError: No scheduler responds, or a worker has different code, versions or architecture.
            MachineError: The connection to the scheduler is lost, or the local cluster does not start.
        """
        with self._connected() as client:
            flights = _Flights(client, function)
            try:
                yield from flights.fly(iter(missions))
            finally:
                flights.cancel()

    @contextlib.contextmanager
    def _connected(self) -> "Iterator[Client]":
        from distributed import Client
        from distributed.utils import silence_logging_cmgr

        with contextlib.ExitStack() as stack:
            stack.enter_context(silence_logging_cmgr("CRITICAL"))
            where: Any = self._scheduler or stack.enter_context(self._local())
            try:
                client = stack.enter_context(Client(where, set_as_default=False, timeout=_PATIENCE_S))
            except (OSError, ValueError) as error:
                reason = " ".join(str(error).split())
                if self._has_connected:
                    raise MachineError(f"{_GONE} ({reason})") from None
                raise BadInputError(f"--scheduler: {self._scheduler}: no scheduler answers ({reason})") from None
            self._has_connected = True
            yield client

    def _local(self) -> "LocalCluster":
        """A cluster of processes on this machine; raises a `MachineError` if one of them dies at its start."""
        from distributed import LocalCluster

        try:
            return LocalCluster(
                n_workers=self.workers,
                threads_per_worker=1,
                host=LOOPBACK,
                dashboard_address=f"{LOOPBACK}:0",
                silence_logs="CRITICAL",
            )
        except RuntimeError as error:
            raise MachineError(f"the local Dask cluster did not start ({error})") from error


@dataclass(slots=True)
class _Ticket:
    """A mission submitted to the scheduler.

    Attributes:
        mission: The mission.
        future: Its task.
        ended: When its task was seen to have ended (s); its last items may still be in transit. 0 = it runs.
    """

    mission: Any
    future: "Future"
    ended: float = 0.0


class _Flights:
    """The missions of one call of `map`, and their items."""

    def __init__(self, client: "Client", function: Callable[[Any], Iterator[Any]]) -> None:
        self._client = client
        self._topic = f"mavfi-{uuid.uuid4().hex}"
        self._order = dumps((function, fingerprint(), allowed_names(), self._topic))
        self._news: SimpleQueue[tuple[str, Sequence[Any]]] = SimpleQueue()
        self._tickets: dict[str, _Ticket] = {}
        self._threads = 1
        self._looked = -_LOOK_EVERY_S

    def fly(self, missions: Iterator[Any]) -> Iterator[tuple[Any, Sequence[Any]]]:
        """Submit missions, only a few more than the workers can fly, and yield their items as they arrive."""
        self._client.subscribe_topic(self._topic, lambda event: self._news.put(loads(event[1])))
        self._submit(missions)
        while self._tickets:
            with contextlib.suppress(Empty):
                yield from self._items(*self._news.get(timeout=_LOOK_EVERY_S))
            self._submit(missions)
            if time.monotonic() - self._looked > _LOOK_EVERY_S:
                yield from self._look()

    def cancel(self) -> None:
        """Cancel the unfinished missions."""
        with contextlib.suppress(OSError):
            self._client.cancel([ticket.future for ticket in self._tickets.values()], force=True)

    def _submit(self, missions: Iterator[Any]) -> None:
        """Submit missions to free workers, in large batches if there are many workers."""
        capacity = _TASKS_PER_THREAD * self._threads
        free = capacity - len(self._tickets)
        if 2 * free < capacity and self._tickets:
            return
        batch = {f"{self._topic}-{uuid.uuid4().hex}": mission for mission in itertools.islice(missions, free)}
        if not batch:
            return
        futures = self._client.map(
            _fly, list(batch.values()), list(batch), order=self._order, key=list(batch), pure=False
        )
        for (key, mission), future in zip(batch.items(), futures, strict=True):
            self._tickets[key] = _Ticket(mission, future)

    def _items(self, key: str, items: Sequence[Any]) -> Iterator[tuple[Any, Sequence[Any]]]:
        """The items of an event with their mission; raises an error that its flights have raised."""
        if key not in self._tickets:
            return
        mission = self._tickets[key].mission
        last = items[-1]
        if is_last(last):
            del self._tickets[key]
        if not isinstance(last, Raised):
            yield mission, items
            return
        if items[:-1]:
            yield mission, items[:-1]
        raise last.error

    def _look(self) -> Iterator[tuple[Any, Sequence[Any]]]:
        """Count the worker threads, and give up missions that were lost.

        A task may end before its last items arrive.  Callbacks of futures would tell ends sooner, for a tenth of the
        processor time of this process.

        Raises:
            MachineError: The scheduler does not respond, or has lost or cancelled a task.
            MavfiError: A task failed on its Dask worker.
        """
        self._looked = time.monotonic()
        try:
            self._threads = max(1, sum(self._client.nthreads().values()))
        except OSError as error:
            raise MachineError(f"{_GONE} ({error})") from None
        for key, ticket in list(self._tickets.items()):
            lost = self._loss(ticket)
            if lost:
                del self._tickets[key]
                yield ticket.mission, [lost]

    def _loss(self, ticket: _Ticket) -> Lost | None:
        """How a mission was lost; None if it was not."""
        from distributed import KilledWorker

        status = ticket.future.status
        if status == "pending":
            return None
        if status == "finished":
            ticket.ended = ticket.ended or self._looked
            if self._looked - ticket.ended > _PATIENCE_S:
                return Lost("its last items were lost on the way", died=False)
            return None
        error = None
        if status == "error":
            error = ticket.future.exception()
        if error is None:
            raise MachineError(f"{_GONE}, or has cancelled a mission")
        if not isinstance(error, KilledWorker):
            raise MavfiError(f"a Dask worker failed: {error!r}")
        return Lost("its Dask workers died", died=True, signal="SIGKILL")


_THREAD = threading.local()
"""The flight process of this thread of a Dask worker."""


def _fly(mission: Any, key: str, order: bytes) -> None:  # noqa: ANN401
    """Fly a mission on a Dask worker, and send its items."""
    from distributed import get_worker

    # A worker with other code would give other results.
    function, expected_fingerprint, plugins, topic = loads(order)
    dask = get_worker()
    mismatch = difference(expected_fingerprint, fingerprint())
    if mismatch:
        refused = BadInputError(f"Dask worker {dask.address}: has {mismatch}")
        dask.log_event(topic, dumps((key, [Raised(refused)])))
        return
    # Fly in a process that a fault may crash, and send items now and then.
    allow_names(plugins)
    worker = _flyer(function, topic)
    worker.give(mission)
    items: list[Any] = []
    sent = time.monotonic()
    while not items or not is_last(items[-1]):
        if worker.pipe.poll(_LOOK_EVERY_S):
            items += worker.take()
        else:
            items += worker.overdue(TIME_LIMIT)
        task = dask.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            items = [Lost("it was cancelled", died=False)]
        elif items and not is_last(items[-1]) and time.monotonic() - sent > _SEND_EVERY_S:
            dask.log_event(topic, dumps((key, items)))
            sent = time.monotonic()
            items = []
    # After a crash, the next mission gets a new process.
    if isinstance(items[-1], Lost):
        worker.end()
        _THREAD.worker = None
    dask.log_event(topic, dumps((key, items)))


def _flyer(function: Callable[[Any], Iterator[Any]], topic: str) -> Worker[Any]:
    """The flight process of this thread; each call of `map` starts new ones."""
    if getattr(_THREAD, "topic", "") != topic and getattr(_THREAD, "worker", None) is not None:
        _THREAD.worker.end()
        _THREAD.worker = None
    _THREAD.topic = topic
    if getattr(_THREAD, "worker", None) is None:
        _THREAD.worker = start_worker(function)
    worker: Worker[Any] = _THREAD.worker
    return worker
