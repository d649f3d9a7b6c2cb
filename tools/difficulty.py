"""Golden success and fault effect against difficulty: flies both autopilot profiles at several v_max.

    N=40 make results NAME=difficulty

N: missions per density, v_max and autopilot profile, each flown without a fault and with one fault of each kind.
Ledgers are in out/difficulty; the same command resumes an interrupted run.  Writes docs/results/difficulty.md.
"""

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import polars as pl
import typer

from mavfi.analysis.measures import FAILS_OR_SLOWER, SLOWER, rate_of
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate, wilson
from mavfi.analysis.table import RATE, Column, Table
from mavfi.api import load
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.run import run_campaign
from mavfi.cli.progress import Bar
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError
from mavfi.flight.compose import find_environment
from mavfi.report import style
from mavfi.report.text import short, versions
from tools import results
from tools.markers import ROOT

PAGE, PICTURE = "difficulty", results.RESULTS / "difficulty.png"
PROFILES = ("published", "hardened")
SPEEDS = (3.0, 4.5, 6.0, 8.0)
"""Speed limits (m/s); at the last, with time limits that scale with it, golden flights of `published` are as hard as
the paper's."""
ALL = "all three"
SHOWN = ("0.05", "0.25", "0.35")
"""Densities on the page; the table has all."""
SLOW = f"fail or take > {100 * SLOWER:.0f} % longer"
_LOOKS = ((style.BLUE, "o", "-"), (style.AMBER, "s", "--"), (style.PURPLE, "^", ":"), (style.GREEN, "D", "-."))

TEXT = (
    "In denser worlds one fault loses more missions: under `published` a fifth at density 0.05, two thirds from 0.25 "
    "on; under `hardened` at most one of eight. Speed changes little. Worlds are cuboids of 10 m with gaps of at least "
    "2 m; at 8 m/s "
    "golden flights of `published` are about as hard as the paper's hardest. The effect is paired: only missions whose "
    "golden flight arrives count. Three kinds of faults: what the paper found to matter, and the two most dangerous "
    f"sites of the [fault map](fault-map.md).\n\n![Golden success and fault effect against density]({PICTURE.name})"
)
NOTES = (
    "95 % intervals: Wilson; for the three kinds together n is reduced by the design effect of worlds; rates are "
    "conditional on one fault per mission",
    "`all three` pools the same number of faults of each kind; a fault without a site is kept as one without effect "
    "(intention to treat)",
)


@dataclass(frozen=True)
class Cell:
    """One autopilot profile at one v_max and density.

    Attributes:
        profile: Name of the profile.
        v_max: Speed limit (m/s).
        density: Occupied share of the ground.
        runs: Runs of the cell.
    """

    profile: str
    v_max: float
    density: float
    runs: Runs

    @property
    def golden(self) -> Rate:
        """Success rate without a fault."""
        own = self.runs.golden
        return wilson(sum(own["success"]), len(own))

    @property
    def median_time(self) -> float:
        """Median time of the successful golden flights (s); NaN if there is none."""
        times = self.runs.golden.where("success")["flight_time_s"]
        return float(np.median(times)) if times else float("nan")

    def effect(self, test: pl.Expr, target: str = ALL) -> Rate:
        """Share of injected runs that fulfil a test, among missions whose golden flight succeeds."""
        own = self.runs.injected.where("judged", "golden_success")
        return rate_of(own if target == ALL else own.where(target=target), test)


FAILS = ~pl.col("success")
PANELS = (("one fault: fail", FAILS), (f"one fault: {SLOW}", FAILS_OR_SLOWER))


def campaigns(n: int) -> Iterator[tuple[str, float, Campaign, Path]]:
    """Profile, v_max, campaign and ledger folder of each part of the sweep."""
    base = load_campaign("difficulty").model_copy(update={"missions": n, "faults": n})
    for profile in PROFILES:
        for v_max in SPEEDS:
            mission = {**base.mission, "autopilot": profile, "v_max": v_max}
            folder = Path("out", "difficulty", f"n{n}", f"{profile}-{v_max:g}")
            yield profile, v_max, base.model_copy(update={"mission": mission}), folder


def fly_all(n: int, workers: int) -> None:
    """Fly the remaining runs."""
    with stoppable("Stopped. Finished flights are kept in out/difficulty; the same command resumes."):
        for profile, v_max, campaign, directory in campaigns(n):
            with Bar(f"{profile} {v_max:g} m/s") as bar:
                run_campaign(campaign, directory, executor=LocalExecutor(workers), progress=bar.show_campaign)


def read_all(n: int) -> tuple[list[Cell], list[dict[str, Any]]]:
    """All cells, and their source ledgers."""
    cells, sources = [], []
    for profile, v_max, campaign, directory in campaigns(n):
        runs = load(directory)
        sources.append({"directory": directory, **runs.campaign})
        for name in campaign.environments:
            density = float(find_environment(name).parameters["density"])
            cells.append(Cell(profile, v_max, density, runs.where(environment=name)))
    return cells, sources


def effect_table(cells: list[Cell]) -> Table:
    """A row for each cell: golden flights, and the effect of one fault, by kind."""
    targets = [ALL, *dict.fromkeys(target for cell in cells for target in cell.runs.injected.values("target"))]
    columns = [
        Column("autopilot", "autopilot"),
        Column("v_max", "v_max (m/s)", "number g"),
        Column("density", "density", "number g"),
        Column("golden", "golden flights arrive, %", RATE),
        Column("time", "median time (s)", "number .1f"),
        *(Column(f"fails_{target}", f"fail, {target}, %", RATE) for target in targets),
        *(Column(f"hurt_{target}", f"{SLOW}, {target}, %", RATE) for target in targets),
    ]
    rows = []
    for cell in cells:
        fails = (cell.effect(FAILS, target) for target in targets)
        hurt = (cell.effect(FAILS_OR_SLOWER, target) for target in targets)
        rows.append((cell.profile, cell.v_max, cell.density, cell.golden, cell.median_time, *fails, *hurt))
    return Table(PAGE, "Golden flights and the effect of one fault", tuple(columns), rows, keys=3, notes=NOTES)


def write_page(effects: Table, about: list[str]) -> None:
    """Write the page."""
    columns = (
        "autopilot",
        "v_max (m/s)",
        "density",
        "golden flights arrive, %",
        f"fail, {ALL}, %",
        f"{SLOW}, {ALL}, %",
    )
    shown = results.Excerpt(
        "effects", lambda row: row["density"] in SHOWN and row["v_max (m/s)"] in ("3", "8"), columns
    )
    page = results.write(
        PAGE, "Difficulty: golden success and fault effect", TEXT, {"effects": effects}, [shown], about
    )
    print(f"wrote {page.relative_to(ROOT)} and {PICTURE.relative_to(ROOT)}")


def draw(cells: list[Cell], path: Path) -> None:
    """One figure: a row of panels per autopilot profile, a line per v_max."""
    with style.house_style():
        figure, rows = plt.subplots(len(PROFILES), 1 + len(PANELS), figsize=(10, 5.8), sharex=True, sharey=True)
        for profile, line in zip(PROFILES, rows, strict=True):
            own = [cell for cell in cells if cell.profile == profile]
            _panel(line[0], own, [cell.golden for cell in own])
            for axes, (_, test) in zip(line[1:], PANELS, strict=True):
                _panel(axes, own, [cell.effect(test) for cell in own])
            line[0].set_ylabel(f"{profile}\nmissions")
        for axes, title in zip(rows[0], ("golden: arrive", *(title for title, _ in PANELS)), strict=True):
            axes.set_title(title)
        for axes in rows[-1]:
            axes.set_xlabel("density")
        rows[0, 0].set_xticks(sorted({cell.density for cell in cells}))
        rows[0, 0].set_ylim(-0.02, 1.02)
        rows[0, 0].yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
        handles, labels = rows[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=len(SPEEDS))
        figure.set_layout_engine("constrained")
        figure.savefig(path, dpi=100)
        plt.close(figure)


def _panel(axes: Any, cells: list[Cell], rates: list[Rate]) -> None:
    for place, (speed, (colour, marker, dashes)) in enumerate(zip(SPEEDS, _LOOKS, strict=True)):
        own = [(cell.density, rate) for cell, rate in zip(cells, rates, strict=True) if cell.v_max == speed]
        shown = [(x + 0.008 * (place - 1.5), r.rate, r.low or 0.0, r.high) for x, r in own if r.rate is not None]
        if not shown:
            continue
        x, rate, low, high = (np.array(column, float) for column in zip(*shown, strict=True))
        axes.errorbar(
            x,
            rate,
            np.clip([rate - low, high - rate], 0.0, None),
            color=colour,
            marker=marker,
            linestyle=dashes,
            markersize=5,
            linewidth=1.4,
            elinewidth=1.0,
            capsize=2,
            label=f"v_max {speed:g} m/s",
            clip_on=False,
        )
    axes.grid(True)


def main() -> int:
    """Fly, draw, write; returns the exit code."""
    os.chdir(ROOT)
    n, workers = int(os.environ.get("N", "40")), int(os.environ.get("WORKERS", str(os.cpu_count() or 1)))
    try:
        fly_all(n, workers)
    except typer.Exit as stop:  # Ctrl-C; the message has been printed
        return stop.exit_code
    except BadInputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    cells, sources = read_all(n)
    draw(cells, PICTURE)
    about = [f"{n} missions per density, v_max and profile; {' · '.join(versions(sources[0]))}"]
    about += [f"`{source['directory'].as_posix()}`: digest `{short(source['digest'])}`" for source in sources]
    write_page(effect_table(cells), about)
    return 0


if __name__ == "__main__":
    sys.exit(main())
