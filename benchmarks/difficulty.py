"""Golden success and fault effect against difficulty: flies both autopilot profiles at several v_max.

    N=40 WORKERS=2 python -m benchmarks.difficulty

N: missions per density, v_max and stack, each flown without a fault and with one fault of each kind.  Ledgers are in
out/difficulty; what is flown is kept, and the same command resumes.  Writes docs/generated/difficulty.md.
"""

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import typer

from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.flights import Row, is_golden, is_injected, read_rows
from mavfi.campaign.run import run_campaign
from mavfi.campaign.statistics import Rate, clustered_rate, wilson
from mavfi.campaign.store import Store
from mavfi.campaign.success import SLOWER, fails_or_slower
from mavfi.cli.progress import Bar, import_host
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError
from mavfi.hosts.loop.compose import find_environment
from mavfi.reports import style
from tools.markers import GENERATED, ROOT, banner

PAGE, PICTURE = GENERATED / "difficulty.md", GENERATED / "difficulty.png"
STACKS = ("published", "hardened")
SPEEDS = (3.0, 4.5, 6.0, 8.0)
"""m/s; the last, with time limits that follow it, makes golden flights of `published` as hard as the paper's."""
ALL = "all three"
CELL = ("stack", "v_max (m/s)", "density")
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
    """One stack at one v_max in one density.

    Attributes:
        stack: Name.
        v_max: m/s.
        environment: Name.
        density: Share of the ground.
        rows: Its runs.
    """

    stack: str
    v_max: float
    environment: str
    density: float
    rows: list[Row]

    @property
    def golden(self) -> Rate:
        """Success without a fault."""
        own = [row for row in self.rows if is_golden(row)]
        return wilson(sum(row.success for row in own), len(own))

    @property
    def median_time(self) -> float:
        """Median flight time of the golden flights that arrive (s); NaN if none does."""
        times = [row.record["flight_time_s"] for row in self.rows if is_golden(row) and row.success]
        return float(np.median(times)) if times else float("nan")

    def effect(self, test: Callable[[Row], bool], target: str = ALL) -> Rate:
        """Share of the missions whose golden flight arrives for which a test holds with a fault."""
        own = [
            row for row in self.rows
            if is_injected(row) and row.judged and row.golden_success and target in (ALL, row.spec.target)
        ]  # fmt: skip
        return clustered_rate([test(row) for row in own], [row.world for row in own])


def fails(row: Row) -> bool:
    """Whether the mission failed."""
    return not row.success


PANELS: tuple[tuple[str, Callable[[Cell], Rate]], ...] = (
    ("golden: arrive", lambda cell: cell.golden),
    ("one fault: fail", lambda cell: cell.effect(fails)),
    (f"one fault: {SLOW}", lambda cell: cell.effect(fails_or_slower)),
)


def campaigns(n: int) -> Iterator[tuple[Campaign, Path]]:
    """Every campaign of the sweep, and where its ledger is."""
    base = load_campaign("difficulty").model_copy(update={"flights": n, "faults": n})
    for stack in STACKS:
        for v_max in SPEEDS:
            name = f"{stack}-{v_max:g}"
            yield base.model_copy(update={"stack": stack, "v_max": v_max}), Path("out", "difficulty", f"n{n}", name)


def fly_all(n: int, workers: int) -> None:
    """Fly what is left."""
    told = "Stopped. What is flown is kept in out/difficulty; the same command goes on."
    import_host()
    with stoppable(told):
        for campaign, directory in campaigns(n):
            with Bar(f"{campaign.stack} {campaign.v_max:g} m/s") as bar:
                run_campaign(campaign, directory, workers=workers, progress=bar.show_campaign)


def read_all(n: int) -> tuple[list[Cell], list[dict[str, Any]]]:
    """All cells, and where they come from."""
    cells, sources = [], []
    for campaign, directory in campaigns(n):
        with Store.open(directory) as store:
            rows = read_rows(store)
            sources.append({"directory": directory, "digest": store.digest(), "versions": store.meta("versions")})
        for name in campaign.environments:
            own = [row for row in rows if row.spec.environment == name]
            density = float(find_environment(name).parameters["density"])
            cells.append(Cell(campaign.stack, campaign.v_max or 0.0, name, density, own))
    return cells, sources


def share(rate: Rate) -> str:
    """A rate as text: per cent, interval, counts."""
    if rate.rate is None or rate.low is None or rate.high is None:
        return "—"
    return f"{100 * rate.rate:.0f} [{100 * rate.low:.0f}, {100 * rate.high:.0f}] {rate.successes}/{rate.n}"


def table(head: tuple[str, ...], lines: list[tuple[str, ...]]) -> list[str]:
    """A table in Markdown."""
    return ["| " + " | ".join(line) + " |" for line in (head, tuple("---" for _ in head), *lines)]


def page(cells: list[Cell], sources: list[dict[str, Any]], n: int) -> str:
    """The page."""
    targets = [ALL, *dict.fromkeys(row.spec.target for cell in cells for row in cell.rows if is_injected(row))]
    golden = [
        (c.stack, f"{c.v_max:g}", f"{c.density:g}", share(c.golden), f"{c.median_time:.1f}") for c in cells
    ]  # fmt: skip
    versions = ", ".join(f"{name} {found}" for name, found in sources[0]["versions"].items())
    ledgers = [f"- `{source['directory'].as_posix()}`: digest `{source['digest'][:16]}`" for source in sources]
    seeds = sorted({row.spec.seed for cell in cells for row in cell.rows})
    return banner("make difficulty") + HEAD.format(picture=PICTURE.name) + "\n".join([
        f"Measured: {date.today().isoformat()} ({versions}); {n} missions per density, v_max and stack (seeds "
        f"{seeds[0]} to {seeds[-1]}), {sum(len(cell.rows) for cell in cells)} flights. Ledgers:", "", *ledgers, "",
        "## Golden flights", "", *table((*CELL, "arrive, %", "median time (s)"), golden), "",
        *_effects("One fault: missions that fail, %", cells, targets, fails),
        *_effects(f"One fault: missions that {SLOW}, %", cells, targets, fails_or_slower),
        FOOT.format(all=ALL, seed=seeds[0], n=n),
    ])  # fmt: skip


def _effects(title: str, cells: list[Cell], targets: list[str], test: Callable[[Row], bool]) -> list[str]:
    lines = [
        (c.stack, f"{c.v_max:g}", f"{c.density:g}", *(share(c.effect(test, target)) for target in targets))
        for c in cells
    ]
    return [f"## {title}", "", *table((*CELL, *targets), lines), ""]


def draw(cells: list[Cell], path: Path) -> None:
    """One figure: a row of panels for each stack, a line for each v_max."""
    with style.house_style():
        figure, rows = plt.subplots(len(STACKS), len(PANELS), figsize=(10, 5.8), sharex=True, sharey=True)
        for stack, line in zip(STACKS, rows, strict=True):
            for (title, rate_of), axes in zip(PANELS, line, strict=True):
                own = [cell for cell in cells if cell.stack == stack]
                _panel(axes, own, rate_of)
                axes.set_title(title if stack == STACKS[0] else "")
            line[0].set_ylabel(f"{stack}\nmissions")
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


def _panel(axes: Any, cells: list[Cell], rate_of: Callable[[Cell], Rate]) -> None:
    for place, (speed, (colour, marker, dashes)) in enumerate(zip(SPEEDS, _LOOKS, strict=True)):
        own = [(cell.density, rate_of(cell)) for cell in cells if cell.v_max == speed]
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
    except typer.Exit as stop:  # Ctrl-C; what is kept has been told
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
