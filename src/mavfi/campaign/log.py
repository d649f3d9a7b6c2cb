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
from mavfi.campaign.plan import CompletedRun, reason_of
from mavfi.campaign.store import LOG as FILE
from mavfi.errors import MavfiError

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
        self._line_is_complete = False  # the last one
        self._begin_s: dict[str, float] = {}  # missions that have begun and not ended
        self._runs: Counter[str] = Counter()  # of these

    def note(self, event: str, **fields: Any) -> None:
        """Append a line; a line truncated by a full disk remains separate."""
        data: dict[str, Any] = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": event}
        for key, value in fields.items():
            if isinstance(value, str):
                value = value[:_LONGEST_TEXT]
            data[key] = value
        line = json.dumps(data).encode() + b"\n"
        may_be_truncated = not self._line_is_complete  # also by an earlier session
        self._line_is_complete = False
        with suppress(OSError), self._path.open("a+b", buffering=0) as file:
            if may_be_truncated and file.tell():
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    line = b"\n" + line
            self._line_is_complete = file.write(line) == len(line)

    def forget(self) -> None:
        """Forget missions that have begun and not ended: a machine failure has stopped their workers."""
        self._begin_s.clear()
        self._runs.clear()

    def follow(self, mission: MissionPlan, items: Sequence[object], last: Done | Lost | None) -> None:
        """Log the events of a mission and its worker in new items."""
        name = f"{mission.environment}-{mission.seed}"
        if name not in self._begin_s:
            self._begin_s[name] = time.perf_counter()
            self.note("mission_begin", mission=name, runs_done=len(mission.done), alone=mission.alone)
        flown = [item for item in items if isinstance(item, CompletedRun)]
        self._runs[name] += len(flown)
        for item in flown:
            self.flown(item)
        if last is not None:
            seconds = time.perf_counter() - self._begin_s.pop(name)
            fields = {"mission": name, "runs": self._runs.pop(name), "seconds": round(seconds, 1)}
            if isinstance(last, Lost):
                self.note("worker_lost", **fields, reason=last.reason)
            else:
                self.note("mission_end", **fields, worker_peak_mib=round(last.peak_kib / 1024, 1))

    def flown(self, item: CompletedRun) -> None:
        """Log a run with status unknown."""
        if not item.unknown:
            return
        self._unknown += 1
        if self._unknown <= MOST_UNKNOWN:
            self.note("unknown", run=item.run_id, error=item.record.error, reason=reason_of(item.note))

    def end(self, error: BaseException | None, **fields: Any) -> None:
        """Log the reason for the end of a session; None = its campaign is complete."""
        why = "complete"
        reason = ""
        if error is not None:
            why = "failed" if isinstance(error, Exception) else "stopped"
            reason = str(error) if isinstance(error, MavfiError) else repr(error)
        self.note("end", why=why, reason=reason, unknown=self._unknown, **fields)
