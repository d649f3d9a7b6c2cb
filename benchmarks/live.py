"""Cost of `mavfi fly --live`: flights with and without a viewer, in alternation; writes docs/how-to/logs.md.

    N=10 python -m benchmarks.live

N: flights of each kind (10).  The viewer is another process that subscribes to every topic.
"""

import multiprocessing
import os
import sys
import time
from typing import Any

import numpy as np

from mavfi.extras.logs.live import LiveView
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.flight.observers import ObserverListener
from mavfi.mission import MissionSpec
from tests.extras.logs.viewer import Viewer
from tools.markers import DOCS, fill

PAGE = DOCS / "how-to" / "logs.md"
SCENARIO = resolve(MissionSpec(environment="sparse", seed=7))
KINDS = ("without --live", "--live, no viewer", "--live, a viewer of all topics")
_TOPICS = 12
_NEW = multiprocessing.get_context("spawn")
"""A viewer that is a fork would share this process's memory: the flight would copy each page that it writes to."""


def watch(address: str, ready: Any) -> None:
    """Subscribe to everything until the server stops."""
    viewer = Viewer(address)
    viewer.subscribe(_TOPICS)
    ready.set()
    viewer.collect()


def flown(kind: str) -> float:
    """Time of one flight (s)."""
    if kind == KINDS[0]:
        return _seconds(())
    view = LiveView(0)
    viewer = None
    if kind == KINDS[2]:
        ready = _NEW.Event()
        viewer = _NEW.Process(target=watch, args=(view.address, ready))
        viewer.start()
        if not ready.wait(30):
            raise SystemExit("the viewer did not subscribe within 30 s")
        time.sleep(0.2)  # the subscription arrives
    seconds = _seconds((ObserverListener(view),))
    view.close()
    if viewer is not None:
        viewer.join(30)
    return seconds


def _seconds(observers: tuple[ObserverListener, ...]) -> float:
    begin = time.thread_time()  # of the flight: the wall time would depend on other load
    fly(SCENARIO, observers=observers)
    return time.thread_time() - begin


def table(times: dict[str, list[float]]) -> str:
    """Medians, and the median of the pairwise ratios to flights without the option."""
    base = np.array(times[KINDS[0]])
    lines = ["| flight | CPU time of the flight, median (s) | median ratio |", "|---|---|---|"]
    for kind in KINDS:
        own = np.array(times[kind])
        lines.append(f"| {kind} | {np.median(own):.3f} | {np.median(own / base):.3f} |")
    count = len(base)
    setting = f"{count} flights of each kind in alternation, environment `sparse`, seed 7, as fast as possible"
    return "\n".join([*lines, "", f"{setting}; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}."])


def main() -> None:
    """Fly, and write the table."""
    fly(SCENARIO)
    times: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for _ in range(int(os.environ.get("N", "10"))):
        for kind in KINDS:
            times[kind].append(flown(kind))
    sys.stdout.write(table(times) + "\n")
    fill(PAGE, {"live": table(times)})


if __name__ == "__main__":
    main()
