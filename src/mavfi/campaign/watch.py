"""Monitoring of a running campaign from another process, through its ledger, log and lock."""

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavfi.campaign.log import entries
from mavfi.campaign.mission import plan_of
from mavfi.campaign.outside import is_written
from mavfi.campaign.pace import left_s
from mavfi.campaign.plan import golden_done
from mavfi.campaign.run import shard_of, status_of, stored_campaign
from mavfi.campaign.session import Status
from mavfi.campaign.store import Store

WINDOW_S = 300.0
"""Averaging window of rates (s)."""
_SETTLED_S = 10.0  # shortest observation for a rate (s)
_TROUBLE = ("worker_lost", "retry", "gave_up", "unknown")
_MOST_ERRORS = 5


@dataclass(frozen=True, slots=True)
class Outlook(Status):
    """Progress of a campaign with its speed, remaining time, missions in progress and errors."""

    flying: bool = False  # a process writes the ledger
    rate: float = 0.0  # runs per second over `WINDOW_S`; 0 = unknown yet
    remaining_s: float = math.inf  # remaining wall time (s); infinite = unknown yet
    workers: int | None = None  # processes of the session; None = unknown
    in_the_air: tuple[str, ...] = ()  # missions in progress
    errors: tuple[str, ...] = ()  # latest log entries about errors


class Watch:
    """Monitor of a campaign, for repeated queries.

    Args:
        directory: Folder of the ledger.

    Raises:
        BadInputError: The ledger is absent or damaged.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._seen: deque[tuple[float, int]] = deque()
        with Store.open(directory) as store:
            self._golden = plan_of(stored_campaign(store), {}, {}).golden_count(shard_of(store))

    def look(self) -> Outlook:
        """Query the current progress."""
        with Store.open(self._directory, check=False) as store:
            status, walls = status_of(store), store.wall_times()
        log, flying = entries(self._directory), is_written(self._directory)
        session = session_of(log)
        begun = next((entry for entry in session if entry["event"] == "begin"), {})
        in_the_air = flying_missions(session) if flying else ()
        rate = self._rate(time.monotonic(), status.done)
        runs, wall_s = (sum(part) for part in zip(*walls.values(), strict=True)) if walls else (0, 0.0)
        if not rate and wall_s > 0:
            rate = len(in_the_air) * runs / wall_s
        left = {True: self._golden - golden_done(status.settings)}
        left[False] = status.total - status.done - left[True]
        missions = sum(entry["event"] == "mission_end" for entry in log)
        return Outlook(
            status.done, status.total, status.settings, status.unknown, status.shard, flying, rate if flying else 0.0,
            left_s(left, walls, missions, len(in_the_air)), begun.get("workers"), in_the_air, errors_of(log),
        )  # fmt: skip

    def _rate(self, now: float, done: int) -> float:
        """Runs per second over at most `WINDOW_S` (1/s); 0 = observed for too short a time."""
        self._seen.append((now, done))
        while len(self._seen) > 2 and now - self._seen[0][0] > WINDOW_S:
            self._seen.popleft()
        then, before = self._seen[0]
        return (done - before) / (now - then) if now - then >= _SETTLED_S else 0.0


def session_of(log: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The entries of the last session."""
    last = max((place for place, entry in enumerate(log) if entry["event"] == "begin"), default=0)
    return log[last:]


def flying_missions(session: list[dict[str, Any]]) -> tuple[str, ...]:
    """Missions that were started and have not ended."""
    flying: dict[str, None] = {}
    for entry in session:
        match entry["event"]:
            case "mission_begin":
                flying[str(entry.get("mission"))] = None
            case "mission_end" | "worker_lost":
                flying.pop(str(entry.get("mission")), None)
            case "retry":
                flying.clear()
    return tuple(flying)


def errors_of(log: list[dict[str, Any]]) -> tuple[str, ...]:
    """The latest entries about errors, one line each."""
    found = [entry for entry in log if entry["event"] in _TROUBLE or entry.get("why") == "failed"]
    return tuple(_line(entry) for entry in found[-_MOST_ERRORS:])


def _line(entry: Mapping[str, Any]) -> str:
    what = entry.get("mission") or entry.get("run") or ""
    text = f"{entry['time']} {entry['event'].replace('_', ' ')} {what}: {entry.get('reason', '')}"
    return " ".join(text.split()).replace(" :", ":")
