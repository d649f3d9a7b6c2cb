"""The page of a hardening advice: curves, the plan over the kernels' source, what escapes, what it does not buy."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from mavfi.errors import write_text
from mavfi.extras.hardening.certification import Certification
from mavfi.extras.hardening.drawing import curve
from mavfi.extras.hardening.summary import PROTECTED, AdviceSummary, FunctionSummary, LineSummary
from mavfi.extras.hardening.text import caveats, certificate_table, headline, interval, verdict_line
from mavfi.extras.hardening.vulnerability.source import read_source
from mavfi.report.html.page import render
from mavfi.report.text import percent

HTML = Path(__file__).parent / "html"
"""Folder of templates and style sheets."""
_SPACE = "\u00a0"
"""Between a number and its unit in headings, where a line must not break."""


@dataclass(frozen=True, slots=True)
class Line:
    """A source line: its numbers, its text, and whether lines just before it were not executed."""

    summary: LineSummary
    code: str
    gap: bool

    @property
    def escapes(self) -> float:
        """Share of the function's expected silent corruptions that the plan leaves in this line."""
        return self.summary.sdc * (1 - self.summary.protected)


@dataclass(frozen=True, slots=True)
class Source:
    """The executed lines of a function, by file, and shares of the silent corruptions that escape, by reason."""

    function: FunctionSummary
    files: dict[str, list[Line]]
    escapes: dict[str, float]


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
        command=f"{_certify(directory, kernels, plan)} --faults {certification.faults}",
    )
    write_text(path, content)


def page(summary: AdviceSummary, directory: Path, plan: Path | None) -> str:
    """Render the page as text."""
    return render(
        "harden.html.j2",
        HTML,
        summary=summary,
        caveats=caveats(summary),
        headline=headline(summary).replace(" %", f"{_SPACE}%"),
        curves=[curve(function) for function in summary.functions],
        sources=[source(function) for function in summary.functions],
        commands=_commands(summary, directory, plan),
        interval=interval,
        percent=percent,
    )


def source(function: FunctionSummary) -> Source:
    """The executed source lines of a function, with what the plan protects."""
    files = {}
    for file, lines in groupby(function.lines, key=lambda line: line.file):
        files[file or "instructions without a source line"] = _lines(list(lines), read_source(file) or [])
    escapes = {reason: share for reason, share in function.escapes.items() if reason != PROTECTED and share > 0}
    return Source(function, files, escapes)


def _lines(summaries: Sequence[LineSummary], text: Sequence[str]) -> list[Line]:
    lines: list[Line] = []
    for summary in summaries:
        code = text[summary.line - 1] if 1 <= summary.line <= len(text) else ""
        gap = bool(lines) and summary.line > lines[-1].summary.line + 1
        lines.append(Line(summary, code, gap))
    return lines


def _commands(summary: AdviceSummary, directory: Path, plan: Path | None) -> list[tuple[str, str]]:
    """What a reader may do next, each with its command."""
    path = plan or Path("plan.yaml")
    file = shlex.quote(str(path))
    addresses = " --addresses" if summary.addresses else ""
    again = (
        f"mavfi harden {shlex.quote(str(directory))} --budget {summary.budget:g}{_only(summary.selected)}{addresses}"
    )
    return [
        ("Make the plan again", f"{again} --plan {file}"),
        ("Test it with fresh missions and faults", _certify(directory, summary.selected, path)),
        ("Fly with it", f"mavfi fly --protection {file}"),
    ]


def _certify(directory: Path, kernels: Sequence[str], plan: Path) -> str:
    """The command that certifies a plan."""
    return f"mavfi harden {shlex.quote(str(directory))}{_only(kernels)} --plan {shlex.quote(str(plan))} --certify"


def _only(kernels: Sequence[str]) -> str:
    return f" --kernels {','.join(kernels)}" if kernels else ""
