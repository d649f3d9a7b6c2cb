"""Write the share of calls that are served, of those that public programs use, into docs/airsim.md.

python -m tools.airsim_survey

The calls are in airsim_survey.csv: repository, commit, and name of the client's method without `Async`.  Repositories
were taken from a list without looking at their calls: whose Python programs fly a multirotor by the client of AirSim or
Cosys-AirSim.  Copies of AirSim's own programs, comments and programs that drive cars are left out.
"""

import csv
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

from mavfi.bridges.airsim import server  # noqa: F401 - registers all calls
from mavfi.bridges.airsim.refused import REFUSED
from mavfi.bridges.airsim.table import CALLS
from mavfi.reports.text import markdown_grid, percent
from tools.markers import DOCS, fill

DATA = Path(__file__).with_suffix(".csv")
PAGE = DOCS / "airsim.md"
BY_CLIENT: dict[str, tuple[str, ...]] = {
    "confirmConnection": ("ping", "getServerVersion", "getMinRequiredClientVersion"), "getClientVersion": (),
    "getPitchRollYaw": ("getOrientation",),
}  # fmt: skip
"""Methods of the client that are no calls of the server: the calls that they make."""


def is_served(method: str) -> bool:
    """Whether a method of the client works."""
    return all(name in CALLS and name not in REFUSED for name in BY_CLIENT.get(method, (method,)))


def pairs() -> list[tuple[str, str, str]]:
    """Repository, commit and method of each pair."""
    with DATA.open(encoding="utf-8", newline="") as file:
        return [(row["repository"], row["commit"], row["call"]) for row in csv.DictReader(file)]


def summary(found: Iterable[tuple[str, str, str]]) -> str:
    """The sentence and the table."""
    rows = list(found)
    used: dict[tuple[str, str], list[str]] = defaultdict(list)
    for repository, commit, method in rows:
        used[repository, commit].append(method)
    served = sum(is_served(method) for *_, method in rows)
    often = Counter(method for *_, method in rows).most_common(12)
    grid = markdown_grid(
        ("repository", "commit", "calls used", "served", "not served"),
        [
            [
                name, commit[:8], str(len(methods)), str(sum(map(is_served, methods))),
                ", ".join(f"`{method}`" for method in methods if not is_served(method)),
            ]
            for (name, commit), methods in sorted(used.items(), key=lambda item: item[0][0].lower())
        ],
    )  # fmt: skip
    return (
        f"Of {len(rows)} pairs of a repository and a call that its programs use, in {len(used)} public repositories, "
        f"{served} are served ({percent(served / len(rows))}). Used most: "
        + ", ".join(f"`{method}` ({count})" for method, count in often)
        + f".\n\n{grid}"
    )


def main() -> None:
    """Write the section."""
    fill(PAGE, {"survey": summary(pairs())})


if __name__ == "__main__":
    main()
