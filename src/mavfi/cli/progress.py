"""Progress display: a bar with rate and time left in a terminal, periodic lines elsewhere."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from mavfi.cli.console import console

if TYPE_CHECKING:
    from mavfi.campaign.session import Progress as CampaignProgress
    from mavfi.campaign.steps import Steps

_LINE_EVERY = 15.0
"""Interval between lines if the output is not a terminal (s)."""
_FEW, _FEW_TASKS = 10, 3
"""Numbers of flights, and of other units, of a study before the time left is estimated."""


class Bar:
    """Progress bar on stderr, counted in units; use as a context manager."""

    def __init__(self, label: str, unit: str = "flights") -> None:
        self._label, self._unit = label, unit
        self._console = console(error=True)
        self._bar = Progress(
            TextColumn("[bold]{task.description}"), BarColumn(bar_width=40), TextColumn("{task.fields[counts]}"),
            TextColumn("{task.fields[pace]}"), console=self._console,
        )  # fmt: skip
        self._task = self._bar.add_task(label, total=None, counts="", pace="")
        self._live = Live(self._bar, console=self._console, refresh_per_second=5)
        self._begun = self._printed = time.perf_counter()
        self._line = ""
        self._held: int | None = None
        self._waits = True
        self._campaigns: dict[Path, CampaignProgress] = {}

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def show(self, done: int, total: int) -> None:
        """Show progress; the rate excludes the first unit, which includes compiling and loading."""
        if self._held is None or (self._waits and done > self._held):
            self._waits = self._held is None
            self._held, self._begun = done, time.perf_counter()
        seconds = time.perf_counter() - self._begun
        rate = (done - self._held) / seconds if seconds > 0 else 0.0
        pace = f"{speed(rate, self._unit)} · {time_left((total - done) / rate)}" if rate > 0 else ""
        self._tell(done, total, pace)

    def show_campaign(self, progress: CampaignProgress) -> None:
        """Show the progress of a campaign, with successes by setting."""
        if progress.compiling and not progress.flown:
            text = "compiling kernels and flying the first mission ..."
            self._bar.update(self._task, pace=text)
            if not self._console.is_terminal:
                self._console.print(f"{self._label}: {text}")
            return
        if progress.settings:
            self._live.update(Group(self._bar, success_counts(progress.settings)))
        pace = f"{speed(progress.rate, self._unit)} · {time_left(progress.remaining_s)}" if progress.rate > 0 else ""
        self._tell(progress.done, progress.total, pace)

    def show_campaigns(self, directory: Path, progress: CampaignProgress) -> None:
        """Show the progress of campaigns that fly together, in all; of a single one also its successes."""
        self._campaigns[directory] = progress
        every = self._campaigns.values()
        if len(every) == 1 or (progress.compiling and not any(one.flown for one in every)):
            return self.show_campaign(progress)
        return self.show(sum(one.done for one in every), sum(one.total for one in every))

    def _tell(self, done: int, total: int, pace: str) -> None:
        self._draw(done, total, f"{done}/{total} {self._unit}", pace)

    def _draw(self, done: float, total: float, counts: str, pace: str) -> None:
        pace = pace if done < total else ""
        if self._console.is_terminal:
            self._bar.update(self._task, completed=done, total=total, counts=counts, pace=pace)
            return
        now, line = time.perf_counter(), f"{self._label} {counts}  {pace}".rstrip()
        if (now - self._printed >= _LINE_EVERY or done == total) and line != self._line:
            self._printed, self._line = now, line
            self._console.print(line)


@dataclass(slots=True)
class Part:
    """Progress of one part of a study: compilation, training, a campaign, tables ..."""

    done: int  # units
    total: int  # units
    seconds: float  # expected wall time of a unit: weight of the part in the bar and in the time left
    flights: bool = True  # whether units are flights; else tasks of some seconds


class StudyBar(Bar):
    """Progress over all parts of a study, which run in sequence; bar and time left cover all of them.

    Args:
        label: Name of the study.
        parts: By name, in the order in which they run.
        steps: To which the wall times of the parts are added.
    """

    def __init__(self, label: str, parts: dict[str, Part], steps: Steps) -> None:
        super().__init__(label, "flights")
        self.steps = steps
        self._parts, self._part, self._name = parts, next(iter(parts.values())), label
        self._origin, self._units = (0.0, 0.0), -1  # where measurement began: time and work (s); units since then
        self._by_flights, self._rate = False, math.inf  # of measurement: its units; wall time / expected wall time

    @contextmanager
    def timed(self, step: str, *names: str) -> Iterator[None]:
        """Run parts together, and add their wall time to a step of the study, which is also shown."""
        self._part, order = self._parts[names[0]], list(self._parts)
        places = dict.fromkeys(f"{order.index(name) + 1}" for name in (names[0], names[-1]))
        self._label = f"{self._name}, {step} ({' to '.join(places)} of {len(order)})"
        self._bar.update(self._task, description=self._label)
        with self.steps.timed(step):
            yield
        for name in names:
            self._part = self._parts[name]
            ended = self._part.done or self._part.total  # fewer than expected, or none was reported
            self._tell(ended, ended, "")

    def show_part(self, name: str, progress: CampaignProgress) -> None:
        """Show the progress of a campaign among several that fly together."""
        self._part = self._parts[name]
        self._tell(progress.done, progress.total, "")

    def _tell(self, done: int, total: int, pace: str) -> None:
        new = done - self._part.done
        self._part.done, self._part.total = done, total
        work, whole = self._sum("done"), self._sum("total")
        if new > 0:
            self._measure(new, work)
        done, total = (sum(getattr(part, key) for part in self._parts.values() if part.flights)
                       for key in ("done", "total"))  # fmt: skip
        share = math.floor(100 * work / whole) if work < whole else 100
        self._draw(work, whole, f"{share} %, {done}/{total} {self._unit}", time_left((whole - work) * self._rate))

    def _measure(self, new: int, work: float) -> None:
        """Compare with what was expected, from the first flight on, or from the first unit until one has flown.

        The first one includes loading; and a cache may hold some of the code that was expected to be compiled.
        """
        now, first_flight = time.perf_counter(), self._part.flights and not self._by_flights
        if self._units < 0 or first_flight:
            self._origin, self._units, self._by_flights = (now, work), 0, self._part.flights
            return
        self._units += new
        begun, before = self._origin
        if self._units >= (_FEW if self._by_flights else _FEW_TASKS) and work > before:
            self._rate = (now - begun) / (work - before)

    def _sum(self, key: str) -> float:
        """Expected wall time of all units that attribute `key` ("done" or "total") counts (s)."""
        return sum(float(getattr(part, key)) * part.seconds for part in self._parts.values())


@contextmanager
def compiling(*, instrumented: bool = False, flight: bool = False) -> Iterator[bool]:
    """Report on stderr that kernels (also instrumented ones) are being compiled, if their cache is empty.

    With `flight`, in a terminal also if no flight and no campaign has ended on this machine: commands that do not fly
    compile some functions, too.

    Yields:
        Whether plain kernels are still to be compiled.
    """
    from mavfi.numerics.dependencies import packages_digest
    from mavfi.numerics.jit import code_folder

    folder, out = code_folder(), console(error=True)
    empty = not any(folder.rglob("*.nbc"))
    cold = not any(folder.glob(f"*-{packages_digest()}.warm")) if flight else empty
    if not (cold if out.is_terminal else empty) and not (instrumented and not any(folder.rglob("*.bin"))):
        yield cold
    else:
        about = "two minutes" if instrumented else "40 s"
        with _telling(f"compiling kernels for this machine, once (about {about})", folder, out):
            yield cold
    if flight:
        with suppress(OSError):  # a cache that cannot be written stays as it is
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"flight-{packages_digest()}.warm").touch()


@contextmanager
def _telling(text: str, folder: Path, out: Console) -> Iterator[None]:
    """Show a text, in a terminal with the growing number of functions that were compiled into a folder."""

    def count() -> int:
        return sum(1 for path in folder.rglob("*") if path.suffix in (".nbc", ".bin"))

    if not out.is_terminal:
        out.print(f"{text} ...")
        yield
        return
    stop = threading.Event()
    before = count()
    with out.status(f"{text} ...") as shown:

        def follow() -> None:
            while not stop.wait(0.5):
                shown.update(f"{text}: {count() - before} functions")

        watcher = threading.Thread(target=follow, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            stop.set()
            watcher.join()


def success_counts(settings: Mapping[str, tuple[int, int, int]]) -> Table:
    """Flown, planned (where more are) and succeeded runs by setting; the share of successes with Wilson's interval."""
    from mavfi.campaign.analysis.statistics import score_bounds

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    plans = ["planned so far"] if any(planned > done for planned, done, _ in settings.values()) else []
    for heading in ("setting", "flown", *plans, "succeeded", ""):
        table.add_column(heading, justify="left" if heading in ("setting", "") else "right")
    for setting, (planned, done, success) in settings.items():
        share = ""
        if done:
            low, high = score_bounds(success / done, done)
            share = f"{100 * success / done:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"
        table.add_row(setting, str(done), *(str(planned) for _ in plans), str(success), Text(share, style="dim"))
    return table


def speed(rate: float, unit: str) -> str:
    """Format a rate in units per second, with two decimals below 1."""
    return f"{rate:.{1 if rate >= 1 else 2}f} {unit}/s"


def time_left(seconds: float) -> str:
    """Format the time left (s); infinite = not known yet."""
    return f"{duration(seconds)} left" if math.isfinite(seconds) else "estimating the time left"


def duration(seconds: float) -> str:
    """Format a wall time (s) in hours, minutes and seconds; "?" if not finite."""
    if not math.isfinite(seconds):
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
