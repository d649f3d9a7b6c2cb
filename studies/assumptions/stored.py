"""Rows of the study as CSV files: written after its flights, read to write its page."""

import csv
from pathlib import Path
from typing import Any, NamedTuple

from tools.results import TABLES

FOLDER = TABLES / "assumptions"
"""Published rows."""


class StoredTable(NamedTuple):
    """A table of the study.

    Attributes:
        name: Name of its file, without `.csv`.
        columns: Names of its columns.
        rows: Its rows; None is an empty cell.
    """

    name: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]

    def write(self, folder: Path) -> None:
        """Write the file."""
        with (folder / f"{self.name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(self.columns)
            writer.writerows(self.rows)


def stored_rows(name: str, folder: Path = FOLDER) -> list[dict[str, str]]:
    """Rows of a table, by column."""
    with (folder / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
