"""Draw the figures of docs/results whose numbers are in the stored tables again, after a change of how they look.

    make results NAME=figures

The other figures of docs/results/figures need the flights of the study: `make results NAME=study` after
`make reproduce SCALE=paper`.
"""

import csv
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from mavfi.analysis.statistics import Rate
from mavfi.report import style
from mavfi.report.campaign_figures import SuccessCell, draw_success
from tools.results import RESULTS, TABLES

TITLE = "Success · autopilot published · one fault per mission"
SETTINGS = {
    "Golden run": "golden",
    "Injection run": "fi",
    "Gaussian-based": "dr_gaussian",
    "Autoencoder-based": "dr_autoencoder",
}
"""Names of settings, by row of the tables."""
_INTERVALS = "95 % intervals, n below each"


class StoredFigure(NamedTuple):
    """A figure of success, and the table that has its numbers.

    Attributes:
        name: Name of the figure's file.
        table: Name of the table's file.
        policy: Rows of the table that are shown: the cell in its second column.
        conditions: Text below the axes.
    """

    name: str
    table: str
    policy: str
    conditions: str


FIGURES = (
    StoredFigure(
        "as_published_success", "as_published_success_as_in_the_paper", "here", f"faults in all bits; {_INTERVALS}"
    ),
    StoredFigure(
        "table1_success", "table1_success_as_in_the_paper", "here", f"faults in sign + exponent; {_INTERVALS}"
    ),
    StoredFigure(
        "table1_instructions_success",
        "table1_instructions_instructions_as_in_the_paper",
        "here, node restarts",
        f"faults in all bits; nodes that die are restarted; {_INTERVALS}",
    ),
)


def cells(rows: list[Mapping[str, str]], policy: str) -> Iterator[SuccessCell]:
    """The rates of a table of success; golden runs have one policy, "here"."""
    papers_rows = {row["row"]: row for row in rows if row["measure"] == "paper"}
    environments = [column.removesuffix("_n") for column in rows[0] if column.endswith("_n")]
    for name, setting in SETTINGS.items():
        (row,) = (row for row in rows if row["row"] == name and row["measure"] in ("here", policy))
        for environment in environments:
            rate, low, high = (float(row[f"{environment}{end}"]) for end in ("", "_low", "_high"))
            count = int(row[f"{environment}_n"])
            ours = Rate(count, rate, low, high, int(row[f"{environment}_successes"]))
            yield SuccessCell(environment, setting, ours, float(papers_rows[name][environment]))


def main() -> None:
    """Draw all figures."""
    for stored in FIGURES:
        with (TABLES / "study" / f"{stored.table}.csv").open(encoding="utf-8", newline="") as file:
            rows: list[Mapping[str, str]] = list(csv.DictReader(file))
        with style.house_style():
            figure = draw_success(list(cells(rows, stored.policy)), TITLE, stored.conditions)
            style.write(figure, RESULTS / "figures" / f"{stored.name}.png")


if __name__ == "__main__":
    main()
