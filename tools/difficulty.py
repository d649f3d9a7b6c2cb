"""Golden success and fault effect against difficulty: flies both autopilot profiles at several v_max.

    N=40 WORKERS=2 python -m tools.difficulty

N: missions per density, v_max and autopilot profile, each flown without a fault and with one fault of each kind.
Ledgers are in out/difficulty; the same command resumes an interrupted run.  Writes docs/generated/difficulty.md.
"""

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import polars as pl
import typer

from mavfi.api import load
from mavfi.campaign.analysis.measures import FAILS_OR_SLOWER, SLOWER, rate_of
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.statistics import Rate, wilson
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.run import run_campaign
from mavfi.cli.progress import Bar
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError
from mavfi.hosts.loop.compose import find_environment
from mavfi.reports import style
from mavfi.reports.text import markdown_grid
from tools.markers import GENERATED, ROOT, banner

PAGE, PICTURE = GENERATED / "difficulty.md", GENERATED / "difficulty.png"
PROFILES = ("published", "hardened")
SPEEDS = (3.0, 4.5, 6.0, 8.0)
"""Speed limits (m/s); at the last, with time limits that scale with it, golden flights of `published` are as hard as
the paper's."""
ALL = "all three"
CELL = ("autopilot", "v_max (m/s)", "density")
SLOW = f"fail or take > {100 * SLOWER:.0f} % longer"
_LOOKS = ((style.BLUE, "o", "-"), (style.AMBER, "s", "--"), (style.PURPLE, "^", ":"), (style.GREEN, "D", "-."))

HEAD = """# Difficulty: golden success and fault effect

How the effect of a fault changes with the difficulty of missions. Worlds are cuboids of 10 m by [density, side] as in
the paper, at densities from 0.05 to 0.35. With the usual gaps of 3 m no more than about 0.32 fits, so all worlds of
this sweep have gaps of at least 2 m (the vehicle is 0.7 m wide): the same rule at every density. v_max is 3 to 6 m/s,
where golden flights hardly ever fail, and 8 m/s, where those of `published` are about as hard as the paper's hardest
(85 % arrived):
time limits follow v_max, and a vehicle that replans too often exceeds them.

Each mission is flown without a fault and with one fault of each of three kinds; the first kind is what the paper found
to matter, the others are the most dangerous sites of the [fault map](fault-map.md). The effect is paired: only missions
whose golden flight arrives count, so a mission that fails without a fault is not counted as an effect of the fault.

![Golden success and fault effect against density]({picture})

"""
FOOT = """## How to read it

Intervals are 95 %: Wilson; for the three kinds together with n reduced by the design effect of worlds. All rates are
conditional on one fault per mission. `{all}` pools the same number of faults of each kind; other weights give
other figures. A golden flight on which no collision is predicted has no flag to inject into; such a fault is kept as
one without effect (intention to treat). Seeds follow each other from {seed} on; none is left out.

Flown by `make difficulty` (N={n}); a single run again: `mavfi replay DIRECTORY RUN_ID`, with the directory of the
ledger from the list above.
"""


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


def share(rate: Rate) -> str:
    """A rate as text: per cent, interval and counts."""
    if rate.rate is None or rate.low is None or rate.high is None:
        return "—"
    return f"{100 * rate.rate:.0f} [{100 * rate.low:.0f}, {100 * rate.high:.0f}] {rate.successes}/{rate.n}"


def page(cells: list[Cell], sources: list[dict[str, Any]], n: int) -> str:
    """The page."""
    targets = [ALL, *dict.fromkeys(target for cell in cells for target in cell.runs.injected.values("target"))]
    golden = [(*_key(cell), share(cell.golden), f"{cell.median_time:.1f}") for cell in cells]
    versions = ", ".join(f"{name} {found}" for name, found in sources[0]["versions"].items())
    ledgers = [f"- `{source['directory'].as_posix()}`: digest `{source['digest'][:16]}`" for source in sources]
    seeds = sorted({seed for cell in cells for seed in cell.runs["seed"]})
    head = banner("make difficulty") + HEAD.format(picture=PICTURE.name)
    return head + "\n".join([
        f"Measured: {date.today().isoformat()} ({versions}); {n} missions per density, v_max and profile (seeds "
        f"{seeds[0]} to {seeds[-1]}), {sum(len(cell.runs) for cell in cells)} flights. Ledgers:", "", *ledgers, "",
        "## Golden flights", "", markdown_grid((*CELL, "arrive, %", "median time (s)"), golden), "",
        *_effects("One fault: missions that fail, %", cells, targets, FAILS),
        *_effects(f"One fault: missions that {SLOW}, %", cells, targets, FAILS_OR_SLOWER),
        FOOT.format(all=ALL, seed=seeds[0], n=n),
    ])  # fmt: skip


def _key(cell: Cell) -> tuple[str, ...]:
    return cell.profile, f"{cell.v_max:g}", f"{cell.density:g}"


def _effects(title: str, cells: list[Cell], targets: list[str], test: pl.Expr) -> list[str]:
    lines = [(*_key(cell), *(share(cell.effect(test, target)) for target in targets)) for cell in cells]
    return [f"## {title}", "", markdown_grid((*CELL, *targets), lines), ""]


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
            x, rate, np.clip([rate - low, high - rate], 0.0, None), color=colour, marker=marker, linestyle=dashes,
            markersize=5, linewidth=1.4, elinewidth=1.0, capsize=2, label=f"v_max {speed:g} m/s", clip_on=False,
        )  # fmt: skip
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
    text = page(cells, sources, n)
    PAGE.write_text(text, encoding="utf-8")
    sys.stdout.write(text)
    sys.stdout.write(f"wrote {PAGE.relative_to(ROOT)} and {PICTURE.relative_to(ROOT)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
