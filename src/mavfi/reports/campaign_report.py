"""Everything that is written of a campaign: report.md, figures, the block of the results page, all numbers as JSON."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from mavfi.campaign.analysis import VIEWS, views_for
from mavfi.campaign.analysis.findings import findings
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import Table
from mavfi.campaign.store import Store
from mavfi.campaign.telling import fly_telling_run
from mavfi.errors import BadInputError
from mavfi.flight_record import plain
from mavfi.reports import figures, markdown, telling

PICTURE = "flight.png"
FIGURES = {
    "success.png": "Success with 95 % intervals; black: the paper's figure.",
    "flight_time.png": "Share of missions that arrived, by flight time over the golden run's; failures never arrive.",
    "sites.png": "Share of missions that fail or take more than 5 % longer, by what was injected.",
}
"""What a report may draw, and what it says below it."""


@dataclass(frozen=True, slots=True)
class Report:
    """What came out.

    Attributes:
        runs: Of the campaign.
        tables: Of all views that apply, the leading one first.
        findings: The headline in words.
        files: That were written.
    """

    runs: Runs
    tables: tuple[Table, ...]
    findings: tuple[str, ...]
    files: tuple[Path, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain data: `campaign`, `findings`, `null_runs`, `unknown` runs, and `tables` by name."""
        null = self.runs.null
        tables = {table.name: table.to_json() for table in self.tables}
        # views that a report leaves out, because they say the same in more rows
        more = {name: view.table(self.runs) for name, view in VIEWS.items() if name not in tables}
        tables |= {name: table.to_json() for name, table in more.items() if table.rows}
        data: dict[str, Any] = plain({
            "campaign": self.runs.campaign, "findings": self.findings,
            "null_runs": {"n": len(null), "differing": [r["run_id"] for r in null if r["effect"] != "masked"]},
            "unknown": self.runs.where(judged=False)["run_id"], "tables": tables,
        })  # fmt: skip
        return data


def report_of(runs: Runs) -> Report:
    """Tables and findings of a campaign; nothing is written."""
    return Report(runs, tuple(views_for(runs)), tuple(findings(runs)))


def write_report(directory: Path, *, draw_run: bool = True) -> Report:
    """Analyse a campaign and write its report into its folder.

    Args:
        directory: Where the ledger is.
        draw_run: Whether a telling run is flown again for a picture.

    Returns:
        With the files: report.md, readme_block.md, summary.json and PNG figures.

    Raises:
        BadInputError: There is no campaign, or the folder cannot be written.
    """
    found = report_of(Runs.read(directory))
    today = date.today().isoformat()
    captions: dict[str, str] = {}
    if found.runs.has_missions:
        captions |= {name: FIGURES[name] for name in figures.draw(found.runs, directory)}
        captions |= _telling_run(directory, found.runs) if draw_run else {}
    texts = {
        "report.md": markdown.report(found.runs, found.tables, found.findings, captions, today),
        "summary.json": json.dumps({"date": today, **found.to_json()}, indent=1, allow_nan=False) + "\n",
    }
    if found.tables:
        texts["readme_block.md"] = markdown.readme_block(found.runs, found.tables[0], today)
    for name, content in texts.items():
        _write(directory / name, content)
    return Report(found.runs, found.tables, found.findings, tuple(directory / name for name in (*texts, *captions)))


def _telling_run(directory: Path, runs: Runs) -> Mapping[str, str]:
    """Caption of the run that says most, drawn."""
    with Store.open(directory) as store:
        chosen = fly_telling_run(store, runs.frame)
    return {} if chosen is None else {PICTURE: telling.draw(chosen, directory / PICTURE)}


def _write(path: Path, content: str) -> None:
    try:
        path.write_text(content, encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None
