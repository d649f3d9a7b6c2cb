"""Copy the results of `mavfi reproduce` to docs/results.md and docs/results/, and their headline to README.md.

    make results NAME=study SCALE=paper          # after `make reproduce SCALE=paper`

Of a study at another scale than paper, only the digests of its ledgers go to README.md.

The reports write `readme_block.md` to their folders; the study writes `study.md`, its figures and tables.  All are
copied verbatim, and the numbers of the README are parsed from the tables, so that none is entered by hand.
"""

import json
import os
import re
import shutil
import sys
from pathlib import Path

from mavfi.extras.paper.report import JSON
from mavfi.report.text import markdown_grid
from tools import published_digests
from tools.markers import DOCS, ROOT, banner, fill
from tools.results import RESULTS, TABLES

BLOCKS = {
    "published_table": "readme_block.md",
    "instruction_table": "instructions/readme_block.md",
    "table": "state_level/readme_block.md",
}
"""File of each table, by marker name."""
PUBLISHED = "paper"
"""The scale whose results are shown."""
DATE = r"Generated on (\S+) by (mavfi \S+)"
Count = tuple[int, int]
"""Number of successes, and n."""


def totals(block: str) -> dict[tuple[str, str], Count]:
    """Successes of mavfi's rows in a success table, summed over environments, by (setting, policy).

    Args:
        block: Markdown table whose cells end in `successes/n`.
    """
    counts: dict[tuple[str, str], Count] = {}
    setting = ""
    for line in block.splitlines():
        cells = [(int(successes), int(n)) for successes, n in re.findall(r" (\d+)/(\d+) ", line)]
        if line.startswith("|") and cells:
            _, name, policy, *_ = (cell.strip() for cell in line.split("|"))
            setting = name or setting  # it stands in the first of its rows only
            counts[setting, policy] = (sum(successes for successes, _ in cells), sum(n for _, n in cells))
    return counts


def lost(count: Count) -> str:
    """Failed missions of a row as text: `9 of 312 missions (2.9 %)`."""
    successes, n = count
    failures = n - successes
    return f"{failures} of {n} missions ({100 * failures / n:.1f} %)"


def headline(fitted: str, letter: str) -> str:
    """What one fault costs, as a paragraph, the table that a reader of the paper knows, and what its letter gives.

    Args:
        fitted: The success table as published.
        letter: The success table at instruction level.

    Raises:
        ValueError: A block is not such a table.
    """
    rows = totals(fitted)
    letter_rows = totals(letter)
    origin = re.search(DATE, fitted)
    try:
        golden = rows["Golden run", "here"]
        fault = rows["Injection run", "here"]
        gaussian = rows["Gaussian-based", "here"]
        autoencoder = rows["Autoencoder-based", "here"]
        mission_ends = letter_rows["Injection run", "here, mission ends"]
        node_restarts = letter_rows["Injection run", "here, node restarts"]
        with_detector = letter_rows["Gaussian-based", "here, node restarts"]
    except KeyError as error:
        raise ValueError(f"not a success table: no row {error}") from error
    if origin is None:
        raise ValueError("not a success table: its date is missing")
    return "\n\n".join(
        [
            f"**One flipped bit in a value that the detectors watch fails {lost(fault)}**, with the paper's Gaussian "
            f"detector {lost(gaussian)}, with its autoencoder {lost(autoencoder)}. Without a fault {golden[0]} of "
            f"{golden[1]} missions succeed. ({origin[2]}, {origin[1]}.)",
            compact(fitted),
            "The paper's golden runs fail in sparse and dense, whatever the fault, ours do not: compare the "
            "differences to the first row. This is the reading of paper and published code that fits the paper best: "
            "[which assumptions produce its tables](docs/results/assumptions.md). By the letter of its text, one bit "
            f"of one executed instruction, a fault fails {lost(node_restarts)} if a dead node restarts, "
            f"{lost(mission_ends)} if it ends the mission, and {lost(with_detector)} with restarts and the Gaussian "
            "detector ([both tables, with intervals](docs/results.md)).",
        ]
    )


def compact(block: str) -> str:
    """Success rates in per cent by setting and environment, with the paper's in brackets, as a Markdown table.

    Args:
        block: A success table; at instruction level, nodes that die restart.

    Raises:
        ValueError: The block is not a success table.
    """
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines() if line.startswith("|")
    ]

    # rates by setting, then by whose they are; a row without a setting belongs to the one above
    rates: dict[str, dict[str, list[str]]] = {}
    setting = ""
    for name, policy, *cells in rows[2:]:
        setting = name or setting
        kind = {"here": "here", "here, node restarts": "here", "paper": "paper"}.get(policy)
        if kind:
            rates.setdefault(setting, {})[kind] = [cell.split()[0] for cell in cells]
    if not rates or any(set(kinds) != {"here", "paper"} for kinds in rates.values()):
        raise ValueError("not a success table with the paper's rates")

    # ours, with the paper's in brackets
    sizes = sorted({int(n) for line in rows for cell in line for n in re.findall(r" \d+/(\d+)$", cell)})
    lines = [
        [setting, *(f"{here} ({paper})" for here, paper in zip(kinds["here"], kinds["paper"], strict=True))]
        for setting, kinds in rates.items()
    ]
    grid = markdown_grid(["missions that succeed, % (the paper's)", *rows[0][2:]], lines, left=1)
    return "\n".join([grid, "", f"One fault per mission; n = {sizes[0]} to {sizes[-1]} per cell."])


def copy_study(out: Path) -> None:
    """Copy the report of a study, its tables and figures to docs/results/, in the place of the former ones."""
    for source, folder in ((out / "figures", RESULTS / "figures"), (out / "tables", TABLES / "study")):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(source, folder)
    text = (out / "study.md").read_text(encoding="utf-8")
    (RESULTS / "study.md").write_text(banner("make results NAME=study SCALE=paper") + text, encoding="utf-8")


def main(out: Path) -> int:
    """Update README.md, docs/results.md and docs/results/ from a study folder; returns the exit code."""
    for name in (*BLOCKS.values(), JSON):
        if not (out / name).is_file():
            print(f"{out / name}: not there; run `make reproduce` first", file=sys.stderr)
            return 2
    study = json.loads((out / JSON).read_text(encoding="utf-8"))
    try:
        digests = published_digests.stored_digests(DOCS) | {study["scale"]: published_digests.of_study(out, study)}
    except ValueError as error:
        print(f"{out}: {error}", file=sys.stderr)
        return 2
    if study["scale"] == PUBLISHED:
        blocks = {name: (out / file).read_text(encoding="utf-8") for name, file in BLOCKS.items()}
        fill(DOCS / "results.md", blocks)
        fill(ROOT / "README.md", {"headline": headline(blocks["published_table"], blocks["instruction_table"])})
        copy_study(out)
    published_digests.write(digests, DOCS)
    fill(ROOT / "README.md", {"digests": published_digests.block(digests)})
    return 0


if __name__ == "__main__":
    scale = os.environ.get("SCALE") or "quick"
    if scale == "quick":
        study_folder = Path("out/reproduce")
    else:
        study_folder = Path(f"out/reproduce-{scale}")
    sys.exit(main(study_folder))
