"""Signals to random processes of a campaign at random instants; it is resumed until it is done, and must be the same.

    python -m tests.nightly.chaos        (N=500 ONLY="state instruction dask ros" SEED=1)

Targets are the command, its workers (also those of Dask) and the flights that they started; signals are KILL, TERM,
HUP, and STOP, after which the process continues (CONT).  In the end the ledger has the digest of a campaign that nobody
disturbed, no process of the command lives 5 s after it, and no file is left except the ledger's.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import yaml

from mavfi.campaign.store import Store

SHORT = {"start": [2.0, 0.0, 3.0], "goal": [9.0, 0.0, 3.0]}
CAMPAIGNS = {
    "state": {"sampling": {"level": "state"}, "missions": 4, "faults": 6, "null_runs": 1},
    "instruction": {
        "sampling": {"level": "instruction", "kernels": ["pid", "point_cloud", "rrt_connect"]},
        "missions": 4,
        "faults": 4,
    },
    "dask": {"sampling": {"level": "state"}, "missions": 4, "faults": 6, "null_runs": 1},
    "ros": {"host": "ros2", "sampling": {"level": "state"}, "missions": 1, "faults": 1, "null_runs": 0},
}
OPTIONS = {"dask": ["--executor", "dask"]}
ROLES = ("command", "worker", "flight")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGSTOP)
PATIENCE_S = 5.0
KILLS_PER_CAMPAIGN = 5
_LONGEST_S = 600.0


class CampaignFolder:
    """A folder with a campaign's file, its ledger, its log, and what is temporary."""

    def __init__(self, level, folder, **content):
        self.level, self.folder, self.ledger, self.scratch = level, folder, folder / "ledger", folder / "tmp"
        self.log = folder / "log"
        self.scratch.mkdir(parents=True, exist_ok=True)
        content = {"name": level, "environments": ["sparse"], "first_seed": 7, "mission": SHORT, **content}
        (folder / "campaign.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
        self.words = ["campaign", "run", str(folder / "campaign.yaml"), "--out", str(self.ledger), "--workers", "2"]

    def files(self):
        """Names of the files that are left, without the log."""
        return sorted(path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*") if path != self.log)

    def digest(self):
        """Of the ledger; None = it is not complete."""
        with Store.open(self.ledger) as store:
            return store.digest() if store.complete else None


class Campaign(CampaignFolder):
    """A campaign as a command; `seen` are all processes that it has started."""

    def __init__(self, level, folder):
        super().__init__(level, folder, **CAMPAIGNS[level])
        self.seen = {}
        self.process = None

    def begin(self):
        """Start or resume it."""
        command = [sys.executable, "-m", "mavfi", *self.words, *OPTIONS.get(self.level, [])]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env={**os.environ, "TMPDIR": str(self.scratch)},
            )

    def look(self):
        """Living processes by role; the command's children are workers, theirs are flights."""
        workers = children(self.process.pid)
        pids = {"command": [self.process.pid], "worker": workers, "flight": sum(map(children, workers), [])}
        for pid in [self.process.pid, *descendants(self.process.pid)]:
            self.seen[pid] = begun(pid)
        return pids

    def wait(self, seconds):
        """Whether it ended within a time; looks at its processes meanwhile."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if self.process.poll() is not None:
                return True
            self.look()
            time.sleep(0.02)
        return self.process.poll() is not None

    def orphans(self):
        """Processes that live on, `PATIENCE_S` after the command's end; longer if others use the processors.

        A Dask worker notices its parent's death when it has imported its packages.
        """
        deadline = time.monotonic() + PATIENCE_S * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
        while time.monotonic() < deadline and any(lives(pid, start) for pid, start in self.seen.items()):
            time.sleep(0.05)
        left = [f"{pid} ({words_of(pid)})" for pid, start in self.seen.items() if lives(pid, start)]
        self.seen = {}
        return left


def _stat(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return None


def words_of(pid):
    """Its command line and state, shortened."""
    try:
        command_line = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return "gone"
    return f"{command_line[:160]}, state {(_stat(pid) or ['gone'])[0]}"


def begun(pid):
    """Instant at which a process began (ticks); None = there is none."""
    stat = _stat(pid)
    return None if stat is None else int(stat[19])


def lives(pid, start):
    """Whether it is that process still, and no zombie."""
    stat = _stat(pid)
    return stat is not None and stat[0] != "Z" and int(stat[19]) == start


def children(pid):
    """Processes that a process has started; of threads too."""
    pids = []
    with suppress(OSError):  # it has ended
        for path in Path(f"/proc/{pid}/task").glob("*/children"):
            pids += [int(word) for word in path.read_text(encoding="ascii").split()]
    return pids


def descendants(pid):
    """Processes that a process has started, and theirs."""
    return [one for child in children(pid) for one in (child, *descendants(child))]


def strike(campaign, draw):
    """One signal; gives what was hit, with what, and whether somebody was there."""
    role, number = draw.choice(ROLES), draw.choice(SIGNALS)
    for _ in range(100):  # flights are short
        candidates = campaign.look()[role]
        if candidates or campaign.process.poll() is not None:
            break
        time.sleep(0.02)
    if not candidates:
        return role, number.name, False
    try:
        target = draw.choice(candidates)
        os.kill(target, number)
        if number == signal.SIGSTOP:
            time.sleep(draw.uniform(0.05, 1.5))
            os.kill(target, signal.SIGCONT)
    except ProcessLookupError:
        return role, number.name, False
    return role, number.name, True


def undisturbed(level, folder):
    """Digest, files and duration (s) of the campaign if nobody disturbs it."""
    campaign = Campaign(level, folder)
    start = time.monotonic()
    campaign.begin()
    assert campaign.wait(_LONGEST_S), "the campaign does not end"
    assert campaign.process.returncode == 0, campaign.log.read_text(encoding="utf-8")
    return campaign.digest(), campaign.files(), time.monotonic() - start


def disturbed(level, folder, reference, kills, draw, tell=lambda hit: None):
    """Strike a campaign up to so often, resume it until it is done; gives what went wrong, a line each."""
    campaign, wrong = Campaign(level, folder), []
    campaign.begin()
    sent = []
    for _ in range(kills):
        ended = campaign.wait(draw.uniform(0.0, 0.5 * reference[2]))
        if not ended:
            role, name, hit = strike(campaign, draw)
            if hit:
                tell((role, name))
                sent.append(f"{role} {name}")
            deadly = hit and role == "command" and name != "SIGSTOP"
            ended = campaign.wait(60.0 if deadly else 0.0)
            if deadly and not ended:
                return [*wrong, f"{role} {name}: it lives on"]
        if ended and gone_on(campaign, wrong, sent):
            break
    for _ in range(5):
        if not campaign.wait(_LONGEST_S):
            return [*wrong, "it does not end"]
        if gone_on(campaign, wrong, sent):
            break
    return wrong + differences(campaign, reference)


def gone_on(campaign, wrong, sent):
    """After its end: note what it left running, and resume it; True if it was done."""
    code = campaign.process.returncode
    wrong += [f"process {left} is left, exit code {code}, after {', '.join(sent)}" for left in campaign.orphans()]
    if code == 0:
        return True
    campaign.begin()
    return False


def differences(campaign, reference):
    """What differs from the campaign that nobody disturbed, a line each."""
    digest, files, _ = reference
    log = campaign.log.read_text(encoding="utf-8", errors="replace")
    lines = []
    if campaign.process.returncode != 0:
        return [f"exit code {campaign.process.returncode}: {log[-300:]}"]
    if campaign.digest() != digest:
        lines.append(f"the ledger differs: {campaign.digest()} instead of {digest}")
    if campaign.files() != files:
        lines.append(f"files are left: {sorted(set(campaign.files()) - set(files))}")
    lines += [f"a traceback: {text}" for text in tracebacks(log)[:1]]
    return lines


def tracebacks(log):
    """Beginnings of the tracebacks in a log, without those of Python's tracker of semaphores after its own death."""
    traces = [part[:600] for part in log.split("Traceback")[1:]]
    return [part for part in traces if "multiprocessing/resource_tracker.py" not in part]


def say(text):
    """One line, at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main():
    """Disturb until there were N kills."""
    kills, seed = int(os.environ.get("N", "500")), int(os.environ.get("SEED", "1"))
    levels = os.environ.get("ONLY", "state instruction dask").split()
    draw, hits, wrong = random.Random(seed), Counter(), []
    with tempfile.TemporaryDirectory(prefix="mavfi-chaos-") as folder:
        for level in levels:  # compiles: signals spread over a campaign that long would mostly come too late
            undisturbed(level, Path(folder) / f"first-{level}")
        references = {level: undisturbed(level, Path(folder) / f"golden-{level}") for level in levels}
        number = 0
        while hits.total() < kills:
            level = levels[number % len(levels)]
            folder_of_run = Path(folder) / str(number)
            problems = disturbed(
                level,
                folder_of_run,
                references[level],
                min(KILLS_PER_CAMPAIGN, kills - hits.total()),
                draw,
                lambda hit: hits.update([hit]),
            )
            for line in problems:
                wrong.append(f"{level} {number}: {line}")
                say(wrong[-1])
            number += 1
            say(f"{hits.total()} of {kills} kills, {number} campaigns, {len(wrong)} wrong")
    for (role, name), count in sorted(hits.items()):
        say(f"{role:8} {name:8} {count}")
    say("\n".join(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
