"""Event log of a campaign as JSON lines next to its ledger: for operators, not part of the evidence.

Each line is an object with `time` (UTC), `event` and the event's fields: `begin` and `end` of a session,
`mission_begin` and `mission_end`, `worker_lost`, `retry` after a machine failure, `gave_up`, `unknown`.  The number of
lines grows with the missions, not the runs.  Write errors are ignored: a campaign never fails because of its log.
"""

import json
import os
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mavfi.campaign.executors.executor import Done, Lost
from mavfi.campaign.mission import MissionPlan
from mavfi.campaign.plan import Flown, reason_of
from mavfi.errors import MavfiError

FILE = "log.jsonl"
MOST_UNKNOWN = 100
"""Runs with status unknown logged individually per session; the others are only counted at its end."""
_LONGEST_TEXT = 500


class Log:
    """The log of a session.

    Args:
        directory: Folder of the ledger.
    """

    def __init__(self, directory: Path) -> None:
        self._path = directory / FILE
        self._unknown = 0
        self._whole = False  # whether the last line was written completely
        self._begun: dict[str, float] = {}  # missions in the air, and when they began (s)
        self._runs: Counter[str] = Counter()  # of these

    def note(self, event: str, **fields: Any) -> None:
        """Append a line; a line truncated by a full disk remains separate."""
        texts = {key: value[:_LONGEST_TEXT] if isinstance(value, str) else value for key, value in fields.items()}
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"time": now, "event": event, **texts}).encode() + b"\n"
        whole = self._whole
        self._whole = False
        with suppress(OSError), self._path.open("a+b", buffering=0) as file:
            if not whole and file.tell():
                file.seek(-1, os.SEEK_END)
                line = line if file.read(1) == b"\n" else b"\n" + line
            self._whole = file.write(line) == len(line)

    def forget(self) -> None:
        """Forget missions that have begun and not ended: a machine failure has stopped their workers."""
        self._begun.clear()
        self._runs.clear()

    def follow(self, mission: MissionPlan, items: Sequence[object], last: Done | Lost | None) -> None:
        """Log the events of a mission and its worker in new items."""
        name = f"{mission.environment}-{mission.seed}"
        if name not in self._begun:
            self._begun[name] = time.perf_counter()
            self.note("mission_begin", mission=name, runs_done=len(mission.done), alone=mission.alone)
        flown = [item for item in items if isinstance(item, Flown)]
        self._runs[name] += len(flown)
        for item in flown:
            self.flown(item)
        if last is not None:
            seconds = time.perf_counter() - self._begun.pop(name)
            fields = {"mission": name, "runs": self._runs.pop(name), "seconds": round(seconds, 1)}
            if isinstance(last, Lost):
                self.note("worker_lost", **fields, reason=last.reason)
            else:
                self.note("mission_end", **fields, worker_peak_mib=round(last.peak_kib / 1024, 1))

    def flown(self, item: Flown) -> None:
        """Log a run with status unknown."""
        if not item.unknown:
            return
        self._unknown += 1
        if self._unknown <= MOST_UNKNOWN:
            self.note("unknown", run=item.run_id, error=item.record.error, reason=reason_of(item.note))

    def end(self, error: BaseException | None, **fields: Any) -> None:
        """Log the reason for the end of a session; None = its campaign is complete."""
        if error is None:
            why = "complete"
        elif isinstance(error, Exception):
            why = "failed"
        else:
            why = "stopped"
        if error is None:
            reason = ""
        elif isinstance(error, MavfiError):
            reason = str(error)
        else:
            reason = repr(error)
        self.note("end", why=why, reason=reason, unknown=self._unknown, **fields)
