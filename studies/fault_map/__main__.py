"""Fly the campaign `fault_map`, and write docs/results/fault-map.md: what one flipped bit does, site by site.

python -m studies.fault_map
"""

import sys

import polars as pl

from mavfi.analysis.measures import FAILS_OR_SLOWER, rate_of
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import RATE, SIGNED, Column, Table
from mavfi.api import load
from mavfi.errors import BadInputError
from mavfi.report.text import header
from tools import results
from tools.markers import ROOT

PAGE = "fault-map"
COLUMNS = (
    Column("target", "injected"),
    Column("fails", "missions that fail, %", RATE),
    Column("hurt", "that fail or take > 5 % longer, %", RATE),
    Column("worst", "worst time", SIGNED),
)
TEXT = (
    "A flag, its counter and the epochs of trajectories lose most missions, and no detector of the paper watches the "
    "epochs; way-points and path vertices cost time and some missions while they are in force; clouds, voxels and "
    "commands, which the next message repairs, cost next to nothing. Of the paper's findings these confirm that "
    "way-points matter, mantissas and low bits do not. Flown on the design seeds, on which the autopilot profiles "
    "were tuned, to see whether a change of a rule hides faults: for publication, campaigns `table1` and `states` fly"
    " other seeds."
)
MOST_HARMFUL = 0.07
"""Rows are shown whose rate of failed missions is at least this, and those that the text names."""
NAMED = ("cloud point", "voxel", "command velocity")


def fault_table(runs: Runs) -> Table:
    """One row per site: failures and delays with their intervals, worst flight time."""
    rows = []
    for (target,), flights in runs.injected.where("judged").groups("target").items():
        fails = rate_of(flights.adding(failed=~pl.col("success")), "failed")
        worst = max((inflation for inflation in flights["inflation"] if inflation is not None), default=0.0)
        rows.append((str(target), fails, rate_of(flights, FAILS_OR_SLOWER), worst))
    notes = ("95 % intervals: Wilson; a fault in a state that a golden flight never publishes has no effect",)
    return Table(PAGE, "Effect of one flipped bit, by site", COLUMNS, rows, notes=notes)


def write_page(sites: Table, about: list[str]) -> None:
    """Write the page."""
    harmful = {target for target, fails, *_ in sites.rows if (fails.rate or 0.0) >= MOST_HARMFUL}
    excerpt = results.Excerpt("sites", lambda row: row["injected"] in harmful or row["injected"].startswith(NAMED))
    title = "Fault map: what one flipped bit does"
    command = "python -m studies.fault_map"
    page = results.write(PAGE, title, TEXT, {"sites": sites}, [excerpt], about, command=command)
    print(f"wrote {page.relative_to(ROOT)}")


def main() -> int:
    """Fly and write; returns the exit code."""
    try:
        runs = load(results.fly("fault_map", scale=""))
    except BadInputError as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    write_page(fault_table(runs), header(runs.campaign))
    return 0


if __name__ == "__main__":
    sys.exit(main())
