"""The page of a hardening advice: curves, the plan over the kernels' source, what escapes, what it does not buy."""

import shlex
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from markupsafe import Markup

from mavfi.campaign.hardening.certification import Certification
from mavfi.campaign.hardening.ways import FEWEST
from mavfi.reports.hardening.drawing import curve, ways
from mavfi.reports.hardening.plain import (
    NAMES,
    caveats,
    certificate_tables,
    certified,
    headline,
    interval,
    rerun_line,
    verdict_line,
    ways_line,
)
from mavfi.reports.html.page import render, write
from mavfi.reports.text import percent
from mavfi.reports.vulnerability.listing import highlighted, read_source


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
    machine = f" --machine {certification.machine[0].kernel}" if certification.machine else ""
    content = render(
        "certificate.html.j2", plan=plan.name, digest=certification.plan[:12], tables=certificate_tables(certification),
        verdict=verdict_line(certification).replace(" %", "\u00a0%"), missions=", ".join(certification.missions),
        command=f"{command} --faults {certification.faults}{machine}",
    )  # fmt: skip
    write(path, content)


def page(summary: Mapping[str, Any], directory: Path, plan: Path | None) -> str:
    """Render the page as text."""
    return render(
        "harden.html.j2", summary=summary, caveats=caveats(summary), rerun=rerun_line(summary),
        headline=headline(summary).replace(" %", "\u00a0%"),
        curves=[curve(row) for row in summary["functions"]], names=NAMES,
        ways=[drawn for row in summary["functions"] if (drawn := ways(row)) is not None], fewest=FEWEST,
        ways_line=ways_line(summary),
        kernels=[_kernel(row) for row in summary["kernels"]],
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
        "certified": certified(row), "injections": row["injections"], "files": files, "escapes": escapes,
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
