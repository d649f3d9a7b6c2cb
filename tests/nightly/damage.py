"""Damage of ledgers: each is refused in one line, or changes nothing of what is read.

    python -m tests.nightly.damage        (N=1000 SEED=1)

Flipped bits anywhere in the file, files that were cut off, journals that are missing or belong to another ledger,
tables and rows that were dropped, swapped, or copied from another campaign: in a complete ledger, in one that is half
done, and in one whose process was killed.  Each damaged ledger is read as a whole, and by one of the verbs.
"""

import contextlib
import io
import os
import random
import shutil
import sqlite3
import sys
import tempfile
from collections import Counter
from pathlib import Path

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.store import FILE, Store
from mavfi.cli import commands
from mavfi.errors import BadInputError
from mavfi.plugins import allow_plugins
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import small
from tests.nightly.chaos import say

VERBS = (
    ("campaign", "status", "{}"),
    ("campaign", "digest", "{}"),
    ("campaign", "verify", "{}", "--share", "0.02"),
    ("report", "{}"),
    ("runs", "{}"),
)
CUTS = 300
_HALF = 40
_EVERY = 20
"""Of the ledgers whose damage is without effect so many are shown to one verb; of the refused ones all."""


class _EnoughError(Exception):
    """Stops a campaign half-way."""


def _fly(folder, runs=None, **changes):
    """A ledger of a small campaign, up to so many runs; as it is while the campaign is flown if `runs` is negative."""

    def stop(progress):
        if runs is not None and progress.flown == abs(runs):
            if runs < 0:
                shutil.copytree(folder, folder.with_name(f"{folder.name}-live"))
            raise _EnoughError

    with contextlib.suppress(_EnoughError):
        run_campaign(small(**changes), folder, executor=LocalExecutor(1), progress=stop)
    return folder.with_name(f"{folder.name}-live") if runs is not None and runs < 0 else folder


def ledgers(folder):
    """By name: complete, half done, killed, and complete ones of other seeds and of other faults."""
    return {
        "complete": _fly(folder / "complete"),
        "half": _fly(folder / "half", runs=_HALF),
        "killed": _fly(folder / "killed", runs=-_HALF),
        "foreign": _fly(folder / "foreign", first_seed=20_000),
        "sibling": _fly(folder / "sibling", faults=9),
    }


def content(folder):
    """Everything that a ledger says, or the line that says why it cannot be read."""
    try:
        with Store.open(folder) as store:
            meta = {key: store.meta(key) for key in ("identity", "versions", "missions", "models_dir")}
            runs = {run.spec.run_id: repr(run) if run.record else repr(run.spec) for run in store.runs()}
            sums = store.digest(), store.counts(), store.unknown(), store.planned()
            return meta, runs, store.complete, sums
    except BadInputError as error:
        return f"refused: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def is_earlier(stored, sound):
    """Whether it is an earlier state of the same campaign, and says so: runs and missions are left to be done."""
    (meta, runs, complete, _), (whole_meta, whole_runs, _, _) = stored, sound
    return (
        not complete
        and all(value in (None, whole_meta[key]) for key, value in meta.items())
        and all(run in whole_runs.get(name, "") for name, run in runs.items())
    )


def printed_by(folder, verb):
    """Exit code and text of a verb; a traceback is raised."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = commands.run([word.format(folder) for word in verb])
    return code, out.getvalue(), err.getvalue()


class Bench:
    """Sound ledgers, what they say, and a place for damaged copies; notes what was silent or a traceback."""

    def __init__(self, folder, draw):
        self.folder, self.draw, self.sound = folder, draw, ledgers(folder)
        self.place = folder / "damaged"
        self.contents = {name: content(self.copied(name)) for name in self.sound}
        self.words = {}
        self.judged, self.wrong = Counter(), []

    def copied(self, name):
        """A copy of a sound ledger, at the same place each time."""
        shutil.rmtree(self.place, ignore_errors=True)
        shutil.copytree(self.sound[name], self.place)
        return self.place

    def judge(self, name, kind, allowed=(), *, loses=False):
        """Read what lies in the place, which was the ledger `name`.

        Contents of others may be allowed as a whole.  What `loses` the last that was written may be an earlier state.
        """
        stored = content(self.place)
        verb = self.draw.choice(VERBS)
        fault = ""
        if isinstance(stored, str):
            self.judged[kind, "refused"] += 1
            fault = self._refusal(stored, verb) if stored.startswith("refused: ") else stored
        elif stored in (self.contents[name], *(self.contents[other] for other in allowed)):
            self.judged[kind, "without effect"] += 1
            if self.judged.total() % _EVERY == 0 and name != "killed" and stored == self.contents[name]:
                printed = printed_by(self.place, verb)
                fault = "" if printed == self._words(name, verb) else f"{verb}: says something else"
        elif loses and is_earlier(stored, self.contents[name]):
            self.judged[kind, "not complete"] += 1
        else:
            fault = "silent"
        if fault:
            self.wrong.append(f"{name}, {kind}: {fault}")

    def _words(self, name, verb):
        """What a verb says of a sound ledger at the place of the damaged one."""
        if (name, verb) not in self.words:
            self.words[name, verb] = printed_by(self.copied(name), verb)
        return self.words[name, verb]

    def _refusal(self, stored, verb):
        if "\n" in stored or str(self.place) not in stored:
            return f"not one line that names the ledger: {stored}"
        try:
            code, _, err = printed_by(self.place, verb)
        except Exception as error:
            return f"{verb}: {type(error).__name__}: {error}"
        return "" if code == 2 and err.count("\n") == 1 else f"{verb}: exit code {code}: {err}"


def flips(bench, count):
    """One bit of a ledger's file, drawn uniformly."""
    for number in range(count):
        name = ("complete", "half")[number % 2]
        path = bench.copied(name) / FILE
        data = bytearray(path.read_bytes())
        data[bench.draw.randrange(len(data))] ^= 1 << bench.draw.randrange(8)
        path.write_bytes(data)
        bench.judge(name, "flipped bit")


def cuts(bench, count):
    """Files that end early."""
    for number in range(count):
        name = ("complete", "half")[number % 2]
        path = bench.copied(name) / FILE
        path.write_bytes(path.read_bytes()[: path.stat().st_size * number // count])
        bench.judge(name, "cut off")


def journals(bench):
    """Logs of SQLite that are missing, of another ledger, or damaged."""
    log, index = (f"{FILE}-{ending}" for ending in ("wal", "shm"))
    (bench.copied("killed") / index).unlink()
    bench.judge("killed", "no -shm", loses=True)
    (bench.copied("killed") / log).unlink()
    bench.judge("killed", "no -wal", loses=True)
    for name in (log, index):
        bench.copied("killed").joinpath(name).write_bytes(b"")
        bench.judge("killed", f"empty {name[-4:]}", loses=True)
    live = bench.sound["killed"]
    for name in ("complete", "half", "foreign", "sibling"):
        for files in ((log,), (index,), (log, index)):
            bench.copied(name)
            for file in files:
                shutil.copy(live / file, bench.place / file)
            bench.judge(name, "foreign " + " ".join(file[-4:] for file in files), ("killed",))
    data = (live / log).read_bytes()
    for _ in range(40):
        damaged = bytearray(data)
        damaged[bench.draw.randrange(len(data))] ^= 1 << bench.draw.randrange(8)
        bench.copied("killed").joinpath(log).write_bytes(damaged)
        bench.judge("killed", "flipped bit of -wal", loses=True)


STATEMENTS = (
    "DROP TABLE runs",
    "DROP TABLE missions",
    "DROP TABLE meta",
    "DELETE FROM meta WHERE key = 'identity'",
    "DELETE FROM meta WHERE key = 'missions'",
    "DELETE FROM missions",
    "DELETE FROM runs",
    "DELETE FROM missions WHERE rowid = 2",
    "DELETE FROM runs WHERE position = (SELECT MAX(position) FROM runs)",
    "DELETE FROM runs WHERE position = 3",
    "DELETE FROM runs WHERE seed = 10001",
    "ALTER TABLE runs ADD COLUMN more",
    "ALTER TABLE runs RENAME TO flights",
    "UPDATE runs SET position = position + 1000 WHERE position = 3",
    "UPDATE runs SET record = (SELECT record FROM runs WHERE position = 5) WHERE position = 3",
    "UPDATE runs SET record = NULL WHERE position = 3",
    "UPDATE runs SET record = x'00' WHERE position = 3",
    "UPDATE runs SET checksum = '' WHERE position = 3",
    "UPDATE runs SET spec = '{}' WHERE position = 3",
    "UPDATE missions SET seed = seed + 1000 WHERE rowid = 1",
    "PRAGMA user_version = 99",
    "INSERT INTO missions SELECT environment, seed + 500, checksum FROM missions LIMIT 1",
)


_MISSIONS = {"DELETE FROM meta WHERE key = 'missions'", "DELETE FROM missions", "DELETE FROM missions WHERE rowid = 2"}
"""What repairing a ledger and resuming it makes again."""


def statements(bench):
    """Tables and rows that somebody changed."""
    for name in ("complete", "half"):
        for statement in STATEMENTS:
            with contextlib.closing(sqlite3.connect(bench.copied(name) / FILE)) as connection, connection:
                connection.execute(statement)
            bench.judge(name, statement, loses=statement in _MISSIONS)


MOVES = {
    "row in the place of another campaign's": (
        "DELETE FROM runs WHERE position = :place",
        "INSERT OR IGNORE INTO runs SELECT * FROM other.runs WHERE position = :place",
    ),
    "row of another campaign": (
        "INSERT OR IGNORE INTO runs SELECT * FROM other.runs WHERE position = (SELECT MIN(theirs.position) FROM "
        "other.runs AS theirs WHERE position >= :place AND NOT EXISTS (SELECT 1 FROM runs AS own WHERE own.position = "
        "theirs.position))",
    ),
    "mission of another campaign": (
        "INSERT OR IGNORE INTO missions SELECT * FROM other.missions",
        "INSERT OR IGNORE INTO runs SELECT * FROM other.runs",
    ),
    "identity of another campaign": ("INSERT OR REPLACE INTO meta SELECT * FROM other.meta WHERE key = 'identity'",),
    "size of another campaign": ("INSERT OR REPLACE INTO meta SELECT * FROM other.meta WHERE key = 'missions'",),
}
"""What is taken from another ledger."""


def moves(bench, count):
    """Rows that wander between ledgers, at random places."""
    for number in range(count):
        for kind, steps in MOVES.items():
            row = bench.draw.randrange(94)
            name, other = (("complete", "half")[number % 2], ("foreign", "sibling")[number // 2 % 2])
            with contextlib.closing(sqlite3.connect(bench.copied(name) / FILE)) as connection:
                connection.execute("ATTACH ? AS other", (str(bench.sound[other] / FILE),))
                with connection:
                    for step in steps:
                        connection.execute(step, {"place": row} if ":place" in step else {})
            bench.judge(name, kind)


def damage(bench, count):
    """All of it, with so many flipped bits."""
    flips(bench, count)
    cuts(bench, CUTS * count // 1000)
    journals(bench)
    statements(bench)
    moves(bench, max(4, count // 25))


def main():
    """Damage, and tell what was silent."""
    count, draw = int(os.environ.get("N", "1000")), random.Random(int(os.environ.get("SEED", "1")))
    allow_plugins()  # the made-up host of the campaigns
    with tempfile.TemporaryDirectory(prefix="mavfi-damage-") as folder:
        bench = Bench(Path(folder), draw)
        damage(bench, count)
    for (kind, end), number in sorted(bench.judged.items()):
        say(f"{number:5} {end:14} {kind}")
    say("\n".join(bench.wrong) or "nothing was silent")
    return 1 if bench.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
