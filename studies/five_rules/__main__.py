"""The rules of docs/concepts/engineers.md: their benefit in the leaderboard's flights, and that of each rule alone.

python -m studies.five_rules          # flies the bench `five-rules`: each rule alone
"""

import sys
from pathlib import Path

from mavfi.analysis.statistics import Rate
from mavfi.api import load, table
from mavfi.errors import BadInputError
from mavfi.report.text import rate
from tools.markers import DOCS, fill
from tools.results import fly_bench

RULES = {
    "collision flag": 1,
    "collision counter": 1,
    "path epoch": 2,
    "trajectory epochs": 2,
    "path vertices": 3,
    "way-point": 4,
}
"""Rule that protects each site of the part `sites`."""
PAPERS = "gaussian"
SINGLE = tuple(f"rule {number}" for number in range(1, 6))
ALL = "recommended"
DEAD = "the planner's instructions: it dies"


def rules(sites: Path, instructions: Path) -> str:
    """Missions lost to faults at the site of each rule, and recovered by the paper's GAD and by all rules.

    Raises:
        BadInputError: A folder holds no ledger.
    """
    lines = ["| rule | fault in | lost | back, GAD of the paper | back, recommended |", "|---|---|---:|---:|---:|"]
    entries_of_sites = table(load(sites), "schemes_by_target").entries()
    for target, number in RULES.items():
        entries = {entry["arm"]: entry for entry in entries_of_sites if entry["target"] == target}
        lost = entries[PAPERS]["lost"]
        lines.append(
            f"| {number} | {target} | {lost} | {rate(entries[PAPERS]['back'])} | {rate(entries[ALL]['back'])} |"
        )

    # the fifth rule restarts a node that has died
    entries = {entry["arm"]: entry for entry in table(load(instructions), "schemes_instructions").entries()}
    lost = entries[ALL]["died_back"].n
    back = [rate(entries[scheme]["died_back"]) for scheme in (PAPERS, ALL)]
    lines.append(f"| 5 | {DEAD} | {lost} | {' | '.join(back)} |")
    return "\n".join(lines)


def single_rules(sites: Path, instructions: Path) -> str:
    """Missions that come back under each rule alone and under all, by the place of the fault (per cent, interval).

    Raises:
        BadInputError: A folder holds no ledger.
    """
    lines = [
        "| fault in | its rule | lost | rule 1 | rule 2 | rule 3 | rule 4 | rule 5 | all |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    entries_of_sites = table(load(sites), "schemes_by_target").entries()
    for target, number in RULES.items():
        back = {entry["arm"]: entry["back"] for entry in entries_of_sites if entry["target"] == target}
        lines.append(_row(target, number, back))
    entries_of_nodes = table(load(instructions), "schemes_instructions").entries()
    died_back = {entry["arm"]: entry["died_back"] for entry in entries_of_nodes}
    lines.append(_row(DEAD, 5, died_back))
    return "\n".join(lines)


def _row(target: str, number: int, back: dict[str, Rate]) -> str:
    """A row of the table: a target, the rule that protects it, and the share brought back under each arm."""
    cells = [_cell(back[arm], bold=arm == f"rule {number}") for arm in (*SINGLE, ALL)]
    return f"| {target} | {number} | {back[ALL].n} | {' | '.join(cells)} |"


def _cell(share: Rate, *, bold: bool) -> str:
    """A share with its interval, in per cent."""
    if share.rate is None or share.low is None or share.high is None:
        return "—"
    text = f"{100 * share.rate:.0f} [{100 * share.low:.0f}, {100 * share.high:.0f}]"
    if bold:
        return f"**{text}**"
    return text


def main(arguments: list[str]) -> int:
    """Write the table; returns the exit code."""
    if arguments:
        bench = Path(arguments[0])
    else:
        bench = fly_bench("five-rules", Path("out/five-rules-paper"))
    try:
        rows = single_rules(bench / "sites", bench / "instruction")
    except BadInputError as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    fill(DOCS / "concepts" / "engineers.md", {"single-rules": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
