"""Overhead of campaigns with many missions: processor time and memory of the main process, the only ledger writer.

    python -m benchmarks.cluster        (N="1000 10000 100000"; writes the table in docs/how-to/cluster.md)

Flights are stand-ins of zero duration: each mission plans and yields one golden and six injected runs, with records of
realistic length.  The remaining cost is the campaign's overhead, measured against the number of missions.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mavfi.campaign.begin import begin
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Done, Executor, Lost, R, T
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import processor
from mavfi.campaign.ledger import status
from mavfi.campaign.mission import MissionPlan
from mavfi.campaign.plan import CompletedRun, Planned, Row
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import FILE
from mavfi.extras.dask import executor as dask
from mavfi.extras.dask.executor import LOOPBACK, DaskExecutor
from tools.markers import DOCS, fill

RUNS = 7
RUN_S = 1.0
"""Assumed processor time of a run (s), from which the number of cores per campaign process is computed."""
SPEC, RECORD = '{"spec":"%s"}' % ("x" * 600), '{"end":"flown","status":"success","rest":"%s"}' % ("x" * 1200)
WORKERS = 2
ENVIRONMENTS = ("sparse", "dense", "farm", "factory")


def stand_in(mission: MissionPlan) -> Iterator[Planned | CompletedRun]:
    """A mission whose flights have zero duration."""
    campaign, (environment, seed) = mission.campaign.config, mission.world
    first = (campaign.environments.index(environment) * campaign.missions + seed - campaign.first_seed) * RUNS
    rows = [
        Row(
            f"{environment}-{seed}-{place}",
            first + place,
            "golden" if place == 0 else "injected",
            "fi" if place else "golden",
            environment,
            seed,
            SPEC,
        )
        for place in range(RUNS)
    ]
    yield Planned(tuple(rows[:1]), last=False)
    yield CompletedRun(rows[0].run_id, RECORD, success=True)
    yield Planned(tuple(rows[1:]), last=True)
    for row in rows[1:]:
        yield CompletedRun(row.run_id, RECORD, success=True)


class StandIns:
    """An executor whose workers run stand-ins."""

    forks = False

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self.workers = executor.workers

    def map(
        self, function: Callable[[T], Iterator[R]], missions: Iterable[T]
    ) -> Generator[tuple[T, Sequence[R | Done | Lost]], None, None]:
        """Map `stand_in` instead of the function."""
        del function
        from benchmarks import cluster  # workers cannot import from `__main__`

        stand_in: Any = cluster.stand_in
        return self._executor.map(stand_in, missions)


@contextmanager
def cluster() -> Iterator[tuple[str, int]]:
    """Address and process id of a Dask scheduler, with workers, in separate processes."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        file = Path(folder) / "scheduler.json"
        start = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(file)]
        work = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1"]
        processes = []
        for command in (start, *[work] * WORKERS):
            process = subprocess.Popen(
                [*command, "--host", LOOPBACK, "--dashboard-address", f"{LOOPBACK}:0"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": os.getcwd()},
            )
            processes.append(process)
            stack.callback(process.wait)
            stack.callback(process.terminate)
        while not file.is_file():
            time.sleep(0.1)
        from distributed import Client

        with Client(scheduler_file=str(file), set_as_default=False) as client:
            client.wait_for_workers(WORKERS)
            address = str(client.scheduler.address)
        yield address, processes[0].pid


@dataclass(frozen=True, slots=True)
class Cost:
    """Overhead of a campaign."""

    executor: str
    missions: int
    wall_s: float
    parent_s: float  # processor time of the campaign's process
    scheduler_s: float  # processor time of the Dask scheduler
    memory: int  # peak of the campaign's process (bytes)
    ledger: int  # bytes
    open_s: float  # wall time to open the ledger, including all checksums

    @property
    def mission_ms(self) -> float:
        """Processor time per mission (ms) of the busier process."""
        return 1e3 * max(self.parent_s, self.scheduler_s) / self.missions

    def row(self) -> str:
        """Row of the table."""
        scheduler = f"{1e3 * self.scheduler_s / self.missions:.2f}" if self.executor == "dask" else ""
        return (
            f"| {self.executor} | {self.missions:,} | {self.missions / self.wall_s:.0f} "
            f"| {1e3 * self.parent_s / self.missions:.2f} | {scheduler} | {self.memory / 1e6:.0f} "
            f"| {self.ledger / self.missions / 1e3:.1f} | {self.open_s:.1f} |"
        )


HEAD = """\
| executor | missions | missions/s | processor time per mission, campaign's process (ms) | Dask scheduler (ms) \
| peak memory (MB) | ledger per mission (kB) | opening the ledger, checksums included (s) |
|---|---|---|---|---|---|---|---|"""


def measure(name: str, missions: int) -> Cost:
    """Run stand-ins in this process and its workers."""
    each = missions // len(ENVIRONMENTS)
    campaign = Campaign.model_validate(
        {
            "name": "stand-ins",
            "environments": ENVIRONMENTS,
            "missions": each,
            "faults": 2 * each,
            "null_runs": 0,
        }
    )
    dask._TASKS_PER_THREAD = (
        50  # emulates 50 times as many workers: a stand-in is shorter than the scheduler's round trip
    )
    with ExitStack() as stack:
        address, pid = stack.enter_context(cluster()) if name == "dask" else ("", 0)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        executor: Executor = DaskExecutor(address) if address else LocalExecutor(WORKERS)
        scheduler, wall, own = processor_time(pid), time.perf_counter(), time.process_time()
        run_campaign(begin(campaign, folder), folder, executor=StandIns(executor))
        wall, own, scheduler = time.perf_counter() - wall, time.process_time() - own, processor_time(pid) - scheduler
        memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        opening = time.perf_counter()
        assert status(folder).complete
        opening = time.perf_counter() - opening
        return Cost(
            name, len(ENVIRONMENTS) * each, wall, own, scheduler, memory, (folder / FILE).stat().st_size, opening
        )


def processor_time(pid: int) -> float:
    """Processor time of a process so far (s); 0 for pid 0."""
    if pid == 0:
        return 0.0
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def on_paper(costs: list[Cost]) -> str:
    """Extrapolation to 10^6 missions on 1,000 cores, from the largest campaign of each executor."""
    largest = {cost.executor: cost for cost in costs}
    lines = [
        f"- {name}: {cost.mission_ms:.1f} ms of the busiest process for each mission, which {RUNS * RUN_S:.0f} s of "
        f"other processors fly: one campaign serves {1e3 * RUNS * RUN_S / cost.mission_ms:,.0f} cores; 10^6 missions "
        f"take it {1e3 * cost.mission_ms / 3600:.1f} h, 1,000 cores {1e3 * RUNS * RUN_S / 3600:.1f} h; the ledger has "
        f"{1e6 * cost.ledger / cost.missions / 1e9:.0f} GB, and opening it takes "
        f"{1e6 * cost.open_s / cost.missions / 60:.0f} min."
        for name, cost in largest.items()
    ]
    text = (
        f"On paper, 10^6 missions of {RUNS} runs on 1,000 cores, with {RUN_S:.0f} s of processor time for a run, and "
        "the cost per mission of the largest campaign above:"
    )
    return "\n".join([text, "", *lines])


def main() -> None:
    """Measure each campaign in a separate process, print the table and write it to the page."""
    if sys.argv[1:]:
        sys.stdout.write(json.dumps(asdict(measure(sys.argv[1], int(sys.argv[2])))))
        return
    costs = []
    sys.stdout.write(f"{HEAD}\n")
    for name in ("local", "dask"):
        for count in os.environ.get("N", "1000 10000 100000").split():
            command = [sys.executable, "-m", "benchmarks.cluster", name, count]
            costs.append(Cost(**json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)))
            sys.stdout.write(f"{costs[-1].row()}\n")
            sys.stdout.flush()
    here = f"{processor()}, {os.cpu_count()} cores"
    text = (
        f"Measured by `make bench NAME=cluster` on {here}: flights are stand-ins of no length, {RUNS} runs for each "
        "mission."
    )
    table = "\n".join([HEAD, *(cost.row() for cost in costs)])
    fill(DOCS / "how-to" / "cluster.md", {"cluster": "\n\n".join([text, table, on_paper(costs)])})


if __name__ == "__main__":
    main()
