"""Cost of instruction-level injection: an injected call, a fork, a warm start; and zero overhead of golden flights.

    python benchmarks/instruction.py

An injected call is compared with the same call of the plain kernel, on arguments recorded in flights.  Forks and starts
are also given in CPU time, as their wall time includes queueing on a busy machine.
"""

import copy
import os
import pickle
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.ir.forked import run_in_child
from mavfi.ir.injection.runtime import NEVER
from mavfi.ir.injection.variant import signature_of, variant_for
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE

REPEATS = 15
FLIGHTS = 7
Row = tuple[str, str]
WARM_START = """
import pickle, sys, time
start = time.perf_counter()
from mavfi.ir.injection.variant import variant_of
from mavfi.pipeline.functions import PLAIN
imported = time.perf_counter() - start
for name, signature in pickle.loads(sys.stdin.buffer.read()):
    variant_of(getattr(PLAIN, name), signature)
print(imported, time.perf_counter() - start, time.process_time())
"""


class Recorder:
    """Wraps a function, and stores a copy of the arguments of its longest call."""

    def __init__(self, function: Any) -> None:
        self._function = function
        self._longest = 0.0
        self.args: tuple[Any, ...] | None = None

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        kept = copy.deepcopy(args)
        start = time.perf_counter()
        result = self._function(*args)
        wall = time.perf_counter() - start
        if wall > self._longest:
            self._longest, self.args = wall, kept
        return result


def recorded() -> dict[str, tuple[Any, ...]]:
    """Arguments of the longest call of each injectable function, from three flights."""
    found: dict[str, tuple[Any, ...]] = {}
    for planner, autopilot, kind in (
        ("rrt_connect", "hardened", "dense"),
        ("rrt", "published", "octree"),
        ("rrt_star", "hardened", "dense"),
    ):
        recorders = {name: Recorder(getattr(PLAIN, name)) for name in PLAIN.__dataclass_fields__}
        scenario = resolve(MissionSpec(environment="sparse", seed=7, planner=planner, autopilot=autopilot, map=kind))
        fly(scenario)  # compiles, or loads the cache
        fly(scenario, functions=replace(PLAIN, **recorders))
        found.update(
            {
                name: recorder.args
                for name, recorder in recorders.items()
                if recorder.args is not None and name not in found
            }
        )
    return found


def best(action: Callable[..., Any], args: tuple[Any, ...] = (), repeats: int = REPEATS) -> float:
    """Minimum wall time of several calls, each on its own copy of the arguments (s)."""
    walls = []
    for _ in range(repeats):
        own = copy.deepcopy(args)
        start = time.perf_counter()
        action(*own)
        walls.append(time.perf_counter() - start)
    return min(walls)


def cpu_of(action: Callable[[], Any], repeats: int) -> float:
    """Mean CPU time of a call, including its child processes (s)."""
    before = _cpu()
    for _ in range(repeats):
        action()
    return (_cpu() - before) / repeats


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(part.ru_utime + part.ru_stime for part in used)


def warm_start(args: dict[str, tuple[Any, ...]]) -> Row:
    """Start-up time of a new process until every function is instrumented."""
    wanted = pickle.dumps([(name, signature_of(values)) for name, values in args.items()])
    walls = []
    for _ in range(3):
        start = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", WARM_START], input=wanted, capture_output=True, check=True)
        walls.append((time.perf_counter() - start, *map(float, done.stdout.split())))
    wall, imported, ready, cpu = min(walls)
    return (
        f"fresh process, {len(args)} functions instrumented, warm cache",
        f"{wall:.2f} s in all (imports {imported:.2f}, then {ready - imported:.2f}); {cpu:.2f} s of CPU time",
    )


def call_rows(args: dict[str, tuple[Any, ...]], fork: float) -> list[Row]:
    """For each kernel the longest call, plain and instrumented, and the additional cost of an injected run."""
    rows = []
    for kernel, names in INJECTABLE.items():
        for name in names:
            plain, variant = getattr(PLAIN, name), variant_for(getattr(PLAIN, name), args[name])
            walls = (
                best(plain, args[name]),
                best(lambda *own, v=variant: v.inject(NEVER, 0, 0, NEVER, *own), args[name]),
            )
            more = max(0.0, walls[1] - walls[0])
            rows.append(
                (
                    f"{kernel}: longest call of {name}, plain / instrumented",
                    f"{1e3 * walls[0]:.3f} / {1e3 * walls[1]:.3f} ms (x {walls[1] / walls[0]:.2f}); "
                    f"with a fork a flight costs {1e3 * (more + fork):.1f} ms more",
                )
            )
    return rows


def fork_row() -> tuple[float, Row]:
    """CPU time of forking a child that only reports (s), in a process that has flown."""
    flight = fly(resolve(MissionSpec(environment="sparse", seed=7)))
    wall = best(lambda: run_in_child(lambda: b""), repeats=50)
    fork = cpu_of(lambda: run_in_child(lambda: b""), 50)
    with open("/proc/self/statm", encoding="ascii") as memory:
        resident = int(memory.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    del flight
    label = f"fork, empty report, wait, after a flight ({resident:.0f} MiB resident)"
    return fork, (label, f"{1e3 * fork:.1f} ms of CPU time, {1e3 * wall:.1f} ms at best on the wall")


def instruction_rows() -> list[Row]:
    """All rows of the table."""
    fork, row = fork_row()
    args = recorded()
    return [row, *call_rows(args, fork), warm_start(args)]


if __name__ == "__main__":
    for label, value in instruction_rows():
        print(f"{label:62} {value}")
