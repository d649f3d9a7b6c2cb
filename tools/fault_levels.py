"""The table in docs/fault-model.md that puts the levels side by side, from the counts on the pages of results."""

import re

from mavfi.campaign.analysis.statistics import wilson
from mavfi.reports.text import markdown_grid
from tools.markers import DOCS, GENERATED

HEADINGS = ("level", "n", "masked", "other result", "crash", "hang", "exception", "n, missions", "mission succeeds")
_SHARE = re.compile(r"(\d+)/(\d+)$")
_DEATHS = re.compile(r"^(\d+) / (\d+) / (\d+)$")
Cells = list[str]


def level_table() -> str:
    """One row for each level: what the fault did to the computation, and to the mission."""
    results = (DOCS / "results.md").read_text(encoding="utf-8")
    study = (DOCS / "results" / "study.md").read_text(encoding="utf-8")
    firmware = (GENERATED / "firmware.md").read_text(encoding="utf-8")
    in_kernels = _kernels(study)
    by_instructions, by_states = _block(results, "instruction_table"), _block(results, "table")
    unknown = ["–"] * len(in_kernels)
    rows = [
        ["instruction (IR), node restarts", *in_kernels, *_mission(by_instructions, "here, node restarts")],
        ["instruction (IR), mission ends with its node", *unknown, *_mission(by_instructions, "here, mission ends")],
        ["state, sign and exponent bits", *unknown, *_mission(by_states, "here")],
        ["register, firmware", *_firmware(firmware)],
    ]
    return markdown_grid(HEADINGS, rows, left=1)


def _block(page: str, name: str) -> str:
    """Text between a page's markers."""
    return page.split(f"<!-- {name}:begin -->")[1].split(f"<!-- {name}:end -->")[0]


def _rows(text: str) -> list[Cells]:
    """Cells of all table rows."""
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]


def _shares(cells: Cells) -> list[tuple[int, int]]:
    """Counts and totals at the ends of cells."""
    return [(int(found[1]), int(found[2])) for cell in cells if (found := _SHARE.search(cell))]


def _mission(table: str, setting: str) -> Cells:
    """Number of missions with a fault and no detector, and how many succeed, over all environments."""
    title = ""
    for cells in _rows(table):
        title = cells[0] or title
        if (title, cells[1]) == ("Injection run", setting):
            good, runs = (sum(one) for one in zip(*_shares(cells), strict=True))
            return [str(runs), _cell(good, runs)]
    raise ValueError(f"no row 'Injection run', {setting!r}")


def _kernels(study: str) -> Cells:
    """What faults in instructions did to the kernel: runs of all kernels together."""
    part = study.split("## One fault in one instruction: what the kernel did")[1].split("\n## ")[0]
    rows = [(_shares(cells), _DEATHS.match(cells[-1])) for cells in _rows(part)]
    found = [(shares, tuple(map(int, deaths.groups()))) for shares, deaths in rows if deaths]
    total = sum(shares[0][1] for shares, _ in found)
    masked, other = (sum(shares[place][0] for shares, _ in found) for place in (0, 1))
    deaths = [sum(one[place] for _, one in found) for place in range(3)]
    return [str(total), *(_cell(count, total) for count in (masked, other, *deaths))]


def _firmware(page: str) -> Cells:
    """What faults in registers of the firmware did to whole missions."""
    part = page.split("### What one bit in a register of the firmware does to the mission")[1].split("\n### ")[0]
    (row,) = (cells for cells in _rows(part) if cells[0] == "in all")
    (masked, runs), (arrives, _), (lost, _), (ends, _), (hangs, _) = _shares(row)
    counts = masked, arrives + lost, ends, hangs
    return [str(runs), *(_cell(count, runs) for count in counts), "–", str(runs), _cell(masked + arrives, runs)]


def _cell(count: int, total: int) -> str:
    """Per cent, 95 % Wilson interval, count."""
    rate = wilson(count, total)
    if rate.low is None or rate.high is None:
        return "–"
    return f"{100 * count / total:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}] {count}"
