"""The page of a hardening advice: curves, the plan over the kernels' source, what escapes, what it does not buy."""

import shlex
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from mavfi.errors import write_text
from mavfi.extras.hardening.certification import Certification
from mavfi.extras.hardening.certify import bounds_of
from mavfi.extras.hardening.summary import PROTECTED, AdviceSummary, FunctionSummary, LineSummary
from mavfi.extras.hardening.text import caveats, certificate_table, headline, interval, verdict_line
from mavfi.extras.hardening.vulnerability.lines import read_source
from mavfi.report.html.page import render
from mavfi.report.text import percent

HTML = Path(__file__).parent / "html"
"""Folder of templates and style sheets."""
_SPACE = "\u00a0"
"""Between a number and its unit in headings, where a line must not break."""
WIDTH, HEIGHT = 300, 190
"""Of a curve (pixels)."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 20, 10, 32
_TICKS = (1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)
_MAX_TICKS = 5
_MIN_SPAN = 0.05
"""Smallest range of the axis of time: a curve of one step has none."""


class Line(NamedTuple):
    """A source line: its numbers, its text, and whether lines just before it were not executed."""

    summary: LineSummary
    code: str
    gap: bool

    @property
    def escapes(self) -> float:
        """Share of the function's expected silent corruptions that the plan leaves in this line."""
        return self.summary.sdc * (1 - self.summary.protected)


class Point(NamedTuple):
    """A step of a curve: its position, the ends of its interval (y), and its text."""

    x: float
    y: float
    low: float
    high: float
    chosen: bool
    text: str


class Drawing(NamedTuple):
    """A function's curve with its axes.

    Attributes:
        points: Steps with a known coverage.
        path: Points of the line.
        xs: Position and text of each tick of time.
        ys: The same for coverage.
    """

    points: Sequence[Point]
    path: str
    xs: Sequence[tuple[float, str]]
    ys: Sequence[tuple[float, str]]
    left: int = _LEFT
    right: int = WIDTH - _RIGHT
    bottom: int = HEIGHT - _BOTTOM
    width: int = WIDTH
    height: int = HEIGHT


def write_page(path: Path, summary: AdviceSummary, directory: Path, plan: Path | None) -> None:
    """Write the page of an advice; its commands use ledger and plan as given.

    Raises:
        BadInputError: The file cannot be written.
    """
    write_text(path, page(summary, directory, plan))


def write_certificate(
    path: Path, certification: Certification, directory: Path, plan: Path, kernels: Sequence[str] = ()
) -> None:
    """Write the page of a certificate; `kernels` are those of its command, () = all of the ledger.

    Raises:
        BadInputError: The file cannot be written.
    """
    content = render(
        "certificate.html.j2",
        HTML,
        plan=plan.name,
        digest=certification.plan[:12],
        table=certificate_table(certification),
        verdict=verdict_line(certification).replace(" %", f"{_SPACE}%"),
        missions=", ".join(certification.missions),
        command=f"{_command(directory, kernels, plan)} --certify --faults {certification.faults}",
    )
    write_text(path, content)


def page(summary: AdviceSummary, directory: Path, plan: Path | None) -> str:
    """Render the page as text."""
    path = plan or Path("plan.yaml")
    addresses = " --addresses" if summary.addresses else ""
    again = _command(directory, summary.selected, path, f" --budget {summary.budget:g}", addresses)
    commands = {
        "Make the plan again": again,
        "Test it with fresh missions and faults": f"{_command(directory, summary.selected, path)} --certify",
        "Fly with it": f"mavfi fly --protection {shlex.quote(str(path))}",
    }
    return render(
        "harden.html.j2",
        HTML,
        summary=summary,
        caveats=caveats(summary),
        headline=headline(summary).replace(" %", f"{_SPACE}%"),
        curve=curve,
        source=source,
        escapes=escapes,
        commands=commands,
        interval=interval,
        percent=percent,
    )


def _command(directory: Path, kernels: Sequence[str], plan: Path, first: str = "", last: str = "") -> str:
    """The command that makes a plan, with the options that come before and after its kernels."""
    only = f" --kernels {','.join(kernels)}" if kernels else ""
    return f"mavfi harden {shlex.quote(str(directory))}{first}{only}{last} --plan {shlex.quote(str(plan))}"


def source(function: FunctionSummary) -> dict[str, list[Line]]:
    """The executed source lines of a function by file, with what the plan protects."""
    files = {}
    for file, summaries in groupby(function.lines, key=lambda line: line.file):
        text = dict(enumerate(read_source(file) or (), start=1))
        lines: list[Line] = []
        for summary in summaries:
            gap = bool(lines) and summary.line > lines[-1].summary.line + 1
            lines.append(Line(summary, text.get(summary.line, ""), gap))
        files[file or "instructions without a source line"] = lines
    return files


def escapes(function: FunctionSummary) -> dict[str, float]:
    """Shares of the silent corruptions that escape, by reason."""
    return {reason: share for reason, share in function.escapes.items() if reason != PROTECTED and share > 0}


def best(times: Sequence[float], rates: Sequence[float]) -> list[int]:
    """Indices of the steps that remove more than all that take less time, by time: what a time buys."""
    front: list[int] = []
    for index in sorted(range(len(times)), key=lambda index: (times[index], -rates[index])):
        if not front or rates[index] > rates[front[-1]]:
            front.append(index)
    return front


def curve(function: FunctionSummary) -> Drawing:
    """A function's curve of predicted coverage over time."""
    last = max(1 + _MIN_SPAN, *(step.time for step in function.steps))

    def x(time: float) -> float:
        return _LEFT + round((WIDTH - _LEFT - _RIGHT) * (time - 1) / (last - 1), 1)

    def y(share: float) -> float:
        return round(HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * share, 1)

    points: list[Point] = []
    rates: list[float] = []
    times: list[float] = []
    for step in function.steps:
        if step.coverage.rate is not None:
            rate, low, high = bounds_of(step.coverage)
            rates.append(rate)
            times.append(step.time)
            text = f"×{step.time:.2f} time: {interval(step.coverage)} of SDCs"
            points.append(Point(x(step.time), y(rate), y(low), y(high), step.chosen, text))
    inside = [tick for tick in _TICKS if tick <= last + 1e-9]
    ticks = inside[:: -(-len(inside) // _MAX_TICKS)]
    return Drawing(
        points,
        " ".join(f"{points[index].x},{points[index].y}" for index in best(times, rates)),
        [(x(tick), f"×{tick:g}") for tick in ticks],
        [(y(share), percent(share, 0)) for share in (0.0, 0.5, 1.0)],
    )
