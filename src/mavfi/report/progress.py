"""Progress display: a bar with rate and time left in a terminal, one line in a notebook, periodic lines elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from mavfi.report.console import console

if TYPE_CHECKING:
    from mavfi.analysis.statistics import Rate
    from mavfi.campaign.ledger import Progress as CampaignProgress

_LINE_EVERY = 15.0
"""Interval between lines if the output is not a terminal (s)."""
_UPDATE_EVERY = 0.5
"""Interval between updates of the line in a notebook (s), which keeps up with a few messages a second."""

_NOTICE_EVERY = 3.0
"""Interval between looks for compiled code (s)."""
_FUNCTIONS = 134
"""Functions that the first flight with default settings compiles; others need a few more or less."""


class Bar:
    """Progress bar on stderr, counted in units; use as a context manager.

    Time left: the rate of the units done since the first one times those that are left.

    Args:
        label: What is done.
        unit: What is counted.
        prints_lines: Whether lines are printed where there is neither a terminal nor a notebook.
    """

    def __init__(self, label: str, unit: str = "flights", *, prints_lines: bool = True) -> None:
        self._unit = unit
        self._prints_lines = prints_lines
        self._console = console(error=True)
        self._notebook = _notebook_output()
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=40),
            TextColumn("{task.fields[counts]}"),
            TextColumn("{task.fields[pace]}"),
            console=self._console,
        )
        self._task = self._bar.add_task(label, total=None, counts="", pace="")
        self._live = Live(self._bar, console=self._console, refresh_per_second=5)
        self._last_line = ""
        self._last_line_at = time.perf_counter()
        self.begin(label, unit)

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def begin(self, label: str, unit: str) -> None:
        """Show other work from now on, with a rate of its own."""
        self._label = label
        self._unit = unit
        # The rate counts from here: the instant, and the units done before it (None = not shown yet).
        self._rate_from = time.perf_counter()
        self._done_before: int | None = None
        self._first_unit_is_open = True
        self._campaigns: dict[Path, CampaignProgress] = {}
        self._bar.update(self._task, description=label, completed=0, total=None, counts="", pace="")
        self._live.update(self._bar)

    def show(self, done: int, total: int) -> None:
        """Show progress; the rate excludes the first unit, which includes compiling and loading."""
        if self._done_before is None or (self._first_unit_is_open and done > self._done_before):
            self._first_unit_is_open = self._done_before is None
            self._done_before = done
            self._rate_from = time.perf_counter()
        seconds = time.perf_counter() - self._rate_from
        rate = 0.0
        if seconds > 0:
            rate = (done - self._done_before) / seconds
        pace = ""
        if rate > 0 and done < total:
            pace = f"{speed(rate, self._unit)} · {duration((total - done) / rate)} left"
        self._draw(done, total, pace)

    def show_campaign(self, progress: CampaignProgress) -> None:
        """Show the progress of a campaign, with successes by setting."""
        if progress.compiling and not progress.flown:
            text = "compiling kernels and flying the first mission ..."
            self._bar.update(self._task, pace=text)
            if not self._console.is_terminal:
                self._print(f"{self._label}: {text}")  # once, also of campaigns that fly together
            return
        if progress.settings:
            self._live.update(Group(self._bar, run_counts(progress.settings, flies=progress.flies)))
        self.show(progress.done, progress.total)

    def show_campaigns(self, directory: Path, progress: CampaignProgress) -> None:
        """Show the progress of campaigns that fly together, in all; of a single one also its successes."""
        self._campaigns[directory] = progress
        campaigns = self._campaigns.values()
        nothing_flown = not any(campaign.flown for campaign in campaigns)
        if len(campaigns) == 1 or (progress.compiling and nothing_flown):
            self.show_campaign(progress)
            return
        if nothing_flown:
            self._done_before = None  # runs of earlier sessions, campaign by campaign, are no progress
        self.show(sum(campaign.done for campaign in campaigns), sum(campaign.total for campaign in campaigns))

    def _draw(self, done: int, total: int, pace: str) -> None:
        """Update the bar in a terminal; elsewhere show a line from time to time, and at the end."""
        counts = f"{done}/{total} {self._unit}"
        if self._console.is_terminal:
            self._bar.update(self._task, completed=done, total=total, counts=counts, pace=pace)
            return
        interval = _LINE_EVERY
        line = f"{self._label} {counts}  {pace}"
        if self._notebook is not None:
            interval = _UPDATE_EVERY
            line = f"{self._label}: {done} of {total} {self._unit}  {pace}"
        now = time.perf_counter()
        if now - self._last_line_at >= interval or done == total:
            self._last_line_at = now
            self._print(line.rstrip())

    def _print(self, line: str) -> None:
        """Print a line, or replace that of a notebook; no line is shown twice."""
        if line == self._last_line:
            return
        if self._notebook is not None:
            show = self._notebook.display
            if self._last_line:
                show = self._notebook.update
            show({"text/plain": line}, raw=True)
        elif self._prints_lines:
            self._console.print(line)
        self._last_line = line


def _notebook_output() -> Any:  # noqa: ANN401 - of IPython
    """A display of a notebook whose content can be replaced; None outside of notebooks."""
    ipython = sys.modules.get("IPython")
    if ipython is None or getattr(ipython.get_ipython(), "kernel", None) is None:
        return None
    return import_module("IPython.display").DisplayHandle()


class _FunctionsBar(Progress):
    """Progress of the compilation of a flight, by the files that all processes add to a folder.

    Args:
        folder: Folder of compiled code.
        out: Where it is drawn.
    """

    def __init__(self, folder: Path, out: Console) -> None:
        columns = TextColumn("[bold]{task.description}"), BarColumn(bar_width=20), TextColumn("{task.fields[counts]}")
        super().__init__(*columns, console=out, transient=True, refresh_per_second=5)
        self._folder = folder
        self._before = self._count()  # of earlier versions, or compiled by other commands
        self._task = self.add_task("compiling kernels for this machine", total=_FUNCTIONS, counts="")

    def get_renderables(self) -> Iterator[RenderableType]:
        """The bar, after a look into the folder."""
        if hasattr(self, "_task"):  # the first drawing precedes the task
            done = self._count() - self._before
            total = max(done, _FUNCTIONS)
            self.update(self._task, completed=done, total=total, counts=f"{done} of {total} functions")
        yield from super().get_renderables()

    def _count(self) -> int:
        return sum(1 for _ in self._folder.glob("*.nbc"))


@contextmanager
def _noticed_compilation(folder: Path, out: Console) -> Iterator[None]:
    """Say so if code is compiled after all, and how long flights have taken that take long.

    A vehicle or planner may need functions that no earlier flight did, and a custom planner may take seconds a path.
    """

    def count() -> int:
        return sum(1 for pattern in ("*.nbc", "*.bin") for _ in folder.rglob(pattern))

    def notice() -> None:
        compiles = False
        next_line_s = _LINE_EVERY
        while not ended.wait(_NOTICE_EVERY):
            if not compiles and count() > before:
                compiles = True
                out.print("compiling kernels that no earlier flight here needed, once ...")
            elapsed_s = time.perf_counter() - began
            if elapsed_s >= next_line_s:
                next_line_s += _LINE_EVERY
                out.print(
                    f"flying for {elapsed_s:.0f} s; with custom parts, the flight without a fault is flown twice ..."
                )

    before = count()
    began = time.perf_counter()
    ended = Event()
    Thread(target=notice, daemon=True).start()
    try:
        yield
    finally:
        ended.set()


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

    folder = code_folder()
    out = console(error=True)
    # files of the cache: .nbc of plain functions, .bin of instrumented ones, .warm once a flight has ended
    is_empty = not any(folder.rglob("*.nbc"))
    is_cold = is_empty
    if flight:
        is_cold = not any(folder.glob(f"*-{packages_digest()}.warm"))
    compiles = is_empty
    if out.is_terminal:
        compiles = is_cold
    if instrumented and not any(folder.rglob("*.bin")):
        compiles = True
    if compiles:
        duration_text = "20 s"
        if instrumented:
            duration_text = "half a minute"
        text = f"compiling kernels for this machine, once (about {duration_text}) ..."
        if not out.is_terminal:
            out.print(text)
        display: AbstractContextManager[object] = out.status(text)  # draws nothing elsewhere than in a terminal
        if is_cold and out.is_terminal:
            display = _FunctionsBar(folder, out)
        with display:
            yield is_cold
    elif is_cold:  # other processes compile, which must not be started while a thread runs
        yield is_cold
    else:
        with _noticed_compilation(folder, out):
            yield is_cold
    if flight:
        with suppress(OSError):  # a cache that cannot be written stays as it is
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"flight-{packages_digest()}.warm").touch()


def run_counts(settings: Mapping[str, tuple[int, int, int]], *, flies: bool = True) -> Table:
    """Flown and planned (where more are) runs by setting; if they are flights, also those that succeeded.

    The share of successes has Wilson's interval.
    """
    from mavfi.analysis.statistics import wilson

    table = _plain_table()
    is_incomplete = any(planned > done for planned, done, _ in settings.values())
    table.add_column("setting")
    heading = "runs"
    if flies:
        heading = "flown"
    table.add_column(heading, justify="right")
    if is_incomplete:
        table.add_column("planned so far", justify="right")
    if flies:
        table.add_column("succeeded", justify="right")
        table.add_column("% [95 % if all runs were independent]", header_style="dim")
    for setting, (planned, done, success) in settings.items():
        cells: list[str | Text] = [setting, str(done)]
        if is_incomplete:
            cells.append(str(planned))
        if flies:
            share = ""
            if done:
                share = f"{100 * success / done:.1f} {wilson(success, done).interval}"
            cells += [str(success), Text(share, style="dim")]
        table.add_row(*cells)
    return table


def effect_counts(effects: Mapping[str, Mapping[str, Rate]]) -> Table:
    """Number and share of each effect by setting, with the interval of the share, and the number of faults."""
    from mavfi.analysis.effects import HEADINGS

    table = _plain_table()
    table.add_column("setting")
    table.add_column("effect")
    table.add_column("runs", justify="right")
    table.add_column("n", justify="right")
    table.add_column("")
    for setting, rates in effects.items():
        name = setting
        for effect, rate in rates.items():
            runs = ""
            if rate.successes is not None:
                runs = str(rate.successes)
            table.add_row(name, HEADINGS.get(effect, effect), runs, str(rate.n), rate.percent)
            name = ""
    return table


def _plain_table() -> Table:
    return Table(box=None, padding=(0, 2, 0, 0), header_style="dim")


def speed(rate: float, unit: str) -> str:
    """Format a rate in units per second, with two decimals below 1."""
    if rate >= 1:
        return f"{rate:.1f} {unit}/s"
    return f"{rate:.2f} {unit}/s"


def duration(seconds: float) -> str:
    """Format a wall time (s) in hours, minutes and seconds; "?" if not finite."""
    if not math.isfinite(seconds):
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    if minutes:
        return f"{minutes} min {rest:02d} s"
    return f"{rest} s"
