"""Draw figures of docs/results again, after a change of how they look: success from the stored tables, and paths.

    make results NAME=figures

The paths are flown again, a mission each.  The other figures of docs/results/figures need the flights of the study:
`make results NAME=study` after `make reproduce SCALE=paper`.
"""

import csv
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import polars as pl

from mavfi.analysis.listing import with_flights
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.campaign.config import load_campaign
from mavfi.extras.paper.figures import path_cases, trajectories
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


def draw_paths() -> None:
    """Fly the missions of the cases in Fig. 7 with all their faults, and draw the cases.

    Raises:
        ValueError: Other runs are chosen than those that docs/results/study.md names.
    """
    text = (RESULTS / "study.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^Fig\. 7.* Shown: (.*)\.$", text, re.MULTILINE)
    named_ids = re.findall(r"`([^`]+)`", shown)
    campaign = load_campaign("as_published").at_scale("paper")
    worlds = [(name, seed) for name in campaign.environments for seed in campaign.seeds]
    missions = []
    with tempfile.TemporaryDirectory() as root:
        for run_id in named_ids:
            environment, seed, *_ = run_id.split("-")
            shard = f"{worlds.index((environment, int(seed))) + 1}/{len(worlds)}"
            folder = Path(root) / run_id
            options = ["--scale", "paper", "--shard", shard, "--out", str(folder)]
            subprocess.run([sys.executable, "-m", "mavfi", "campaign", "run", "as_published", *options], check=True)
            runs = Runs.read(folder)
            chosen = [case for case in path_cases(runs) if case.fault == run_id]
            if not chosen:
                raise ValueError(f"{run_id}: is not the case of its mission")
            case = chosen[0]
            missions.append(with_flights(runs, folder, [case.golden, case.fault, case.recovered]))
    together = Runs(
        pl.concat([runs.frame for runs in missions]),
        {run_id: record for runs in missions for run_id, record in runs.records.items()},
        missions[0].campaign,
        {run_id: flight for runs in missions for run_id, flight in runs.flights.items()},
    )
    if [case.fault for case in path_cases(together)] != named_ids:
        raise ValueError(f"{named_ids}: other runs are chosen")
    with style.house_style():
        figure = trajectories(together)
        if figure is None:
            raise ValueError(f"{named_ids}: no figure")
        style.write(figure, RESULTS / "figures" / "as_published_trajectories.png")


def main() -> None:
    """Draw all figures."""
    draw_paths()
    for stored in FIGURES:
        with (TABLES / "study" / f"{stored.table}.csv").open(encoding="utf-8", newline="") as file:
            rows: list[Mapping[str, str]] = list(csv.DictReader(file))
        with style.house_style():
            figure = draw_success(list(cells(rows, stored.policy)), TITLE, stored.conditions)
            style.write(figure, RESULTS / "figures" / f"{stored.name}.png")


if __name__ == "__main__":
    main()
