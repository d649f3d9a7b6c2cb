"""The ledger: what is in it is there to stay, and its digest says what is in it."""

import errno
import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from mavfi.campaign import store as store_module
from mavfi.campaign.plan import CompletedRun, Planned, RunSpec
from mavfi.campaign.store import FILE, Store
from mavfi.errors import BadInputError, MachineError, MavfiError
from mavfi.record import End, FlightRecord

IDENTITY = {"campaign": {"name": "c", "missions": 3}, "models": {}}
SPECS = [RunSpec("golden", "golden", "sparse", seed, "key", position=seed) for seed in range(4)]
INJECTED = RunSpec("injected", "fi", "sparse", 2, "key", target="planning", position=4)


@pytest.fixture
def store(tmp_path):
    with Store.create(tmp_path / "out", IDENTITY) as store:
        plan(store, SPECS)
        yield store


def plan(store, specs):
    store.plan(Planned.of(specs, last=True).rows)


def write(store, spec, status="success", **record):
    store.write([CompletedRun.of(spec.run_id, FlightRecord(End.FLOWN, status, **record), "", 0.1)])


def test_runs_come_in_the_order_of_the_plan_and_are_done_once_written(store):
    plan(store, [RunSpec("golden", "golden", "dense", 9, "key", position=100), INJECTED])
    write(store, SPECS[2], digest="d")
    assert [run.spec for run in store.runs()][:4] == SPECS
    assert [run.spec.position for run in store.runs()] == [0, 1, 2, 3, 4, 100]
    assert [run.spec.position for run in store.runs(done=False)] == [0, 1, 3, 4, 100]
    [done] = store.runs(done=True)
    assert (done.record, done.note, done.wall_s) == (FlightRecord(End.FLOWN, "success", "d"), "", 0.1)
    assert store.done(("sparse", 2)) == {SPECS[2].run_id}
    assert store.done(("sparse", 1)) == frozenset()


def test_what_is_planned_stays_as_it_is(store):
    write(store, SPECS[1], digest="d")
    before = store.digest()
    plan(store, [*SPECS, SPECS[1]])
    assert store.digest() == before
    plan(store, [INJECTED])
    assert [run.spec for run in store.runs()].count(INJECTED) == 1 and store.digest() != before


def test_a_ledger_is_complete_when_every_mission_is_planned_and_flown(store):
    worlds = {spec.world for spec in SPECS}
    store.write_meta({"missions": 4})
    for spec in SPECS:
        write(store, spec)
    assert not any(map(store.is_planned, worlds)) and not any(map(store.is_complete, worlds))
    for world in worlds - {INJECTED.world}:
        store.end_plan(world)
    assert {world for world in worlds if store.is_complete(world)} == worlds - {INJECTED.world}
    assert not store.complete, "the faults of one mission are not planned yet"
    plan(store, [INJECTED])
    store.end_plan(INJECTED.world)
    store.end_plan(INJECTED.world)
    assert all(map(store.is_planned, worlds)) and not store.complete
    write(store, INJECTED)
    assert store.complete


def test_digest_does_not_depend_on_order_or_wall_time(tmp_path):
    digests = []
    for name, order in (("a", SPECS), ("b", SPECS[::-1])):
        with Store.create(tmp_path / name, IDENTITY) as store:
            plan(store, order)
            for index, spec in enumerate(order):
                store.write(
                    [
                        CompletedRun.of(
                            spec.run_id, FlightRecord(End.FLOWN, digest=spec.run_id), f"note {index}", 0.1 * index
                        )
                    ]
                )
            digests.append(store.digest())
    assert digests[0] == digests[1]


def test_digest_depends_on_campaign_plan_and_every_record(store, tmp_path):
    digests = [store.digest()]
    for spec, digest in ((SPECS[0], "x"), (SPECS[1], "x")):
        write(store, spec, digest=digest)
        digests.append(store.digest())
    with Store.create(tmp_path / "other", {**IDENTITY, "models": {"g": "abc"}}) as other:
        plan(other, SPECS)
        digests.append(other.digest())
    with Store.create(tmp_path / "third", IDENTITY) as third:
        plan(third, SPECS)
        assert third.digest() == digests[0]
        write(third, SPECS[0], digest="y")
        digests.append(third.digest())
    assert len(set(digests)) == 5


@pytest.mark.slow
def test_a_second_writer_is_refused(tmp_path):
    with Store.create(tmp_path, IDENTITY):
        code = (
            "import pathlib, sys; from mavfi.campaign.store import Store; Store.create(pathlib.Path(sys.argv[1]), {})"
        )
        done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=False)
    assert "another process is writing" in done.stderr


@pytest.mark.parametrize(
    "write_late",
    [
        lambda store: write(store, SPECS[2], digest="older"),
        lambda store: plan(store, [INJECTED]),
        lambda store: store.end_plan(("sparse", 1)),
        lambda store: store.write_meta({"missions": 9}),
    ],
)
def test_of_two_writers_only_the_younger_commits(tmp_path, write_late):
    """The lock is gone (removed, or on a file system without locks), and the first writer continues after a pause."""
    older = Store.create(tmp_path, IDENTITY)
    plan(older, SPECS)
    write(older, SPECS[0], digest="older")
    (tmp_path / "campaign.lock").unlink()
    with Store.create(tmp_path, IDENTITY) as younger:
        for spec in SPECS[1:]:
            with pytest.raises(MavfiError, match="another process has taken over this campaign"):
                write_late(older)
            write(younger, spec, digest="younger")
        assert [run.record.digest for run in younger.runs()] == ["older"] + ["younger"] * 3
    older.close()
    with Store.open(tmp_path) as store:
        assert store.meta("missions") is None and not any(store.is_planned(spec.world) for spec in SPECS)


def empty(file):
    file.touch()


def foreign(file):
    file.write_text("not a ledger, but long enough to be mistaken for one" * 10)


def of_version(number):
    def make(file):
        with closing(sqlite3.connect(file)) as connection, connection:
            connection.execute(f"PRAGMA user_version = {number}")
            connection.execute("CREATE TABLE runs (run_id TEXT)")

    return make


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (empty, r"is not a ledger of mavfi \(it is empty\)$"),
        (foreign, "is not a ledger"),
        (of_version(1), "schema version 1; allowed: 3 .*older mavfi"),
        (of_version(99), "schema version 99; allowed: 3$"),
    ],
)
def test_what_is_no_ledger_of_this_version_is_refused_and_left_as_it_is(tmp_path, make, message):
    make(tmp_path / FILE)
    before = (tmp_path / FILE).read_bytes()
    with pytest.raises(BadInputError, match=message):
        Store.open(tmp_path)
    if before:  # an empty one is begun
        with pytest.raises(BadInputError, match=message):
            Store.create(tmp_path, IDENTITY)
    assert (tmp_path / FILE).read_bytes() == before


def test_a_ledger_whose_making_was_stopped_is_begun_again(tmp_path, monkeypatch):
    def stop(store, items):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Store, "write_meta", stop)
        with pytest.raises(KeyboardInterrupt):
            Store.create(tmp_path, IDENTITY)
    with Store.create(tmp_path, IDENTITY) as store:
        assert store.meta("identity") == IDENTITY


def test_an_ambiguous_id_lists_candidates(store):
    with pytest.raises(BadInputError, match="ambiguous, 4 runs match, e.g. sparse-0-golden-.*, sparse-3-g"):
        store.run("sparse")
    plan(store, [RunSpec("golden", "golden", "sparse", seed, "key", position=seed) for seed in range(10, 100)])
    with pytest.raises(BadInputError, match="94 runs match") as caught:
        store.run("sparse")
    assert str(caught.value).count("-golden-") == 5


def filled(folder):
    with Store.create(folder, IDENTITY) as store:
        plan(store, [*SPECS, INJECTED])
        store.write_meta({"missions": 4})
        for spec in [*SPECS, INJECTED]:
            write(store, spec, digest=spec.run_id)
        for world in {spec.world for spec in SPECS}:
            store.end_plan(world)
        return store.digest()


def read(folder):
    """Digest of a ledger and all its runs, or the line that says why it cannot be read."""
    try:
        with Store.open(folder) as store:
            assert [run.spec.run_id for run in store.runs()]
            return store.digest() + str(store.counts()) + str(store.complete)
    except BadInputError as error:
        assert "\n" not in str(error)
        return None


def test_no_flipped_bit_changes_a_ledger_unseen(tmp_path):
    filled(tmp_path)
    path = tmp_path / FILE
    sound, whole = read(tmp_path), path.read_bytes()
    assert sound is not None
    random = np.random.default_rng(0)
    refused = 0
    for index, bit in zip(random.integers(0, len(whole), 400), random.integers(0, 8, 400), strict=True):
        damaged = bytearray(whole)
        damaged[index] ^= 1 << int(bit)
        path.write_bytes(damaged)
        contents = read(tmp_path)
        assert contents in (None, sound), f"bit {bit} of byte {index}"  # most of the file is empty space
        refused += contents is None
    assert refused > 20


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("DELETE FROM runs WHERE position = 4", "mission sparse-2: runs are missing or were added"),
        ("UPDATE runs SET seed = 3 WHERE position = 4", "run '.*': checksum mismatch"),
        ("UPDATE runs SET record = NULL, wall_s = NULL WHERE position = 0", "run '.*': checksum mismatch"),
        ("UPDATE runs SET note = 'x' WHERE position = 0", "run '.*': checksum mismatch"),
        ("UPDATE meta SET value = '5' WHERE key = 'missions'", "metadata 'missions': checksum mismatch"),
        ("DELETE FROM meta", "run '.*': checksum mismatch|metadata are missing"),
        ("DELETE FROM meta WHERE key = 'bound'", "metadata '.*': checksum mismatch"),
        ("DROP TABLE missions", "no such table: missions"),
    ],
)
def test_a_change_by_hand_is_named(tmp_path, change, message):
    filled(tmp_path)
    with closing(sqlite3.connect(tmp_path / FILE)) as connection, connection:
        connection.execute(change)
    for attempt in (lambda: Store.open(tmp_path), lambda: Store.create(tmp_path, IDENTITY)):
        with pytest.raises(
            BadInputError, match=rf"campaign.sqlite: is damaged: ({message}).*; .*: mavfi campaign repair {tmp_path}$"
        ):
            attempt()


def test_a_disk_without_space_is_a_failure_of_the_machine(store):
    store._connection.execute("PRAGMA max_page_count = 12")  # SQLite's own way to a full disk
    with pytest.raises(MachineError, match=r"campaign.sqlite: cannot be written \(database or disk is full\)"):
        for seed in range(2000):
            plan(store, [RunSpec("golden", "golden", "farm", seed, "key", position=100 + seed)])
    with Store.open(store.directory) as again:
        assert [run.spec.seed for run in again.runs()] == [*(spec.seed for spec in SPECS), *range(seed)]


def test_a_closed_ledger_is_one_file_and_reading_adds_none(tmp_path):
    digest = filled(tmp_path)
    before = sorted(path.name for path in tmp_path.iterdir())
    assert before == ["campaign.lock", FILE]
    assert read(tmp_path).startswith(digest)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_ledger_on_media_that_cannot_be_written_is_read(tmp_path, monkeypatch):
    filled(tmp_path)
    contents = read(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, how: how != os.W_OK)
    assert read(tmp_path) == contents
    (tmp_path / f"{FILE}-wal").write_bytes(b"what was not closed")
    with pytest.raises(BadInputError, match="was not closed; open it once on writable media"):
        Store.open(tmp_path)


@pytest.mark.slow
def test_a_campaign_that_starts_while_its_ledger_is_read_is_one_line(tmp_path):
    Store.create(tmp_path, IDENTITY).close()
    with closing(sqlite3.connect(tmp_path / FILE)) as reader:
        reader.execute("BEGIN")
        reader.execute("SELECT * FROM runs").fetchone()
        with pytest.raises(BadInputError, match=r"campaign.sqlite: another process reads it; try again later"):
            Store.create(tmp_path, IDENTITY)
    Store.create(tmp_path, IDENTITY).close()


def test_a_ledger_of_an_older_mavfi_has_no_salt_and_is_read_and_resumed(tmp_path, monkeypatch):
    with monkeypatch.context() as older:
        older.setattr(store_module, "salt_of", lambda connection: ())
        digest = filled(tmp_path)
        with closing(sqlite3.connect(tmp_path / FILE)) as connection, connection:
            connection.execute("DELETE FROM meta WHERE key = 'bound'")
    with Store.create(tmp_path, IDENTITY) as store:
        assert store.digest() == digest
        store.write_meta({"missions": 5})
    with Store.open(tmp_path) as store:
        assert store.digest() == digest and store.meta("missions") == 5


def failing(monkeypatch, times):
    """Reads of the ledger that give no more than SQLite's word for it, the first so many times."""
    left = [times]
    sound = store_module.damage

    def look(connection):
        left[0] -= 1
        return "database disk image is malformed" if left[0] >= 0 else sound(connection)

    monkeypatch.setattr(store_module, "damage", look)


def test_damage_that_quotes_lines_of_the_file_is_one_line(tmp_path):
    filled(tmp_path)
    path = tmp_path / FILE
    path.write_bytes(path.read_bytes().replace(b"    wall_s REAL", b'    "wall_ REAL'))
    with pytest.raises(BadInputError, match=r"is damaged: malformed database schema .*checksum[^\n]*$"):
        Store.open(tmp_path)


def test_a_disk_that_keeps_failing_is_no_damage(tmp_path, monkeypatch):
    def open_it(path, *mode):
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))

    filled(tmp_path)
    failing(monkeypatch, 2)
    monkeypatch.setattr(Path, "open", open_it)
    with pytest.raises(MachineError, match=r"campaign.sqlite: cannot be read \(Input/output error\)"):
        Store.open(tmp_path)
