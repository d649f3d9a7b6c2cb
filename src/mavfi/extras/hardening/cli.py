"""`mavfi harden`: which instructions of the kernels to duplicate, and the certificate of such a plan."""

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import PAGES, check_file, check_number, check_writable, console, say_written, write_json
from mavfi.errors import BadInputError
from mavfi.files import is_file

if TYPE_CHECKING:
    from mavfi.analysis.table import Table
    from mavfi.extras.hardening.advise import HardeningStudy

HELP_PANEL = "Campaigns"
EXIT_REFUTED = 3
DEFAULT_BUDGET = 0.10
DEFAULT_FAULTS = 400


def harden(  # noqa: PLR0913 - one parameter per option
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a campaign with faults in instructions.")],
    plan: Annotated[
        Path | None,
        typer.Option(metavar="FILE.yaml", help="The plan: written, or with --certify read (a shipped one by name)."),
    ] = None,
    budget: Annotated[
        float | None, typer.Option(metavar="SHARE", help="Share of a flight's kernel time to spend; 0.10 by default.")
    ] = None,
    kernels: Annotated[str, typer.Option(metavar="NAMES", help="These kernels only, separated by commas.")] = "",
    addresses: Annotated[
        bool, typer.Option("--addresses", help="Compare addresses before loads, too: fewer crashes, more time.")
    ] = False,
    html: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html", help="Write the advice, or with --certify the certificate, as one offline page."
        ),
    ] = None,
    certify: Annotated[
        bool, typer.Option("--certify", help="Test a plan with missions and faults that its choice has not seen.")
    ] = False,
    faults: Annotated[int | None, typer.Option(metavar="N", help="Per function; 400 by default.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Advise which instructions to duplicate, or certify a plan.

    The advice keeps to a budget of time. The exit code is 3 if the certificate refutes the plan: its prediction, its
    budget, or a golden flight.

    Example: [bold]mavfi harden out/kernels --budget 0.10 --plan plan.yaml --html harden.html[/bold]

    Example: [bold]mavfi harden out/kernels --plan plan.yaml --certify[/bold]
    """
    from mavfi.extras.hardening.advise import HardeningStudy

    check_number("--budget", budget, 0.0, 10.0)
    check_number("--faults", faults, 1, 100_000)
    names = options.listed(kernels)
    if certify:
        if plan is None:
            raise BadInputError("--plan: not given: allowed with --certify: the file of a plan")
        for option, value in (("--budget", budget), ("--addresses", addresses or None)):
            if value is not None:
                raise BadInputError(f"{option}: {value}: allowed: without --certify")
        check_file("--html", html, PAGES)
        _certify(HardeningStudy.open(directory, names), plan, faults or DEFAULT_FAULTS, html, as_json=as_json)
        return
    if faults is not None:
        raise BadInputError(f"--faults: {faults}: allowed: with --certify")
    check_file("--plan", plan, (".yaml", ".yml"))
    check_file("--html", html, PAGES)
    if budget is None:
        budget = DEFAULT_BUDGET
    _advise(HardeningStudy.open(directory, names), budget, plan, html, addresses=addresses, as_json=as_json)


def _tell(text: str) -> None:
    console(error=True).print(text, style="dim")


def _advise(
    study: "HardeningStudy", budget: float, path: Path | None, html: Path | None, *, addresses: bool, as_json: bool
) -> None:
    from mavfi.extras.hardening import certify, plan, report, summary
    from mavfi.extras.hardening.advise import advise, plan_of

    harm = summary.harm_of(study.runs)
    advices = advise(study, budget, _tell, addresses=addresses, workers=os.cpu_count() or 1)
    advised_plan = plan_of(study, advices)
    if path is not None:
        with suppress(BadInputError):  # there is none yet
            advised_plan = certify.with_certified(advised_plan, plan.load_plan(path))
        plan.save_plan(advised_plan, path)
    advice = summary.summary(study, advices, harm, advised_plan)
    if html is not None:
        report.write_page(html, advice, study.directory, path)
    if as_json:
        write_json(asdict(advice))
        return
    _show(report.headline(advice), report.caveats(advice), report.advice_table(advice))
    say_written(path, html)


def _certify(study: "HardeningStudy", path: Path, faults: int, html: Path | None, *, as_json: bool) -> None:
    from mavfi.extras.hardening import certify, plan, report

    planned = plan.load_plan(str(path))
    check_writable(path.with_suffix(".certificate.json"))
    certification = certify.certify_plan(study, planned, faults, _tell)
    written = [certify.save_certification(certification, path)]
    if is_file(path):  # not a shipped plan, given by name
        plan.save_plan(certify.certified_plan(planned, certification), path)
        written.append(path)
    if html is not None:
        report.write_certificate(html, certification, study.directory, path, study.selected)
        written.append(html)
    if as_json:
        write_json(certify.certification_json(certification))
    else:
        _show(report.verdict_line(certification), (), report.certificate_table(certification))
        say_written(*written)
    if certification.refuted:
        raise typer.Exit(EXIT_REFUTED)


def _show(headline: str, lines: Iterable[str], table: "Table") -> None:
    from mavfi.report.text import show_table

    out = console()
    out.print(Text(headline, style="bold"))
    for line in lines:
        out.print(Text(line))
    out.print()
    show_table(table, out)
