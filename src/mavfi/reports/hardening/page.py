"""The page of a hardening advice: curves, the plan over the kernels' source, what escapes, what it does not buy."""

import shlex
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from markupsafe import Markup

from mavfi.campaign.hardening.study import Certification
from mavfi.reports.hardening.plain import caveats, certificate_table, headline, interval, rerun_line, verdict_line
from mavfi.reports.html.page import render, write
from mavfi.reports.text import percent
from mavfi.reports.vulnerability.listing import highlighted, read_source

WIDTH, HEIGHT = 300, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 12, 10, 32
_TICKS = (1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)
_MOST_TICKS = 5


def write_page(path: Path, summary: Mapping[str, Any], directory: Path, plan: Path | None) -> None:
    """Write the page of an advice (see `campaign.hardening.summary`); its commands use ledger and plan as given.

    Raises:
        BadInputError: The file cannot be written.
    """
    write(path, page(summary, directory, plan))


def write_certificate(
    path: Path, certification: Certification, directory: Path, plan: Path, kernels: Sequence[str] = ()
) -> None:
    """Write the page of a certificate; `kernels` are those of its command, () = all of the ledger.

    Raises:
        BadInputError: The file cannot be written.
    """
    command = f"mavfi harden {shlex.quote(str(directory))}{_only(kernels)} --plan {shlex.quote(str(plan))} --certify"
    content = render(
        "certificate.html.j2", plan=plan.name, digest=certification.plan[:12], table=certificate_table(certification),
        verdict=verdict_line(certification).replace(" %", "\u00a0%"), missions=", ".join(certification.missions),
        command=f"{command} --faults {certification.faults}",
    )  # fmt: skip
    write(path, content)


def page(summary: Mapping[str, Any], directory: Path, plan: Path | None) -> str:
    """Render the page as text."""
    return render(
        "harden.html.j2", summary=summary, caveats=caveats(summary), rerun=rerun_line(summary),
        headline=headline(summary).replace(" %", "\u00a0%"),
        curves=[curve(row) for row in summary["functions"]], kernels=[_kernel(row) for row in summary["kernels"]],
        sources=[source(row) for row in summary["functions"]], commands=_commands(summary, directory, plan),
    )  # fmt: skip


def _kernel(row: Mapping[str, Any]) -> dict[str, str]:
    return {
        "kernel": row["kernel"], "share": percent(row["share"]), "time": f"×{row['time']:.2f}",
        "added": percent(row["added"], 2), "coverage": interval(row["coverage"]), "n": str(row["coverage"]["n"]),
    }  # fmt: skip


def _commands(summary: Mapping[str, Any], directory: Path, plan: Path | None) -> list[tuple[str, str]]:
    ledger, file = shlex.quote(str(directory)), shlex.quote(str(plan or "plan.yaml"))
    only, addresses = _only(summary["selected"]), " --addresses" if summary["addresses"] else ""
    again = f"mavfi harden {ledger} --budget {summary['budget']:g}{only}{addresses} --plan {file}"
    return [
        ("Make the plan again", again),
        ("Test it with fresh missions and faults", f"mavfi harden {ledger}{only} --plan {file} --certify"),
        ("Fly with it", f"mavfi fly --protection {file}"),
    ]  # fmt: skip


def _only(kernels: Sequence[str]) -> str:
    return f" --kernels {','.join(kernels)}" if kernels else ""


def curve(row: Mapping[str, Any]) -> dict[str, Any]:
    """A function's curve of predicted coverage over time, in pixels of its drawing."""
    last: float = max(1.05, *(step["time"] for step in row["steps"]))

    def x(time: float) -> float:
        return _LEFT + round((WIDTH - _LEFT - _RIGHT) * (time - 1) / (last - 1), 1)

    def y(share: float) -> float:
        return round(HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * share, 1)

    points = [
        {
            "x": x(step["time"]), "y": y(step["coverage"]["rate"]), "low": y(step["coverage"]["low"]),
            "high": y(step["coverage"]["high"]), "chosen": step["chosen"],
            "text": f"×{step['time']:.2f} time: {interval(step['coverage'])} of SDCs",
        }
        for step in sorted(row["steps"], key=lambda step: (step["time"], step["coverage"]["rate"] or 0.0))
        if step["coverage"]["rate"] is not None
    ]  # fmt: skip
    inside = [tick for tick in _TICKS if tick <= last + 1e-9]
    ticks = inside[:: -(-len(inside) // _MOST_TICKS)]
    return {
        "kernel": row["kernel"], "entry": row["entry"], "width": WIDTH, "height": HEIGHT, "points": points,
        "path": " ".join(f"{point['x']},{point['y']}" for point in points), "left": _LEFT, "right": WIDTH - _RIGHT,
        "bottom": HEIGHT - _BOTTOM, "xs": [(x(tick), f"×{tick:g}") for tick in ticks],
        "ys": [(y(share), f"{100 * share:.0f} %") for share in (0.0, 0.5, 1.0)], "n": row["coverage"]["n"],
    }  # fmt: skip


def source(row: Mapping[str, Any]) -> dict[str, Any]:
    """The executed source lines of a function, by file, with what the plan protects."""
    files = []
    for file, lines in groupby(row["lines"], key=lambda line: line["file"]):
        text = highlighted(read_source(file) or [])
        files.append({"file": file or "instructions without a source line", "lines": _lines(list(lines), text)})
    escapes = [
        {"what": name, "share": percent(share)}
        for name, share in row["escapes"].items()
        if name != "protected" and share > 0
    ]
    return {
        "kernel": row["kernel"], "entry": row["entry"], "sites": row["sites"], "all_sites": row["all_sites"],
        "time": f"×{row['time']:.2f}", "coverage": interval(row["coverage"]), "sdc": interval(row["sdc"]),
        "injections": row["injections"], "files": files, "escapes": escapes,
    }  # fmt: skip


def _lines(lines: list[Mapping[str, Any]], text: list[str]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for line in lines:
        number = line["line"]
        code = text[number - 1] if 1 <= number <= len(text) else ""
        found.append({
            "number": number, "gap": bool(found) and number > found[-1]["number"] + 1,
            "instructions": percent(line["instructions"]), "sdc": percent(line["sdc"]),
            "kept": f"{100 * line['protected']:.0f}", "escapes": percent(line["sdc"] * (1 - line["protected"])),
            "code": Markup(code),  # noqa: S704 - escaped by `highlighted`
        })  # fmt: skip
    return found
