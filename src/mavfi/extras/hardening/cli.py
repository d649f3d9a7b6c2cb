"""`mavfi harden`: which instructions of the kernels to duplicate, and the certificate of such a plan."""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
from mavfi.cli.console import PAGES, check_file, check_number, check_writable, console, say_written, write_json
from mavfi.errors import BadInputError
from mavfi.files import is_file

if TYPE_CHECKING:
    from mavfi.extras.hardening.study import Study

EXIT_REFUTED = 3


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
    """Advise which instructions of the kernels to duplicate within a budget of time, or certify such a plan.

    The exit code is 3 if the certificate refutes the plan: its prediction, its budget, or a golden flight.

    Example: [bold]mavfi harden out/kernels --budget 0.10 --plan plan.yaml --html harden.html[/bold]

    Example: [bold]mavfi harden out/kernels --plan plan.yaml --certify[/bold]
    """
    from mavfi.extras.hardening.study import Study

    check_number("--budget", budget, 0.0, 10.0)
    check_number("--faults", faults, 1, 100_000)
    names = options.listed(kernels)
    if certify:
        _check_certify(plan, {"--budget": budget, "--addresses": addresses or None})
        check_file("--html", html, PAGES)
        _certify(Study.open(directory, names), Path(str(plan)), faults or 400, html, as_json=as_json)
        return
    if faults is not None:
        raise BadInputError(f"--faults: {faults}: allowed: with --certify")
    check_file("--plan", plan, (".yaml", ".yml"))
    check_file("--html", html, PAGES)
    study, share = Study.open(directory, names), 0.10 if budget is None else budget
    _advise(study, share, plan, html, addresses=addresses, as_json=as_json)


def _check_certify(plan: Path | None, others: Mapping[str, Any]) -> None:
    if plan is None:
        raise BadInputError("--plan: not given: allowed with --certify: the file of a plan")
    for option, value in others.items():
        if value is not None:
            raise BadInputError(f"{option}: {value}: allowed: without --certify")


def _tell(text: str) -> None:
    console(error=True).print(text, style="dim")


def _advise(
    study: "Study", budget: float, plan: Path | None, html: Path | None, *, addresses: bool, as_json: bool
) -> None:
    from rich.text import Text

    from mavfi.extras.hardening.certification import with_certified
    from mavfi.extras.hardening.page import write_page
    from mavfi.extras.hardening.plan import load_plan, save_plan
    from mavfi.extras.hardening.study import advise, plan_of
    from mavfi.extras.hardening.summary import harm_of, summary
    from mavfi.extras.hardening.text import advice_table, caveats, headline
    from mavfi.report.text import show_table

    harm = harm_of(study.runs)
    advices = advise(study, budget, _tell, addresses=addresses, workers=os.cpu_count() or 1)
    made = plan_of(study, advices)
    if plan is not None:
        with suppress(BadInputError):  # there is none yet
            made = with_certified(made, load_plan(plan))
        save_plan(made, plan)
    found = summary(study, advices, harm, made)
    if html is not None:
        write_page(html, found, study.directory, plan)
    if as_json:
        write_json(asdict(found))
        return
    out = console()
    out.print(Text(headline(found), style="bold"))
    for line in caveats(found):
        out.print(Text(line))
    out.print()
    show_table(advice_table(found), out)
    say_written(plan, html)


def _certify(study: "Study", path: Path, faults: int, html: Path | None, *, as_json: bool) -> None:
    from rich.text import Text

    from mavfi.extras.hardening.certification import (
        certification_json,
        certified_plan,
        certify_plan,
        save_certification,
    )
    from mavfi.extras.hardening.page import write_certificate
    from mavfi.extras.hardening.plan import load_plan, save_plan
    from mavfi.extras.hardening.text import certificate_table, verdict_line
    from mavfi.report.text import show_table

    plan = load_plan(str(path))
    check_writable(path.with_suffix(".certificate.json"))
    found = certify_plan(study, plan, faults, _tell)
    written = [save_certification(found, path)]
    if is_file(path):  # not a shipped plan, given by name
        save_plan(certified_plan(plan, found), path)
        written.append(path)
    if html is not None:
        write_certificate(html, found, study.directory, path, study.selected)
        written.append(html)
    if as_json:
        write_json(certification_json(found))
    else:
        out = console()
        out.print(Text(verdict_line(found), style="bold"))
        out.print()
        show_table(certificate_table(found), out)
        say_written(*written)
    if found.refuted:
        raise typer.Exit(EXIT_REFUTED)
