"""Speed of `mavfi airsim run` against real time, for the programs in examples/airsim; writes docs/how-to/airsim.md.

    N=5 python -m benchmarks.airsim

N: runs of each program (5), after one that is not counted.
"""

import os
import resource
import sys
import time

import numpy as np

from mavfi.extras.airsim.boundary import Boundary
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.airsim.host import ProgramResult, run_program
from mavfi.mission import MissionSpec
from mavfi.report.text import markdown_grid
from tools.markers import DOCS, ROOT, fill

PROGRAMS = ("box", "orbit", "survey")
HEADINGS = (
    "program",
    "calls",
    "simulated (s)",
    "wall (s)",
    "CPU (s)",
    "simulated / wall",
    "simulated / CPU",
)
Run = tuple[ProgramResult, float, float]


def cpu_s() -> float:
    """CPU time so far (s), of this process and of those that it has waited for."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in used)


def run(program: ProgramConfig) -> Run:
    """Run a program once; wall time and CPU time (s), of server and client."""
    wall, cpu = time.perf_counter(), cpu_s()
    ended = run_program(program, MissionSpec(environment="sparse", seed=7), Boundary())
    return ended, time.perf_counter() - wall, cpu_s() - cpu


def row(name: str, runs: list[Run]) -> list[str]:
    """Medians of the runs of a program."""
    wall, cpu = (float(np.median([one[place] for one in runs])) for place in (1, 2))
    ended = runs[0][0]
    times = f"{ended.seconds:.1f}", f"{wall:.2f}", f"{cpu:.2f}"
    return [f"`{name}`", str(sum(ended.calls.values())), *times, *(f"{ended.seconds / one:.0f}" for one in (wall, cpu))]


def main() -> None:
    """Run all programs and write the table."""
    count, rows = int(os.environ.get("N", "5")), []
    for name in PROGRAMS:
        program = ProgramConfig(script=str(ROOT / "examples" / "airsim" / f"{name}.py"))
        run(program)
        rows.append(row(name, [run(program) for _ in range(count)]))
    text = (
        f"Measured by `make bench NAME=airsim`: medians of {count} runs of server and client, without the start of "
        f"mavfi; load of the machine {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, so CPU time is given as well "
        "as wall time."
    )
    table = markdown_grid(HEADINGS, rows, left=1)
    fill(DOCS / "how-to" / "airsim.md", {"speed": f"{text}\n\n{table}"})
    sys.stdout.write(table + "\n")


if __name__ == "__main__":
    main()
