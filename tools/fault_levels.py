"""The table in docs/concepts/levels.md that puts the levels side by side, from the tables of docs/results."""

import csv
from collections.abc import Iterable

from mavfi.analysis.statistics import wilson
from mavfi.report.text import markdown_grid
from tools.results import TABLES

HEADINGS = ("level", "n", "masked", "other result", "crash", "hang", "exception", "n, missions", "mission succeeds")
ABSENT = "–"
WORLDS = ("factory", "farm", "sparse", "dense")
Row = dict[str, str]


def level_table() -> str:
    """One row for each level: what the fault did to the computation, and to the mission."""
    in_kernels = _kernels(rows_of("study/kernels_kernel_effects"))
    by_instructions = rows_of("study/table1_instructions_instructions_as_in_the_paper")
    by_states = rows_of("study/table1_success_as_in_the_paper")
    unknown = [ABSENT] * len(in_kernels)
    lines = [
        ["instruction (IR), node restarts", *in_kernels, *_mission(by_instructions, "here, node restarts")],
        ["instruction (IR), mission ends with its node", *unknown, *_mission(by_instructions, "here, mission ends")],
        ["state, sign and exponent bits", *unknown, *_mission(by_states, "here")],
        ["register, firmware", *_firmware(rows_of("firmware/firmware_faults"))],
    ]
    return markdown_grid(HEADINGS, lines, left=1)


def rows_of(name: str) -> list[Row]:
    """Rows of a table of docs/results."""
    with (TABLES / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _mission(rows: Iterable[Row], policy: str) -> list[str]:
    """Number of missions with a fault and no detector, and how many succeed, over all environments."""
    (row,) = (row for row in rows if (row["row"], row["measure"]) == ("Injection run", policy))
    good, runs = (sum(int(row[f"{world}_{part}"]) for world in WORLDS) for part in ("successes", "n"))
    return [str(runs), _cell(good, runs)]


def _kernels(rows: list[Row]) -> list[str]:
    """What faults in instructions did to the kernel: runs of all kernels together."""
    total, masked, other = (sum(int(row[key]) for row in rows) for key in ("n", "masked_successes", "sdc_successes"))
    kinds = [[int(count) for count in row["due_kinds"].split(" / ")] for row in rows]
    deaths = [sum(counts) for counts in zip(*kinds, strict=True)]
    return [str(total), *(_cell(count, total) for count in (masked, other, *deaths))]


def _firmware(rows: Iterable[Row]) -> list[str]:
    """What faults in registers of the firmware did to whole missions."""
    (row,) = (row for row in rows if row["registers"] == "in all")
    runs = int(row["n"])
    masked, arrives, lost, ends, hangs = (
        int(row[f"{key}_successes"]) for key in ("identical", "arrives", "lost", "ends", "hangs")
    )
    counts = (masked, arrives + lost, ends, hangs)
    return [str(runs), *(_cell(count, runs) for count in counts), ABSENT, str(runs), _cell(masked + arrives, runs)]


def _cell(count: int, total: int) -> str:
    """Per cent, 95 % Wilson interval, count."""
    rate = wilson(count, total)
    if rate.low is None or rate.high is None:
        return ABSENT
    return f"{100 * count / total:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}] {count}"
