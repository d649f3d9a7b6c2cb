"""A generated page of a campaign: its header, findings, and some of its tables."""

from collections.abc import Iterable
from pathlib import Path

from mavfi.api import load, table
from mavfi.campaign.analysis.findings import findings
from mavfi.reports.campaign_report import markdown_table
from mavfi.reports.text import header
from tools.markers import banner


def page(ledger: Path, command: str, title: str, text: str, views: Iterable[str]) -> str:
    """The page.

    Args:
        ledger: Folder of the campaign's ledger.
        command: Command that regenerates the page.
        title: Heading.
        text: Paragraphs below the heading.
        views: Names of its tables.

    Raises:
        BadInputError: The folder holds no ledger, or its runs have nothing to show in a view.
    """
    return f"{banner(command)}{section(ledger, f'# {title}', text, views)}"


def section(ledger: Path, heading: str, text: str, views: Iterable[str]) -> str:
    """The page without its banner, below a heading; other arguments and errors as of `page`."""
    runs = load(ledger)
    lines = [
        heading, "", text, "",
        *(f"- {line}" for line in (*header(runs.campaign), *findings(runs))), "",
        *(f"{markdown_table(table(runs, name))}\n" for name in views),
    ]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"
