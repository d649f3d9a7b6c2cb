"""What is written of a campaign on a ROS node: outcome tables for terminal and file, all numbers as JSON."""

import json
from collections.abc import Iterable
from datetime import date
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from mavfi.campaign.nodes.analysis import OUTCOMES, analyse_nodes
from mavfi.campaign.store import Store
from mavfi.campaign.worker import plain
from mavfi.errors import BadInputError
from mavfi.reports import text
from mavfi.reports.markdown import markdown_table
from mavfi.reports.table import Table
from mavfi.reports.tables import Analysis
from mavfi.reports.terminal import rendered

NAMES = {"general": "general + flags", "fp": "XMM, YMM", "all": "all"}
INTERVALS = "per cent, [95 % interval, Wilson], count; a crash or a hang is a detected error (DUE)"
FREE_RUNNING = (
    "The instant of a strike is the machine's, not the seed's: a trial cannot be repeated bit for bit, and the digest "
    "is that of this ledger."
)


def write_node_report(directory: Path) -> tuple[dict[str, Any], tuple[Path, ...]]:
    """Analyse a campaign on a node and write its report into its folder.

    Args:
        directory: Where the ledger is.

    Returns:
        Analysis, and the files that were written: report.md and summary.json.

    Raises:
        BadInputError: There is no campaign, or the folder cannot be written.
    """
    with Store.open(directory) as store:
        analysis = analyse_nodes(store)
    today = date.today().isoformat()
    summary = json.dumps(plain({"date": today, **analysis}), indent=1, allow_nan=False) + "\n"
    paths = (directory / "report.md", directory / "summary.json")
    try:
        paths[0].write_text(_markdown(analysis, today), encoding="utf-8")
        paths[1].write_text(summary, encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"{directory}: cannot be written ({error.strerror})") from None
    return analysis, paths


def show_nodes(analysis: Analysis, console: Console) -> None:
    """Print the tables of an analysis; those of single trials are in the file only."""
    first, *rest = header(analysis)
    console.print(f"[bold]{first}[/bold]")
    for line in rest:
        console.print(Text(line, style="dim"))
    for table in node_tables(analysis):
        if not table.detail:
            console.print(rendered(table, console.width))
            for note in table.notes:
                console.print(Text(note, style="dim"))
    console.print(null_line(analysis))


def header(analysis: Analysis) -> list[str]:
    """What was tried, in lines."""
    c = analysis["campaign"]
    where = f"from the next call of {c['symbol']!r} on" if c["symbol"] else "from a random instant on"
    held = analysis["stopped_us"]
    stood = f" · stood still for {held[len(held) // 2] / 1000:.1f} ms (median)" if held else ""
    return [
        f"campaign {c['name']} · node {c['node']}",
        f"{c['command'][0]} · one bit per trial, {where}, after up to {c['walk']} instructions{stood}",
        f"{c['done']} of {c['total']} trials, {c['golden']} of them golden · digest {c['digest'][:16]}",
    ]


def node_tables(analysis: Analysis) -> list[Table]:
    """All tables that have rows, most important first."""
    return [table for table in (_outcomes(analysis), _places(analysis), _corruptions(analysis)) if table.rows]


def null_line(analysis: Analysis) -> str:
    """Whether strikes without a flip left the output as it was."""
    check = analysis["null_check"]
    if not check["n"]:
        return "Null trials: none."
    if check["passed"]:
        return f"Null trials: all {check['n']} strikes without a flip left every output as it was."
    return f"Null trials: {len(check['differing'])} of {check['n']} DIFFER: {', '.join(check['differing'])}"


def _outcomes(analysis: Analysis) -> Table:
    rows = [
        (
            NAMES.get(entry["registers"], entry["registers"]), str(entry["n"]),
            *(text.rate(entry[outcome]) for outcome in OUTCOMES), str(entry["unknown"]),
        )
        for entry in analysis["outcomes"]
    ]  # fmt: skip
    endings = ", ".join(f"{name} {count}" for name, count in sorted(analysis["endings"].items()))
    notes = (INTERVALS, *([f"crashes: {endings}"] if endings else []))
    columns = ("registers", "strikes", "masked", "SDC", "crash", "hang", "not judged")
    return Table("What one bit in a register does", columns, rows, notes)


def _places(analysis: Analysis) -> Table:
    rows = [
        (entry["place"], str(entry["n"]), *(str(entry.get(outcome, 0)) for outcome in OUTCOMES))
        for entry in analysis["by_place"]
    ]
    return Table("By function", ("function", "strikes", "masked", "SDC", "crash", "hang"), rows, (), True)


def _corruptions(analysis: Analysis) -> Table:
    rows = [
        (
            f"{entry['register']} bit {entry['bit']}", entry["instruction"], entry["field"], entry["before"],
            entry["after"], f"{entry['differing']} of {entry['asked']}",
        )
        for entry in analysis["corruptions"]
    ]  # fmt: skip
    columns = ("struck", "instruction", "number in the output", "golden", "was", "outputs that differ")
    return Table("Silent corruptions", columns, rows, (), True)


def _markdown(analysis: Analysis, today: str) -> str:
    first, *rest = header(analysis)
    parts: Iterable[str] = (
        f"# {first[0].upper()}{first[1:]}", "\n".join(f"- {line}" for line in [*rest, f"report of {today}"]),
        *(markdown_table(table) for table in node_tables(analysis)),
        "## Checks", null_line(analysis), "## Remarks", f"- {FREE_RUNNING}",
    )  # fmt: skip
    return "\n\n".join(parts) + "\n"
