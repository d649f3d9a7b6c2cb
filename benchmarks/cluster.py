"""Campaigns of many missions: time, processor time and memory of the campaign's process, which alone writes.

    python -m benchmarks.cluster local|dask [MISSIONS ...]

Flights are stand-ins of no length: each mission plans and gives one golden run and six injected ones, with records as
long as real ones.  What is left is what a campaign costs besides its flights, and how it grows.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors import dask
from mavfi.campaign.executors.dask import LOOPBACK, DaskExecutor
from mavfi.campaign.executors.executor import Executor
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import MissionPlan
from mavfi.campaign.plan import Flown, Planned, Row
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import FILE

RUNS = 7
SPEC, RECORD = '{"spec":"%s"}' % ("x" * 600), '{"end":"flown","status":"success","rest":"%s"}' % ("x" * 1200)
WORKERS = 2


def stand_in(mission: MissionPlan) -> Iterator[Planned | Flown]:
    """A mission whose flights take no time."""
    campaign, (environment, seed) = mission.campaign, mission.world
    first = (campaign.environments.index(environment) * campaign.missions + seed - campaign.first_seed) * RUNS
    rows = [
        Row(f"{environment}-{seed}-{place}", first + place, "golden" if place == 0 else "injected",
            "fi" if place else "golden", environment, seed, SPEC)
        for place in range(RUNS)
    ]  # fmt: skip
    yield Planned(tuple(rows[:1]), last=False)
    yield Flown(rows[0].run_id, RECORD, success=True)
    yield Planned(tuple(rows[1:]), last=True)
    for row in rows[1:]:
        yield Flown(row.run_id, RECORD, success=True)


class StandIns:
    """An executor whose workers fly stand-ins."""

    forks = False

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def map(self, function: Any, missions: Iterable[MissionPlan]) -> Any:  # noqa: ANN401 - as `Executor.map`
        """Fly stand-ins instead."""
        del function
        from benchmarks import cluster  # workers cannot import what is in `__main__`

        return self._executor.map(cluster.stand_in, missions)


@contextmanager
def cluster() -> Iterator[str]:
    """Address of a scheduler with workers, in processes of their own: the campaign's has nothing but its own work."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        told = Path(folder) / "scheduler.json"
        start = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(told)]
        work = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(told), "--nthreads", "1"]
        for command in (start, *[work] * WORKERS):
            process = subprocess.Popen(
                [*command, "--host", LOOPBACK, "--dashboard-address", f"{LOOPBACK}:0"], stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": os.getcwd()},
            )  # fmt: skip
            stack.callback(process.wait)
            stack.callback(process.terminate)
        while not told.is_file():
            time.sleep(0.1)
        from distributed import Client

        with Client(scheduler_file=str(told), set_as_default=False) as client:
            client.wait_for_workers(WORKERS)
            address = str(client.scheduler.address)
        yield address


def measure(name: str, missions: int, scheduler: str) -> str:
    """One row."""
    executor: Executor = DaskExecutor(scheduler) if scheduler else LocalExecutor(WORKERS)
    environments = ["sparse", "dense", "farm", "factory"][: 4 if missions > 4 else 1]
    each = missions // len(environments)
    campaign = Campaign.model_validate({
        "name": "stand-ins", "environments": environments, "missions": each, "faults": 2 * each, "null_runs": 0,
    })  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        wall, own = time.perf_counter(), time.process_time()
        run_campaign(campaign, Path(folder), executor=StandIns(executor))
        wall, own = time.perf_counter() - wall, time.process_time() - own
        size = (Path(folder) / FILE).stat().st_size
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return (
        f"| {name} | {missions:,} | {wall:.0f} | {missions / wall:.0f} | {1e3 * own / missions:.2f} | {memory:.0f} | "
        f"{size / missions / 1e3:.1f} |"
    )


def main() -> None:
    """Print the table."""
    counts = [int(text) for text in sys.argv[2:]] or [1000, 10_000, 100_000]
    sys.stdout.write(
        "| executor | missions | wall time (s) | missions/s | parent's processor time per mission (ms) | parent's "
        "memory (MB) | ledger per mission (kB) |\n|---|---|---|---|---|---|---|\n"
    )
    dask._AHEAD = 50  # as if there were 50 times as many workers: stand-ins are shorter than a way to the scheduler
    with ExitStack() as stack:
        address = stack.enter_context(cluster()) if sys.argv[1] == "dask" else ""
        for count in counts:
            sys.stdout.write(measure(sys.argv[1], count, address) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
