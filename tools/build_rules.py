"""Fly the bench `five-rules`, and write the benefit of each rule alone in docs/engineers.md.

make results NAME=five-rules
"""

import sys
from pathlib import Path

from mavfi.analysis.statistics import Rate
from mavfi.api import load, table
from mavfi.errors import BadInputError
from tools.build_leaderboard import RULES, fly
from tools.markers import DOCS, fill

SINGLE = tuple(f"rule {number}" for number in range(1, 6))
ALL = "recommended"
DEAD = "the planner's instructions: it dies"


def single_rules(sites: Path, instructions: Path) -> str:
    """Missions that come back under each rule alone and under all, by the place of the fault (per cent, interval).

    Raises:
        BadInputError: A folder holds no ledger.
    """
    lines = [
        "| fault in | its rule | lost | rule 1 | rule 2 | rule 3 | rule 4 | rule 5 | all |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    every = table(load(sites), "schemes_by_target").entries()
    for target, number in RULES.items():
        own = {entry["arm"]: entry["back"] for entry in every if entry["target"] == target}
        lines.append(_row(target, number, own))
    died = {entry["arm"]: entry["died_back"] for entry in table(load(instructions), "schemes_instructions").entries()}
    return "\n".join([*lines, _row(DEAD, 5, died)])


def _row(place: str, number: int, back: dict[str, Rate]) -> str:
    cells = [_cell(back[arm], bold=arm == f"rule {number}") for arm in (*SINGLE, ALL)]
    return f"| {place} | {number} | {back[ALL].n} | {' | '.join(cells)} |"


def _cell(found: Rate, *, bold: bool) -> str:
    if found.rate is None or found.low is None or found.high is None:
        return "—"
    text = f"{100 * found.rate:.0f} [{100 * found.low:.0f}, {100 * found.high:.0f}]"
    return f"**{text}**" if bold else text


def main(arguments: list[str]) -> int:
    """Write the table; returns the exit code."""
    bench = Path(arguments[0]) if arguments else fly("paper", "five-rules")
    try:
        written = single_rules(bench / "sites", bench / "instruction")
    except BadInputError as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    fill(DOCS / "engineers.md", {"single-rules": written})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
