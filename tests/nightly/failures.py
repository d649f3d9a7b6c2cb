"""System calls that fail at random instants in random processes of a campaign, as on a machine in trouble.

    python -m tests.nightly.failures        (N=200 ONLY=instruction SEED=1)

A call of the command, of a worker or of a forked flight is answered with ENOSPC, EMFILE, ENOMEM, EIO or EAGAIN: once, a
few times, for the rest of that process, or of all processes of that role.  The campaign then ends well, or with exit
code 1 and one line that names the failure.  Nothing of it is in the ledger: every record there is that of a campaign
that nobody disturbed, and the same command, undisturbed, ends with its digest.  Campaigns are forked from this process,
which has compiled kernels in memory.
"""

import errno
import os
import random
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign import run as session_module
from mavfi.campaign.store import FILE, Store
from mavfi.cli import commands
from mavfi.errors import BadInputError
from tests.nightly.chaos import CampaignFolder, say
from tests.nightly.syscalls import Supervised, heap_end, why_not

CAMPAIGNS = {
    "state": {"sampling": {"level": "state"}, "missions": 2, "faults": 3, "null_runs": 1},
    "instruction": {
        "sampling": {"level": "instruction", "kernels": ["pid", "point_cloud"]},
        "missions": 2,
        "faults": 3,
    },
}
ROLES = ("command", "worker", "flight")
_MEMORY, _HANDLES, _DISK = (errno.ENOMEM,), (errno.EMFILE, errno.ENFILE), (errno.ENOSPC, errno.EIO)
ERRORS = {
    "read": (errno.EIO,),
    "write": _DISK,
    "memory": _MEMORY,
    "pipe": _MEMORY,
    "socketpair": _HANDLES,
    "pipe2": _HANDLES,
    "pidfd_open": _HANDLES,
    "clone": (errno.EAGAIN, errno.ENOMEM),
    "clone3": (errno.EAGAIN,),
    "fsync": _DISK,
    "fdatasync": _DISK,
    "ftruncate": _DISK,
    "fallocate": _DISK,
    "rename": _DISK,
    "mkdir": _DISK,
    "unlink": (errno.EIO,),
    "openat": (*_HANDLES, errno.ENOMEM, errno.EIO),
}
"""How each call can fail (the manual pages of section 2); "memory" is more of it, "pipe" a write to one."""
LENGTHS = ("once", "thrice", "process", "role")
_OF_FILES = {"read": "read", "pread64": "read", "write": "write", "pwrite64": "write"}
_STDERR = 2
_COMMON = 10
"""Kinds of calls that come more often than this are drawn alike."""
_CAUSES = (
    *(os.strerror(number) for number in (*_DISK, *_HANDLES, *_MEMORY, errno.EAGAIN)),
    "out of memory",
    "disk I/O error",
    "disk is full",
    "the ledger cannot be read or written",
    "campaign.sqlite: cannot be written",
    "unable to open database file",
    "its worker died",
    "could not send",
    "could not report",
)


@dataclass(frozen=True)
class Point:
    """From its `first` call of a kind on, processes of a role have it fail with an error, for so long."""

    role: str
    call: str
    first: int
    error: int
    length: str

    def __str__(self):
        return f"{self.role} {self.call} {self.first} {errno.errorcode[self.error]} {self.length}"


class Trouble:
    """Decides for each call; counts the calls by role and kind, and how many failed."""

    def __init__(self, point=None):
        self.point, self.calls, self.failed, self._pid = point, Counter(), 0, 0

    def __call__(self, call):
        role, kind = ROLES[max(0, min(call.depth, len(ROLES) - 1))], _kind(call)
        if not kind:
            return 0
        number = self.calls[role, kind]
        self.calls[role, kind] += 1
        point = self.point
        if point is None or (role, kind) != (point.role, point.call) or number < point.first:
            return 0
        self._pid = self._pid or call.pid
        ends = {"once": self.failed >= 1, "thrice": self.failed >= 3, "process": call.pid != self._pid, "role": False}
        if ends[point.length]:
            return 0
        self.failed += 1
        return point.error


def _kind(call):
    """Key of `ERRORS`; "" = it is none that can fail, e.g. what is written to the terminal."""
    if call.name in ("mmap", "mremap") or (call.name == "brk" and call.arguments[0] > heap_end(call.pid)):
        return "memory"
    if call.name not in _OF_FILES:
        return "" if call.name == "brk" else call.name
    target = call.target() if call.arguments[0] > _STDERR else ""
    if call.name == "write" and target.startswith(("pipe:", "socket:")):
        return "pipe"
    return _OF_FILES[call.name] if target.startswith("/") and not target.startswith("/proc/") else ""


@dataclass(frozen=True)
class Reference:
    """A campaign that nobody disturbed: digest, records by run, files, and calls by role and kind."""

    digest: str
    records: dict
    files: list
    calls: Counter


class Campaign(CampaignFolder):
    """A campaign; `command` runs it once, from this process's memory."""

    def __init__(self, level, folder):
        super().__init__(level, folder, **CAMPAIGNS[level])

    def command(self):
        """What the command line does, in this process; gives its exit code."""
        return commands.run(self.words)

    def supervised(self, trouble, prepare=lambda: None):
        """The same in a child whose calls are watched; exit code, whether a process was left, and what it wrote."""

        def work():
            with self.log.open("w", encoding="utf-8") as log:
                os.dup2(log.fileno(), 1)
                os.dup2(log.fileno(), _STDERR)
            sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(_STDERR, "w", closefd=False)
            os.environ["TMPDIR"] = tempfile.tempdir = str(self.scratch)
            session_module.PAUSE_S = 0.01
            prepare()
            try:
                return self.command()
            except BaseException:
                sys.excepthook(*sys.exc_info())
                return 1
            finally:
                sys.stdout.flush()
                sys.stderr.flush()

        code, left = Supervised(work).serve(trouble)
        return code, left, self.log.read_text(encoding="utf-8") if self.log.exists() else ""

    def records(self):
        """Of the runs that are done, by id; of none if there is no ledger yet."""
        try:
            with Store.open(self.ledger) as store:
                return {run.spec.run_id: run.record for run in store.runs(done=True)}
        except BadInputError as error:
            path = self.ledger / FILE
            if path.exists() and path.stat().st_size and "cut short" not in str(error):
                raise
            return {}


def undisturbed(level, folder):
    """The campaign twice, as no failure happens: here, which warms this process up, and watched."""
    Campaign(level, folder / "warm").command()
    campaign, trouble = Campaign(level, folder / "watched"), Trouble()
    code, left, text = campaign.supervised(trouble)
    assert (code, left) == (0, False), text
    return Reference(campaign.digest(), campaign.records(), campaign.files(), trouble.calls)


def draw_point(reference, draw):
    """A point: role, kind of call (rare ones rarely), place among such calls, error and length, each at random."""
    role = draw.choice([role for role in ROLES if any(key[0] == role for key in reference.calls)])
    counts = {name: count for (role_of_call, name), count in sorted(reference.calls.items()) if role_of_call == role}
    (call,) = draw.choices(list(counts), [min(count, _COMMON) for count in counts.values()])
    first = draw.randrange(reference.calls[role, call])
    return Point(role, call, first, draw.choice(ERRORS[call]), draw.choice(LENGTHS))


def disturbed(level, folder, reference, point, prepare=lambda: None):
    """Let calls fail, then run the campaign again; gives how it ended, and what went wrong, a line each."""
    campaign, trouble = Campaign(level, folder), Trouble(point)
    code, left, text = campaign.supervised(trouble, prepare)
    wrong = []
    if left:
        wrong.append("a process is left, or it hangs")
    wrong += _words(code, text)
    wrong += _strangers(campaign, reference)
    code_again, left, text = campaign.supervised(Trouble())
    if (code_again, left) != (0, False):
        wrong.append(f"again: exit code {code_again}: {text[-600:]}")
    elif campaign.digest() != reference.digest:
        wrong.append(f"again: digest {campaign.digest()} instead of {reference.digest}")
    elif campaign.files() != reference.files:
        wrong.append(f"files are left: {sorted(set(campaign.files()) ^ set(reference.files))}")
    return code, trouble.failed, wrong


def _words(code, text):
    """What is wrong with exit code and text."""
    if "Traceback" in text:
        return [f"a traceback: {text[text.index('Traceback') :][-1500:]}"]
    if code == 0:
        return []
    errors = [line for line in text.splitlines() if line.startswith("mavfi: ")]
    if code != 1 or len(errors) != 1 or not any(cause in errors[0] for cause in _CAUSES):
        return [f"exit code {code}: {text[-600:]}"]
    return []


def _strangers(campaign, reference):
    """Records in the ledger that are not the reference's."""
    try:
        stored = campaign.records()
    except BadInputError as error:
        return [f"the ledger cannot be read: {error}"]
    return [f"stored: {name}: {record}" for name, record in stored.items() if reference.records.get(name) != record]


def main():
    """Disturb N campaigns."""
    reason = why_not()
    if reason:
        raise SystemExit(reason)
    points, seed = int(os.environ.get("N", "200")), int(os.environ.get("SEED", "1"))
    levels = [level for level in CAMPAIGNS if os.environ.get("ONLY", "") in ("", level)]
    draw, ends, wrong = random.Random(seed), Counter(), 0
    with tempfile.TemporaryDirectory(prefix="mavfi-failures-") as folder:
        references = {level: undisturbed(level, Path(folder) / f"golden-{level}") for level in levels}
        for level, reference in references.items():
            say(f"{level}: {dict(sorted(reference.calls.items()))}")
        for number in range(points):
            level = levels[number % len(levels)]
            point = draw_point(references[level], draw)
            code, failed, problems = disturbed(level, Path(folder) / str(number), references[level], point)
            ends[point.role, "ended well" if code == 0 else "stopped"] += 1
            wrong += bool(problems)
            say(f"{number + 1} of {points} {level} {point}: exit code {code}, {failed} failed {' '.join(problems)}")
    for (role, end), count in sorted(ends.items()):
        say(f"{role:8} {end:10} {count}")
    say(f"{points - wrong} of {points} right")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
