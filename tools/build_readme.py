"""Copy the results of `mavfi reproduce` to docs/results.md and docs/results/, and their headline to README.md.

    make results NAME=study SCALE=paper          # after `make reproduce SCALE=paper`

Of a study at another scale than paper, only the digests of its ledgers are copied.

The reports write `readme_block.md` to their folders; the study writes `study.md`, its figures and tables.  All are
copied verbatim, and the numbers of the README are parsed from the tables, so that none is entered by hand.
"""

import csv
import json
import os
import re
import shutil
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import scheme_of
from mavfi.extras.paper.report import JSON
from mavfi.report.text import markdown_grid
from tools import published_digests
from tools.markers import DOCS, ROOT, banner, block_of, fill
from tools.results import RESULTS, TABLES

BLOCKS = {
    "published_table": "readme_block.md",
    "instruction_table": "instructions/readme_block.md",
    "table": "state_level/readme_block.md",
}
"""File of each table, by marker name."""
PUBLISHED = "paper"
"""The scale whose results are shown."""
Count = tuple[int, int]
"""Number of successes, and n."""
LEVELS = {
    "state": "a value between kernels, every stage alike",
    "sites": "a value between kernels, fields and bits that lose most",
    "message": "a message between kernels: sign, exponent or length of a list",
    "instruction": "an instruction of the planner",
    "memory": "what a node remembers: the words that lose most",
}
"""Parts in README.md, and the place of their faults in words."""
COMPARED = ("gaussian", "autoencoder", "recommended")
"""Schemes that are compared in README.md: the paper's two detectors, and this project's."""
BACK = "brought back"
"""Heading of that number and of all lost missions, in rows of the leaderboard."""
RECOVERY = """\
Missions in the worlds `dense` and `factory` lost to one flipped bit, and how many of them a detector brings back:

| one flipped bit in | lost | the paper's Gaussian detector | its autoencoder | `recommended` |
|---|---:|---:|---:|---:|
{rows}

{remarks}"""
MOVED = (
    'A cell with "of" counts only faults that meet the same value with the scheme as without it: false alarms change '
    "the course of the other flights."
)
RECOMMENDED = (
    "`recommended` consists of rules of physics and protocol; nothing is trained. "
    "[Leaderboard](docs/results/leaderboard.md), with intervals; [five rules](docs/concepts/engineers.md) for a stack "
    "of your own."
)
_COUNT = re.compile(r"(\d+)/(\d+)$")


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
    """Failed missions of a row as text: `9 of 312 (2.9 %)`."""
    successes, n = count
    failures = n - successes
    return f"{failures} of {n} ({100 * failures / n:.1f} %)"


CLAIMS = TABLES / "study" / "claims.csv"
"""Findings of the paper with the verdict on each."""
VERDICTS = ("confirmed", "contradicted", "undecided")
READINGS = (
    ("published_table", "here", "a value that the paper's detectors watch: the reading that fits its table best"),
    ("table", "here", "any value between programs, in its sign or exponent"),
    ("instruction_table", "here, node restarts", "an executed instruction, the letter of its text"),
    ("instruction_table", "here, mission ends", "the same, but a program that crashes is not restarted"),
)
"""Where a bit is flipped, by table and policy."""


def findings(blocks: Mapping[str, str], claims: Sequence[Mapping[str, str]]) -> str:
    """What one fault costs, how many of the paper's findings are confirmed, and what its detectors recover, as a list.

    Args:
        blocks: Success tables by marker name.
        claims: Rows of the study's table of findings.

    Raises:
        ValueError: A block is not such a table.
    """
    fitted = _rows_of(blocks["published_table"])
    letter = _rows_of(blocks["instruction_table"])
    golden = fitted["Golden run", "here"]
    counts = Counter(claim["verdict"] for claim in claims)
    verdicts = {claim["claim"]: claim["verdict"] for claim in claims}
    return "\n".join(
        [
            f"- **A fault:** without one {golden[0]} of {golden[1]} missions succeed. One flipped bit in a value that "
            f"programs exchange loses {lost(fitted['Injection run', 'here'])}; one in an executed instruction "
            f"{lost(letter['Injection run', 'here, node restarts'])}, or "
            f"{lost(letter['Injection run', 'here, mission ends'])} if a crashed program is not restarted.",
            f"- **The paper:** of {len(claims)} of its findings, each tested on fresh flights, "
            + ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS)
            + " at this number of flights ([every one](docs/results/study.md#findings-of-the-paper-tested)).",
            "- **Its detectors:** with the faults that fit its table best, the Gaussian detector (ranges of values) "
            f"leaves {lost(fitted['Gaussian-based', 'here'])} missions lost, the autoencoder "
            f"{lost(fitted['Autoencoder-based', 'here'])}. With faults in executed instructions, as its text says, "
            f"{_recovery_of(verdicts)} ([by assumption](#what-was-found)).",
        ]
    )


RECOVERS = {
    "confirmed": "brings missions back",
    "contradicted": "loses more missions than it brings back",
    "undecided": "has no clear effect at this number of flights",
}
"""What a detector does, by the verdict on the finding that it recovers missions."""


def _recovery_of(verdicts: Mapping[str, str]) -> str:
    """What the paper's detectors do under faults in instructions, from the verdicts by claim."""
    gaussian = RECOVERS[verdicts["gaussian_recovers"]]
    autoencoder = RECOVERS[verdicts["autoencoder_recovers"]]
    if gaussian == autoencoder:
        return f"each of them {gaussian}"
    return f"the Gaussian detector {gaussian}, the autoencoder {autoencoder}"


def by_reading(blocks: Mapping[str, str]) -> str:
    """Missions lost without and with the paper's detectors, by what the paper is taken to mean, as a Markdown table.

    Raises:
        ValueError: A block is not a success table.
    """
    lines = []
    for name, policy, meaning in READINGS:
        rows = _rows_of(blocks[name])
        settings = ("Injection run", "Gaussian-based", "Autoencoder-based")
        counts = [rows[setting, policy] for setting in settings]
        cells = [f"{n - successes} ({100 * (n - successes) / n:.1f} %)" for successes, n in counts]
        lines.append([meaning, str(counts[0][1]), *cells])
    return markdown_grid(
        ["one flipped bit in", "missions", "lost", "with the Gaussian detector", "with the autoencoder"], lines, left=1
    )


def count_of(text: str) -> Count | None:
    """The count in a cell like `57.6 [49.0, 65.7] 76/132`."""
    count = _COUNT.search(text)
    if count is None:
        return None
    return int(count[1]), int(count[2])


def recovery_block(rows: Mapping[str, Sequence[Mapping[str, str]]], alarms_per_hour: Mapping[str, str]) -> str:
    """Missions brought back by the compared schemes, by level, and their false alarms.

    Args:
        rows: Published rows of the leaderboard, by part.
        alarms_per_hour: False alarms on golden flights, by scheme; empty if these were not flown.

    Raises:
        BadInputError: No level has rows of all of these schemes.
    """
    # a row for each level that was flown with all of them
    lines = []
    shares: list[str] = []
    for part, where in LEVELS.items():
        of_scheme = {scheme_of(row): row for row in rows.get(part, ())}
        if of_scheme.keys() >= set(COMPARED):
            lost = int(of_scheme[COMPARED[-1]]["lost"])
            cells = [_share(of_scheme[scheme][BACK], lost) for scheme in COMPARED]
            lines.append(f"| {where} | {lost} | {' | '.join(cells)} |")
            shares += cells
    if not lines:
        raise BadInputError(f"leaderboard: no part has rows of {', '.join(COMPARED)}; needed: one")

    # the sentences below them
    remarks = []
    alarms = [f"{alarms_per_hour[scheme]} (`{scheme}`)" for scheme in COMPARED if scheme in alarms_per_hour]
    if alarms:
        remarks.append(f"False alarms per hour of flight without a fault: {', '.join(alarms)}.")
    if any(" of " in share for share in shares):
        remarks.append(MOVED)
    return RECOVERY.format(rows="\n".join(lines), remarks=" ".join([*remarks, RECOMMENDED]))


def _share(back: str, lost: int) -> str:
    """E.g. "3 (50 %)"; with the number of which, if not all lost missions can be compared."""
    count = count_of(back)
    if count is None:
        return back
    share = f"{100 * count[0] / count[1]:.0f} %"
    if count[1] != lost:
        return f"{count[0]} of {count[1]} ({share})"
    return f"{count[0]} ({share})"


def _judged(lost: str, cell: str) -> int:
    """Number of lost missions that a cell judges; one like "0 of 61 (0 %)" judges fewer than its row."""
    fewer = re.search(r"of (\d+)", cell)
    if fewer:
        return int(fewer[1])
    return int(lost)


def recommended_item(recovery: str) -> str:
    """What `recommended` brings back, from the block of the leaderboard, as an item of a list.

    Raises:
        ValueError: The block has no rows of counts.
    """
    rows = [line.strip("|").split("|")[1:] for line in recovery.splitlines() if re.match(r"\| [^|]+ \| \d+ \|", line)]
    if not rows:
        raise ValueError("not the recovery block: no rows of counts")
    totals_back = []
    for column in (1, 2, 3):
        back = sum(int(row[column].split()[0]) for row in rows)
        judged = sum(_judged(row[0], row[column]) for row in rows)
        totals_back.append(f"{back:,} of {judged:,}")
    gaussian, autoencoder, recommended = totals_back
    return (
        f"- **What helps:** [`recommended`](docs/concepts/recovery.md), rules of physics and protocol that need no "
        f"training, brings back {recommended} missions lost to {len(rows)} kinds of faults, which this project chose; "
        f"the paper's Gaussian detector {gaussian}, its autoencoder {autoencoder}."
    )


def _rows_of(block: str) -> dict[tuple[str, str], Count]:
    """Rows of a success table; a ValueError if there are none, or no date."""
    rows = totals(block)
    if ("Injection run", "paper") in rows or not any(setting == "Golden run" for setting, _ in rows):
        raise ValueError("not a success table")
    return rows


def readme_blocks(page: str, claims: Path = CLAIMS) -> dict[str, str]:
    """Parts of README.md, from the tables of docs/results.md, by marker name."""
    blocks = {name: block_of(page, name) for name in BLOCKS}
    with claims.open(encoding="utf-8", newline="") as file:
        return {"findings": findings(blocks, list(csv.DictReader(file))), "readings": by_reading(blocks)}


def copy_study(out: Path) -> None:
    """Copy the report of a study, its tables and figures to docs/results/, in the place of the former ones."""
    for source, folder in ((out / "figures", RESULTS / "figures"), (out / "tables", TABLES / "study")):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(source, folder)
    text = (out / "study.md").read_text(encoding="utf-8").replace("(tables/", "(tables/study/")
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
        copy_study(out)
        fill(ROOT / "README.md", readme_blocks((DOCS / "results.md").read_text(encoding="utf-8")))
    published_digests.write(digests, DOCS)
    fill(DOCS / "results.md", {"digests": published_digests.block(digests)})
    return 0


if __name__ == "__main__":
    scale = os.environ.get("SCALE") or "quick"
    if scale == "quick":
        study_folder = Path("out/reproduce")
    else:
        study_folder = Path(f"out/reproduce-{scale}")
    sys.exit(main(study_folder))
