"""Everything that is written of a campaign: report.md, figures, the block of the results page, all numbers as JSON."""

import json
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

from mavfi.campaign.analysis import VIEWS, views_for
from mavfi.campaign.analysis.findings import findings
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import Table
from mavfi.campaign.store import Store
from mavfi.campaign.telling import Telling, fly_telling_run
from mavfi.errors import writing
from mavfi.flight_record import plain
from mavfi.reports import figures, markdown
from mavfi.reports.picture import draw_flight
from mavfi.reports.text import differing_null_runs, signed_percent

PICTURE = "flight.png"


@dataclass(frozen=True, slots=True)
class Report:
    """Tables of all views that apply, the leading one first; findings in words; files that were written."""

    runs: Runs
    tables: tuple[Table, ...]
    findings: tuple[str, ...]
    files: tuple[Path, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain data: `campaign`, `findings`, `null_runs`, `unknown` runs, and `tables` by name."""
        tables = {table.name: table.to_json() for table in self.tables}
        # views that a report leaves out, because they say the same in more rows
        more = {name: view.table(self.runs) for name, view in VIEWS.items() if name not in tables}
        tables |= {name: table.to_json() for name, table in more.items() if table.rows}
        data: dict[str, Any] = plain({
            "campaign": self.runs.campaign, "findings": self.findings,
            "null_runs": {"n": len(self.runs.null), "differing": differing_null_runs(self.runs)},
            "unknown": self.runs.where(judged=False)["run_id"], "tables": tables,
        })  # fmt: skip
        return data


def report_of(runs: Runs) -> Report:
    """Tables and findings of a campaign; nothing is written."""
    return Report(runs, tuple(views_for(runs)), tuple(findings(runs)))


def write_report(directory: Path, *, draw_run: bool = True) -> Report:
    """Analyse a campaign and write its report into the folder of its ledger.

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
        captions |= figures.draw(found.runs, directory)
        captions |= _draw_telling_run(directory, found.runs) if draw_run else {}
    texts = {
        "report.md": markdown.report(found.runs, found.tables, found.findings, captions, today),
        "summary.json": json.dumps({"date": today, **found.to_json()}, indent=1, allow_nan=False) + "\n",
    }
    if found.tables:
        texts["readme_block.md"] = markdown.readme_block(found.runs, found.tables[0], today)
    for name, content in texts.items():
        with writing(directory / name):
            (directory / name).write_text(content, encoding="utf-8")
    return replace(found, files=tuple(directory / name for name in (*texts, *captions)))


def _draw_telling_run(directory: Path, runs: Runs) -> dict[str, str]:
    """Draw the run that says most, golden, with the fault and with the detector; gives its caption."""
    with Store.open(directory) as store:
        chosen = fly_telling_run(store, runs.frame)
    if chosen is None:
        return {}
    detector = "" if chosen.saved is None else str(chosen.saved["arm"])
    draw_flight(directory / PICTURE, chosen.flight, chosen.golden, chosen.recovered, detector=detector)
    return {PICTURE: _caption(chosen)}


def _caption(telling: Telling) -> str:
    row, injection = telling.injected, telling.flight.log.injections[0]
    change = "" if row["inflation"] is None else f" ({signed_percent(row['inflation'])} flight time)"
    bit = "" if injection.bit is None else f", bit {injection.bit}"
    text = f"`{row['run_id']}`: {injection.site}{bit}, at {injection.time_s:.2f} s; "
    text += f"ends in {row['status'].replace('_', ' ')}{change}."
    if telling.saved is not None:
        text += f" With {telling.saved['arm']} on it reaches the goal."
    return f"{text} See `mavfi explain`."
