"""Ledgers of a folder, read again when they have changed, and what they answer first."""

import fcntl
import os
import sqlite3
import struct
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.findings import compared_missions, pairs_by_arm
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.campaign.ledger import Status, status_of
from mavfi.campaign.store import FILE, LOCK, Store, connect
from mavfi.errors import BadInputError
from mavfi.files import is_file
from mavfi.report.campaign_report import CampaignReport, report_of
from mavfi.report.html.report_page import ReportedCampaign, page_values, sections_of
from mavfi.report.progress import duration, speed

MAX_DEPTH = 4
"""Deepest folder in which ledgers are searched."""
_READ_SHARE = 0.2
"""Largest share of wall time spent on reading the ledger of a running campaign."""
_RATE_WINDOW_S = 60.0
_RATE_FROM_S = 5.0
"""The rate of a running campaign is that of the last minute, and shown after some seconds of it (s)."""

Stamp = tuple[int, ...]
"""Time of the last change (ns) and size (bytes) of a ledger's file and of its log; () = there is none."""


def find_ledgers(folder: Path) -> dict[str, Path]:
    """Folders of ledgers by their path relative to a folder ("" = the folder itself), in order of names."""
    ledgers = {}
    for name, subfolders, files in os.walk(folder):
        directory = Path(name)
        relative = directory.relative_to(folder)
        subfolders[:] = sorted(subfolder for subfolder in subfolders if not subfolder.startswith("."))
        if len(relative.parts) == MAX_DEPTH:
            subfolders.clear()
        if FILE in files:
            ledgers["/".join(relative.parts)] = directory
    return dict(sorted(ledgers.items()))


class Recovered(NamedTuple):
    """Share of the missions lost without a detector that succeed with it, and the number that it newly loses."""

    arm: str
    rate: Rate
    newly_lost: int


@dataclass(frozen=True, slots=True)
class CampaignAnswer:
    """What a campaign answers first.

    Attributes:
        without_fault: Missions that succeed without a fault.
        with_fault: Missions that succeed with a fault.
        fault: What a mission with a fault has, in words.
        recovered: By detector, the best first.
        findings: Sentences; the first one stands for rates where there are none.
    """

    without_fault: Rate
    with_fault: Rate
    fault: str
    recovered: Sequence[Recovered]
    findings: Sequence[str]

    @staticmethod
    def of(report: CampaignReport) -> "CampaignAnswer":
        """The answer of a campaign."""
        golden, faulty = compared_missions(report.runs)
        recovered = []
        for arm, pairs in pairs_by_arm(report.runs).items():
            lost = pairs.where("golden_success", ~pl.col("fi_success"))
            recovered.append(Recovered(arm, m.rate_of(lost, "dr_success"), m.discordant(pairs).first_only))
        recovered.sort(key=lambda entry: entry.newly_lost - (entry.rate.successes or 0))
        fault = f"With {report.runs.per_mission}"
        bits = m.population_text(faulty.values("population"))
        if bits:
            fault += f" ({bits} bits)"
        return CampaignAnswer(
            m.rate_of(golden, "success"), m.rate_of(faulty, "success"), fault, recovered, report.findings
        )


@dataclass(frozen=True, slots=True)
class ReadLedger:
    """A ledger as it was at one time.

    Attributes:
        stamp: Of its file.
        report: Tables and findings.
        values: Values of the template of the report's page.
        answer: What it answers first.
    """

    stamp: Stamp
    report: CampaignReport
    values: dict[str, Any]
    answer: CampaignAnswer


class CampaignPace(NamedTuple):
    """Progress of a campaign, and whether a process is flying it now.

    Attributes:
        status: Runs done and in all.
        running: Whether it is flown now.
        text: Progress with rate and time left, as text.
    """

    status: Status
    running: bool
    text: str


_reading = threading.Lock()
"""Ledgers are read, and figures drawn, one after the other: matplotlib is not safe in threads."""


class ServedLedger:
    """One ledger.

    Args:
        directory: Its folder.
        key: Its name on pages: its path relative to the served folder.

    Attributes:
        last_read: Result of the last call of `read`, which takes seconds for thousands of runs; None = not called yet.
    """

    def __init__(self, directory: Path, key: str = "") -> None:
        self.directory = directory
        self.key = key
        self.last_read: ReadLedger | None = None
        self._read_until = 0.0
        self._read_duration_s = 0.0
        self._status: tuple[Stamp, Status] | None = None
        self._done: deque[tuple[float, int]] = deque()

    def read(self) -> ReadLedger:
        """Tables, figures and runs, read again if the file has changed.

        A campaign that is running changes all the time, so reading takes at most `_READ_SHARE` of it.

        Raises:
            BadInputError: The ledger is absent or damaged.
        """
        with _reading:
            stamp = self.stamp()
            if self.last_read is not None and stamp == self.last_read.stamp:
                return self.last_read
            begin = time.monotonic()
            report = report_of(Runs.read(self.directory))
            commands = [("Write this page to a file", f"mavfi report {self.directory} --html report.html")]
            values = page_values([ReportedCampaign(self.directory, report)], sections_of(report), commands)
            self.last_read = ReadLedger(stamp, report, values, CampaignAnswer.of(report))
            self._read_until = time.monotonic()
            self._read_duration_s = self._read_until - begin
            return self.last_read

    def stamp(self) -> Stamp:
        """Stamp of what `read` gives: that of the file, or of the last reading if the next one is not due yet."""
        if self.last_read is not None:
            rest_s = self._read_duration_s * (1 - _READ_SHARE) / _READ_SHARE
            if time.monotonic() < self._read_until + rest_s:
                return self.last_read.stamp
        return _stamp_of(self.directory)

    def pace(self) -> CampaignPace:
        """Progress; raises a BadInputError if the ledger is absent or not readable yet."""
        status = self._counted()
        running = _is_written(self.directory / LOCK)
        now = time.monotonic()
        self._done.append((now, status.done))
        while self._done[0][0] < now - _RATE_WINDOW_S:
            self._done.popleft()
        text = f"{status.done} of {status.total} runs"
        if status.complete:
            text = f"{status.done} runs"
        if running:
            text += self._rate_text(status)
        elif not status.complete:
            text += "; stopped, `mavfi campaign run` flies the rest"
        return CampaignPace(status, running, text)

    def _counted(self) -> Status:
        """Counts of runs; checksums are left to `read`."""
        stamp = _stamp_of(self.directory)
        if self._status is None or self._status[0] != stamp:
            self._status = stamp, self._count()
        return self._status[1]

    def _count(self) -> Status:
        if not is_file(self.directory / FILE):
            raise BadInputError(f"{self.directory}: holds no campaign (no {FILE})")
        try:
            with closing(Store(self.directory, connect(self.directory / FILE, "ro"))) as store:
                return status_of(store)
        except sqlite3.DatabaseError as error:
            Store.open(self.directory).close()  # says what is damaged
            raise BadInputError(f"{self.directory / FILE}: cannot be read now ({error})") from None

    def _rate_text(self, status: Status) -> str:
        """Rate of a running campaign and the time left, to be appended to its progress."""
        since, done_before = self._done[0]
        seconds = time.monotonic() - since
        done_since = status.done - done_before
        if not done_since or seconds < _RATE_FROM_S:
            return ", running"
        rate = done_since / seconds
        return f", {speed(rate, 'runs')}, {duration((status.total - status.done) / rate)} left"


def _stamp_of(directory: Path) -> Stamp:
    stamp: list[int] = []
    for name in (FILE, f"{FILE}-wal"):
        try:
            entry = (directory / name).stat()
        except OSError:
            continue
        stamp += [entry.st_mtime_ns, entry.st_size]
    return tuple(stamp)


def _is_written(lock: Path) -> bool:
    """Whether a process writes the ledger, asked without taking its lock."""
    question = struct.pack("hhqqi", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)  # struct flock of fcntl(2)
    try:
        with lock.open("rb") as file:
            answer = fcntl.fcntl(file, fcntl.F_GETLK, question)
    except OSError:
        return False
    return bool(struct.unpack("hhqqi", answer)[0] != fcntl.F_UNLCK)
