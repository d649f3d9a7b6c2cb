import sqlite3
import subprocess
import sys

import pytest

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.store import FILE, Store
from mavfi.errors import BadInputError

IDENTITY = {"campaign": {"name": "c", "flights": 3}, "models": {}}
SPECS = [RunSpec(1, "golden", "sparse", seed, "key") for seed in range(4)]


@pytest.fixture
def store(tmp_path):
    with Store.create(tmp_path / "out", IDENTITY) as store:
        store.plan(1, SPECS)
        yield store


def write(store, spec, **record):
    store.write(spec, {"end": "flown", "success": True, **record}, None, "", 0.1)


def test_runs_come_in_the_order_of_the_plan_and_are_done_once_written(store):
    write(store, SPECS[2], digest="d")
    assert [run.spec for run in store.runs()] == SPECS
    assert [run.spec.seed for run in store.runs(done=False)] == [0, 1, 3]
    [done] = store.runs(1, done=True)
    assert done.record == {"end": "flown", "success": True, "digest": "d"}
    assert store.counts() == {"golden": (4, 1, 1)}


def test_a_phase_is_planned_once(store):
    assert store.is_planned(1)
    assert not store.is_planned(2)
    store.plan(1, [RunSpec(1, "golden", "dense", 7, "key")])
    assert len(list(store.runs())) == 4
    store.plan(2, [RunSpec(2, "fi", "dense", 7, "key")])
    assert len(list(store.runs(2))) == 1


def test_a_ledger_is_complete_when_both_phases_are_planned_and_flown(store):
    injected = RunSpec(2, "fi", "dense", 7, "key")
    for spec in SPECS:
        assert not store.complete
        write(store, spec)
    assert not store.complete, "the second phase is not planned yet"
    store.plan(2, [injected])
    assert not store.complete
    write(store, injected)
    assert store.complete


def test_digest_does_not_depend_on_order_or_wall_time(tmp_path):
    digests = []
    for name, order in (("a", SPECS), ("b", SPECS[::-1])):
        with Store.create(tmp_path / name, IDENTITY) as store:
            store.plan(1, SPECS)
            for place, spec in enumerate(order):
                store.write(spec, {"end": "flown", "digest": spec.run_id}, None, f"note {place}", 0.1 * place)
            digests.append(store.digest())
    assert digests[0] == digests[1]


def test_digest_depends_on_every_record_and_on_what_is_missing(store):
    digests = [store.digest()]
    for spec, digest in ((SPECS[0], "x"), (SPECS[0], "y"), (SPECS[1], "x")):
        write(store, spec, digest=digest)
        digests.append(store.digest())
    assert len(set(digests)) == 4


def test_another_campaign_is_refused_and_nothing_is_written_over(tmp_path):
    with Store.create(tmp_path, IDENTITY) as store:
        store.plan(1, SPECS)
        digest = store.digest()
    other = {**IDENTITY, "models": {"gaussian": "abc"}}
    with pytest.raises(BadInputError, match=r"holds another campaign \(differs in: models\)"):
        Store.create(tmp_path, other)
    with Store.create(tmp_path, IDENTITY) as store:
        assert store.digest() == digest


def test_a_second_writer_is_refused(tmp_path):
    with Store.create(tmp_path, IDENTITY):
        code = (
            "import pathlib, sys; from mavfi.campaign.store import Store; Store.create(pathlib.Path(sys.argv[1]), {})"
        )
        done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=False)
    assert "another process is writing" in done.stderr


def test_directories_that_cannot_be_written_are_bad_input(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match="cannot be written"):
        Store.create(tmp_path / "file" / "out", IDENTITY)
    with pytest.raises(BadInputError, match="holds no campaign"):
        Store.open(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_foreign_files_and_versions_are_refused(tmp_path):
    (tmp_path / FILE).write_text("not a ledger, but long enough to be mistaken for one" * 10)
    with pytest.raises(BadInputError, match="is not a ledger"):
        Store.open(tmp_path)
    with pytest.raises(BadInputError, match="is not a ledger"):
        Store.create(tmp_path, IDENTITY)
    assert (tmp_path / FILE).read_text().startswith("not a ledger")
    (tmp_path / "v").mkdir()
    with sqlite3.connect(tmp_path / "v" / FILE) as connection:
        connection.execute("PRAGMA user_version = 99")
        connection.execute("CREATE TABLE t (x)")
    connection.close()
    for attempt in (lambda: Store.open(tmp_path / "v"), lambda: Store.create(tmp_path / "v", IDENTITY)):
        with pytest.raises(BadInputError, match="schema version 99; allowed: 1"):
            attempt()


def test_a_run_is_found_by_the_beginning_of_its_id(store):
    assert store.run(SPECS[1].run_id).spec == SPECS[1]
    assert store.run("sparse-3").spec == SPECS[3]
    with pytest.raises(BadInputError, match="4 runs of that name"):
        store.run("sparse")
    with pytest.raises(BadInputError, match="no run of that name"):
        store.run("dense-1")
