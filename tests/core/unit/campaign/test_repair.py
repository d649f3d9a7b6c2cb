"""What is whole of a damaged ledger is kept; what is flown for the rest gives the ledger that it was."""

import sqlite3
from contextlib import closing

import pytest

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.ledger import DAMAGED, repair
from mavfi.campaign.store import FILE, Store
from mavfi.cli import run
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import small


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    directory = tmp_path_factory.mktemp("flown")
    run_campaign(small(), directory, executor=LocalExecutor(1))
    with Store.open(directory) as store:
        return (directory / FILE).read_bytes(), store.digest(), len(list(store.runs()))


def again(directory):
    """Digest after the campaign was resumed, and how many runs were flown for that."""
    reports = []
    run_campaign(small(), directory, executor=LocalExecutor(1), progress=reports.append)
    with Store.open(directory) as store:
        return store.digest(), max((report.flown for report in reports), default=0)


def changed(directory, *changes):
    with closing(sqlite3.connect(directory / FILE)) as connection, connection:
        for change in changes:
            connection.execute(change)


@pytest.mark.parametrize(
    ("change", "lost", "flown_again"),
    [
        ("UPDATE runs SET record = replace(record, 'success', 'timeout') WHERE position = 0", 1, 1),
        ("UPDATE runs SET spec = 'x' WHERE position IN (1, 30, 31)", 3, 3),
        ("DELETE FROM runs WHERE position IN (2, 40)", 0, 2),
        ("DELETE FROM missions", 0, 0),
        ("DROP TABLE missions", 0, 0),
        ("UPDATE missions SET checksum = ''", 0, 0),
    ],
)
def test_what_was_changed_is_flown_again(flown, tmp_path, change, lost, flown_again):
    (tmp_path / FILE).write_bytes(flown[0])
    changed(tmp_path, change)
    repaired = repair(tmp_path)
    assert repaired.lost == lost and repaired.intact == flown[2] - flown_again
    assert again(tmp_path) == (flown[1], flown_again)
    assert (tmp_path / DAMAGED).is_file() != repaired.was_intact


def test_an_intact_ledger_is_left_as_it_is(flown, tmp_path, capsys):
    (tmp_path / FILE).write_bytes(flown[0])
    assert run(["campaign", "repair", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "nothing to repair" in printed and "Backup" not in printed
    assert [path.name for path in tmp_path.iterdir()] == [FILE]
    assert (tmp_path / FILE).read_bytes() == flown[0]


def test_what_cannot_be_repaired_is_one_line_and_left_as_it_is(flown, tmp_path, capsys):
    assert run(["campaign", "repair", str(tmp_path)]) == 2
    (tmp_path / FILE).write_bytes(flown[0])
    changed(tmp_path, "UPDATE meta SET value = '{}' WHERE key = 'identity'")
    before = (tmp_path / FILE).read_bytes()
    assert run(["campaign", "repair", str(tmp_path)]) == 2
    assert (tmp_path / FILE).read_bytes() == before and not (tmp_path / DAMAGED).exists()
    for code in (0, 2):
        (tmp_path / FILE).write_bytes(flown[0])
        changed(tmp_path, "UPDATE runs SET spec = 'x' WHERE position = 1")
        assert run(["campaign", "repair", str(tmp_path)]) == code
    printed = capsys.readouterr()
    assert f"{flown[2] - 1} runs kept, 1 damaged." in printed.out
    lines = printed.err.splitlines()
    assert len(lines) == 3
    for line, word in zip(lines, ("holds no campaign", "its metadata are damaged", "exists already"), strict=True):
        assert word in line
