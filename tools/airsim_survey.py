"""Write the share of calls that are served, of those that public programs use, into docs/airsim.md.

python -m tools.airsim_survey

The calls are in airsim_survey.csv: repository, commit, name of the client's method without `Async`, and whether the
repository was read before or after calls that the first ones lacked were added.  Repositories were taken from a list
without looking at their calls: whose Python programs fly a multirotor by the client of AirSim or Cosys-AirSim.  Copies
of AirSim's own programs, comments and programs that drive cars are left out.
"""

import csv
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mavfi.extras.airsim.scene import REFUSED
from mavfi.extras.airsim.table import CALLS
from mavfi.report.text import markdown_grid, percent
from tools.markers import DOCS, fill

DATA = Path(__file__).with_suffix(".csv")
PAGE = DOCS / "airsim.md"
BY_CLIENT: dict[str, tuple[str, ...]] = {
    "confirmConnection": ("ping", "getServerVersion", "getMinRequiredClientVersion"),
    "getClientVersion": (),
    "getPitchRollYaw": ("getOrientation",),
}
"""Methods of the client that are no calls of the server: the calls that they make."""


def is_served(method: str) -> bool:
    """Whether a method of the client works."""
    return all(name in CALLS and name not in REFUSED for name in BY_CLIENT.get(method, (method,)))


class Pair(NamedTuple):
    """A call that a repository uses; `read` is "before" or "after"."""

    repository: str
    commit: str
    call: str
    read: str


def pairs() -> list[Pair]:
    """All pairs of a repository and a call."""
    with DATA.open(encoding="utf-8", newline="") as file:
        return [Pair(**row) for row in csv.DictReader(file)]


def share(found: Sequence[Pair]) -> str:
    """How many pairs are served."""
    served = sum(is_served(pair.call) for pair in found)
    return f"{served} of {len(found)} ({percent(served / len(found))})"


def summary(found: Sequence[Pair]) -> str:
    """The sentences and the table."""
    by_repository: dict[tuple[str, str, str], list[str]] = defaultdict(list)
    for pair in found:
        by_repository[pair.read, pair.repository, pair.commit].append(pair.call)
    first, fresh = ([pair for pair in found if pair.read == read] for read in ("before", "after"))
    rows = [
        [
            name,
            commit[:8],
            read,
            str(len(calls)),
            str(sum(map(is_served, calls))),
            ", ".join(f"`{call}`" for call in calls if not is_served(call)),
        ]
        for (read, name, commit), calls in by_repository.items()
    ]
    count, fresh_count = (len({pair.repository for pair in own}) for own in (first, fresh))
    often = Counter(pair.call for pair in found).most_common(12)
    return (
        f"Pairs of a repository and a call that its programs use: {share(first)} are served in {count} public "
        f"repositories, after calls that they use had been added. In {fresh_count} others, read afterwards, "
        f"{share(fresh)} are. Used most: {', '.join(f'`{call}` ({times})' for call, times in often)}.\n\n"
        + markdown_grid(("repository", "commit", "read", "calls used", "served", "not served"), rows)
    )


def main() -> None:
    """Write the section."""
    fill(PAGE, {"survey": summary(pairs())})


if __name__ == "__main__":
    main()
