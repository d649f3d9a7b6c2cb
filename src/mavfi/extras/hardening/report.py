"""Hardening advice and certificates as sentences, tables and pages."""

import shlex
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from mavfi.analysis.rows import KERNEL_DUE
from mavfi.analysis.statistics import Rate
from mavfi.analysis.table import Table
from mavfi.errors import write_text
from mavfi.extras.hardening.advise import FRESH
from mavfi.extras.hardening.certify import (
    MAX_HALF_WIDTH,
    TOLERANCE,
    Certificate,
    Certification,
    Spending,
    Unprotected,
    Verdict,
    bounds_of,
)
from mavfi.extras.hardening.summary import PROTECTED, AdviceSummary, FunctionSummary, LineSummary
from mavfi.extras.hardening.vulnerability.lines import read_source
from mavfi.report.html.page import render
from mavfi.report.text import ABSENT, percent

_ADVICE = (
    "kernel",
    "function",
    "kernel time",
    "time",
    "adds",
    "SDCs removed, predicted",
    "n SDC",
    "sites",
    "certified",
)
_CERTIFICATE = (
    "kernel",
    "function",
    "SDC before",
    "SDC after",
    "detected",
    "DUE after",
    "instr.",
    "time",
    "SDCs removed",
    "predicted",
    "",
    "pairs",
)


_MAX_SPANS = 2
"""Groups of lines of a function that a sentence names at most."""


def headline(summary: AdviceSummary) -> str:
    """The advice in one sentence."""
    protected = [kernel.kernel for kernel in summary.kernels if kernel.added > 0 or kernel.coverage.rate]
    if not protected:
        return f"Nothing can be protected within {percent(summary.budget)} of a flight's kernel time."
    corruptions = "all silent corruptions (SDC)"
    if not summary.complete:
        corruptions = f"the silent corruptions (SDC) in {', '.join(kernel.kernel for kernel in summary.kernels)}"
    protect = f"Protect {', '.join(protected)}: {percent(summary.spent)} more kernel time per flight removes "
    if summary.coverage.rate is None:
        return f"{protect}a share of {corruptions} that is not known: predicted from too few missions."
    return f"{protect}{interval(summary.coverage)} of {corruptions}, predicted from {summary.injections:,} injections."


def caveats(summary: AdviceSummary) -> list[str]:
    """What the protection does not buy, and what it has not seen."""
    silent = summary.harm.silent
    dead = summary.harm.dead
    unseen = [unseen_lines(function) for function in summary.functions if function.sites and function.unseen_lines]
    lines = [
        f"It does not buy missions: {silent.successes} of {silent.n} flights with an SDC were lost, "
        f"{interval(silent)}; {dead.successes} of {dead.n} with a dead kernel.",
        f"It does not buy crashes: {interval(summary.harm.dead_share)} of the injections ended in a crash, hang or "
        "exception; duplication detects some of them at IR level, which says nothing about machine level.",
    ]
    if unseen:
        lines.append(f"It does not cover what no observed mission executes: {'; '.join(unseen)}.")
    return lines


def unseen_lines(function: FunctionSummary) -> str:
    """Source lines of a function that no mission executed, as "track: pid.py:60-66, 71 and 3 more"; the first ones."""
    spans: list[list[Any]] = []  # file, first and last line
    for file, numbers in function.unseen_lines.items():
        for number in numbers:
            if spans and spans[-1][0] == file and number == spans[-1][2] + 1:
                spans[-1][2] = number
            else:
                spans.append([file, number, number])
    texts = []
    for file, first, last in spans[:_MAX_SPANS]:
        text = f"{Path(file).name}:{first}"
        if last > first:
            text += f"-{last}"
        texts.append(text)
    more = ""
    if len(spans) > _MAX_SPANS:
        more = f" and {len(spans) - _MAX_SPANS} more"
    return f"{function.entry} {', '.join(texts)}{more}"


def advice_table(summary: AdviceSummary) -> Table:
    """What to protect, by function; the last column is left out if nothing has been certified."""
    rows = [_advice_row(function) for function in summary.functions]
    columns: tuple[str, ...] = _ADVICE
    if all(function.certified is None for function in summary.functions):
        columns = _ADVICE[:-1]
        rows = [row[:-1] for row in rows]
    notes = (
        "kernel time: share of a golden flight's; time: measured, protected / plain; adds: of a flight's kernel time; "
        f"predicted by cross-validation over missions, 95 % interval for {FRESH} further missions; sites: instructions "
        "that are duplicated, of those that can be",
    )
    return Table.of_text("What to protect", columns, rows, notes)


def _advice_row(function: FunctionSummary) -> tuple[str, ...]:
    return (
        function.kernel,
        function.entry,
        percent(function.share),
        f"×{function.time:.2f}",
        percent(function.added, 2),
        prediction(function),
        str(function.coverage.n),
        f"{function.sites} of {function.all_sites}",
        ABSENT if function.certified is None else interval(function.certified),
    )


def prediction(function: FunctionSummary) -> str:
    """The predicted coverage, or why there is none."""
    if function.coverage.rate is None:
        return f"predicted from {function.recorded} calls of {function.missions} missions: too few"
    return interval(function.coverage)


def verdict_line(certification: Certification) -> str:
    """The certificate in one sentence."""
    golden = certification.golden
    verdicts = [row.verdict for row in certification.certificates if row.verdict != Verdict.UNKNOWN]
    undecided = verdicts.count(Verdict.UNDECIDED)
    refuted = verdicts.count(Verdict.REFUTED)

    # Each part of the sentence is empty where there is nothing to say.
    corrected = ""
    if refuted:
        corrected = f" ({certification.wrong} with Holm's correction for so many)"
    predicted = ""
    if certification.predicted.rate is not None:
        predicted = f" (predicted with the same weights: {interval(certification.predicted)})"
    corruptions = "all SDCs"
    if certification.scope:
        corruptions = f"the SDCs in {', '.join(certification.scope)}"
    time = ""
    if certification.spending:
        time = _time_sentence(max(certification.spending, key=lambda spending: (spending.refuted, spending.measured)))
    return (
        f"The plan is {_outcome(certification, verdicts)}: {interval(certification.coverage)} of {corruptions} are "
        f"removed, on fresh missions and faults{predicted}; {refuted} of {len(verdicts)} predictions are refuted"
        f"{corrected}, {undecided} undecided; golden digests equal in {golden.same} of {golden.flights} flights; "
        f"{golden.alarms} false alarms in {golden.calls:,} calls{time}."
    )


def _outcome(certification: Certification, verdicts: Sequence[Verdict]) -> str:
    """What the certificate says of the plan; `verdicts` are those of functions with a prediction."""
    if certification.refuted:
        return Verdict.REFUTED
    if not verdicts:
        return "measured; it has no prediction"
    if certification.verdict == Verdict.UNDECIDED:
        return Verdict.UNDECIDED
    return Verdict.CONFIRMED


def _time_sentence(spending: Spending) -> str:
    """What the plan adds to the flights of a planner, and whether that is too much."""
    budget = ""
    if spending.budget is not None:
        budget = f"; the budget is {percent(spending.budget)}"
    outcome = ""
    if spending.refuted:
        outcome = f", more than {percent(TOLERANCE)} beyond it: refuted"
    return (
        f"; it adds {percent(spending.measured)} of a flight's kernel time (with the plan's times: "
        f"{percent(spending.planned)}{budget}){outcome}"
    )


def certificate_table(certification: Certification) -> Table:
    """Certificates by function."""
    rows = [_certificate_row(certificate) for certificate in certification.certificates]
    rows += [_unprotected_row(result) for result in certification.others]
    notes = (
        f"{certification.faults} faults per function in plain code, as many in protected code, uniform over its own "
        "dynamic instructions; SDCs removed: 1 - SDC after x instr. / SDC before, so that added instructions do not "
        "dilute the rate; instr.: dynamic instructions, protected / plain; time: "
        "the same for time, measured here (in the plan)",
        "DUE (crash, hang, exception) at IR level; pairs: of the faults in plain code, injected once more in protected "
        "code: SDC in plain code only : in protected code only, McNemar's test",
        "undecided: the interval of measured - predicted coverage contains 0, but is wider than "
        f"±{100 * MAX_HALF_WIDTH:.0f} points, so that other predictions would pass as well; more faults would help",
        *(
            f"flights with {spending.planner}: adds {percent(spending.measured)} of their kernel time (with the plan's "
            f"times: {percent(spending.planned)})"
            for spending in certification.spending
        ),
    )
    return Table.of_text("Certificate", _CERTIFICATE, rows, notes)


def _certificate_row(certificate: Certificate) -> tuple[str, ...]:
    after = certificate.after
    paired = certificate.paired
    injections = sum(after.values())
    return (
        certificate.kernel,
        certificate.function.rpartition(".")[2],
        interval(certificate.sdc_before),
        interval(certificate.sdc_after),
        percent(after.get("detected", 0) / injections),
        percent(sum(after.get(name, 0) for name in KERNEL_DUE) / injections),
        f"×{certificate.growth:.2f}",
        _time(certificate),
        interval(certificate.coverage),
        interval(certificate.predicted_rate),
        certificate.verdict.value,
        f"{paired.first_only} : {paired.second_only}, p = {paired.p_value:.2g}",
    )


def _time(certificate: Certificate) -> str:
    """Time ratio as measured, with that of the plan."""
    if certificate.time is None:
        return ABSENT
    return f"×{certificate.time:.2f} (×{certificate.planned_time:.2f})"


def _unprotected_row(result: Unprotected) -> tuple[str, ...]:
    row = dict.fromkeys(_CERTIFICATE, ABSENT)
    row["kernel"] = result.kernel
    row["function"] = result.function.rpartition(".")[2]
    row["SDC before"] = interval(result.sdc)
    row[""] = "not duplicated"  # in the column of verdicts
    return tuple(row.values())


def interval(rate: Rate) -> str:
    """A rate with its interval, in per cent: "93.1 % [90.2, 95.4]"."""
    if rate.rate is None or rate.low is None or rate.high is None:
        return ABSENT
    return f"{percent(rate.rate)} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


# ---- the pages ------------------------------------------------------------------------------------------------------

HTML = Path(__file__).parent / "html"
"""Folder of templates and style sheets."""
_SPACE = "\u00a0"
"""Between a number and its unit in headings, where a line must not break."""
WIDTH = 300
HEIGHT = 190
"""Size of a curve (pixels)."""
_LEFT = 46
_RIGHT = 20
_TOP = 10
_BOTTOM = 32
"""Margins around the axes (pixels)."""
_TICKS = (1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)
"""Time ratios at which the axis of time may have a tick."""
_MAX_TICKS = 5
_MIN_SPAN = 0.05
"""Smallest range of the axis of time: a curve of one step has none."""


class SourceLine(NamedTuple):
    """A source line of a listing.

    Attributes:
        summary: Its number and what the plan protects in it.
        code: Its text; "" = not known.
        gap: Whether lines just before it were not executed.
    """

    summary: LineSummary
    code: str
    gap: bool

    @property
    def escapes(self) -> float:
        """Share of the function's expected silent corruptions that the plan leaves in this line."""
        return self.summary.sdc * (1 - self.summary.protected)


class Point(NamedTuple):
    """A step of a curve.

    Attributes:
        x: Position of its time (pixels).
        y: Position of its coverage (pixels).
        low: Position of the lower end of the interval of its coverage (pixels).
        high: Position of the upper end (pixels).
        chosen: Whether the advice takes this step.
        text: Description.
    """

    x: float
    y: float
    low: float
    high: float
    chosen: bool
    text: str


class CurveDrawing(NamedTuple):
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
    addresses = ""
    if summary.addresses:
        addresses = " --addresses"
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
        prediction=prediction,
        commands=commands,
        interval=interval,
        percent=percent,
    )


def _command(directory: Path, kernels: Sequence[str], plan: Path, budget: str = "", addresses: str = "") -> str:
    """The command that makes a plan; `budget` and `addresses` are these options as text."""
    selection = ""
    if kernels:
        selection = f" --kernels {','.join(kernels)}"
    return f"mavfi harden {shlex.quote(str(directory))}{budget}{selection}{addresses} --plan {shlex.quote(str(plan))}"


def source(function: FunctionSummary) -> dict[str, list[SourceLine]]:
    """The executed source lines of a function by file, with what the plan protects."""
    files = {}
    for file, summaries in groupby(function.lines, key=lambda line: line.file):
        text = dict(enumerate(read_source(file) or (), start=1))
        lines: list[SourceLine] = []
        for summary in summaries:
            gap = bool(lines) and summary.line > lines[-1].summary.line + 1
            lines.append(SourceLine(summary, text.get(summary.line, ""), gap))
        files[file or "instructions without a source line"] = lines
    return files


def escapes(function: FunctionSummary) -> dict[str, float]:
    """Shares of the silent corruptions that escape, by reason."""
    return {reason: share for reason, share in function.escapes.items() if reason != PROTECTED and share > 0}


def pareto_front(times: Sequence[float], rates: Sequence[float]) -> list[int]:
    """Indices of the steps that remove more than all that take less time, in order of time."""
    front: list[int] = []
    for index in sorted(range(len(times)), key=lambda index: (times[index], -rates[index])):
        if not front or rates[index] > rates[front[-1]]:
            front.append(index)
    return front


def curve(function: FunctionSummary) -> CurveDrawing:
    """A function's curve of predicted coverage over time."""
    last_time = max(1 + _MIN_SPAN, *(step.time for step in function.steps))

    def x(time: float) -> float:
        return _LEFT + round((WIDTH - _LEFT - _RIGHT) * (time - 1) / (last_time - 1), 1)

    def y(share: float) -> float:
        return round(HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * share, 1)

    # Steps without a known coverage are left out.
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
    inside = [tick for tick in _TICKS if tick <= last_time + 1e-9]
    every = -(-len(inside) // _MAX_TICKS)  # rounded up
    ticks = inside[::every]
    return CurveDrawing(
        points,
        " ".join(f"{points[index].x},{points[index].y}" for index in pareto_front(times, rates)),
        [(x(tick), f"×{tick:g}") for tick in ticks],
        [(y(share), percent(share, 0)) for share in (0.0, 0.5, 1.0)],
    )
