"""What the requirements of docs/generated/hardening.md came to on each processor that measured them.

Steps are chosen by their time, which depends on the processor: so does what is met within ×1.3.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from mavfi.reports.text import markdown_grid
from tools.hardening_requirements import REQUIRED
from tools.markers import GENERATED

PROCESSORS = GENERATED / "hardening-processors.json"
_HEADINGS = ("processor", "date", "function", "requirement", "measured", "met")


def note(processor: str, date: str, requirements: Sequence[Sequence[str]], path: Path = PROCESSORS) -> None:
    """Store the rows of functions with a limit of time, in place of earlier ones of the same processor.

    Args:
        processor: Model name.
        date: Of the measurement.
        requirements: Rows as of `hardening_requirements.requirements`.
        path: The file.
    """
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    rows = [list(row[:4]) for row in requirements if row[0].strip("`") in REQUIRED]
    known[processor] = {"date": date, "rows": rows}
    path.write_text(json.dumps(known, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8")


def section(path: Path = PROCESSORS) -> str:
    """The table of all processors."""
    known = json.loads(path.read_text(encoding="utf-8"))
    rows = [
        [*(("", "") if index else (processor, found["date"])), *row]
        for processor, found in known.items()
        for index, row in enumerate(found["rows"])
    ]
    return (
        "## By processor\n\nLargest steps within the time differ by processor, as the time of a step does; "
        f"each was measured by this command.\n\n{markdown_grid(_HEADINGS, rows)}\n\n"
    )
