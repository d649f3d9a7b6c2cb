"""Everything that is written of a campaign: report.md, figures, the block of the README, all numbers as JSON."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from mavfi.campaign.analysis import analyse
from mavfi.campaign.worker import plain
from mavfi.errors import BadInputError
from mavfi.reports import figures, markdown
from mavfi.reports.comparable import only_comparable
from mavfi.reports.telling import draw_telling_run

PICTURE = "flight.png"


@dataclass(frozen=True, slots=True)
class Report:
    """What came out: the analysis, and the files that were written."""

    analysis: dict[str, Any]
    files: tuple[Path, ...]


def write_report(
    directory: Path, *, draw_run: bool = True, shown: Callable[[dict[str, Any]], None] | None = None
) -> Report:
    """Analyse a campaign and write its report into its folder.

    Args:
        directory: Where the ledger is.
        draw_run: Whether a telling run is flown again for a picture.
        shown: Called with the analysis when everything is written.

    Returns:
        Analysis and files: report.md, readme_block.md, summary.json and PNG figures.

    Raises:
        BadInputError: There is no campaign, or the folder cannot be written.
    """
    analysis = only_comparable(analyse(directory))
    today = date.today().isoformat()
    drawn = figures.draw(analysis, directory)
    captions = {}
    if draw_run:
        caption = draw_telling_run(directory, directory / PICTURE)
        if caption is not None:
            captions[PICTURE] = caption
            drawn.append(PICTURE)
    texts = {
        "report.md": markdown.report(analysis, drawn, today, captions),
        "readme_block.md": markdown.readme_block(analysis, today),
        "summary.json": json.dumps(plain({"date": today, **analysis}), indent=1, allow_nan=False) + "\n",
    }
    for name, content in texts.items():
        _write(directory / name, content)
    if shown is not None:
        shown(analysis)
    return Report(analysis, tuple(directory / name for name in (*texts, *drawn)))


def _write(path: Path, content: str) -> None:
    try:
        path.write_text(content, encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None
