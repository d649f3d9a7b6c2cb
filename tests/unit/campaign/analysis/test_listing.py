from dataclasses import replace

import pytest

from mavfi.campaign.analysis.listing import listing
from mavfi.campaign.analysis.rows import SCHEMA
from mavfi.errors import BadInputError
from tests.unit.campaign.analysis.handmade import UNKNOWN, flown, golden, injected, runs


@pytest.fixture
def own():
    unknown = replace(injected(3, UNKNOWN), note="Traceback\n  ...\nKeyError: 3\nmy:Own: KeyError: 3 (my.py:2, check)")
    return runs(golden(1), golden(2), injected(1, flown()), injected(2, flown(success=False)), unknown)


def test_every_run_is_a_row_with_all_columns_in_files(own):
    found = listing(own)
    assert len(found.rows) == 5 and found.title == "5 of 5 runs"
    assert {column.key for column in found.columns} == set(SCHEMA)
    assert [column.key for column in found.columns if not column.hidden][:3] == ["run_id", "status", "flight_time_s"]


def test_the_outcome_stands_together_and_says_effect(own):
    visible = [column.heading for column in listing(own).columns if not column.hidden]
    assert visible[:7] == ["run", "status", "flight time", "against golden", "effect", "alarms", "bit"]
    assert "injection" not in [column.heading for column in listing(own, ["kind=golden"]).columns if not column.hidden]


def test_the_reason_is_shown_where_a_run_could_not_be_judged(own):
    shown = [column.key for column in listing(own).columns if not column.hidden]
    assert shown[-1] == "reason" and listing(own).column("reason")[-1] == "my:Own: KeyError: 3 (my.py:2, check)"
    assert set(listing(own, ["judged=true"]).column("reason")) == {""}
    shown = [column.key for column in listing(own, ["judged=true"]).columns if not column.hidden]
    assert "reason" not in shown


def test_failed_are_those_that_did_not_succeed(own):
    assert listing(own, failed=True).column("status") == ["collision", "unknown"]


@pytest.mark.parametrize(
    ("where", "count"),
    [(["kind=golden"], 2), (["seed=1"], 2), (["seed=1,3"], 3), (["success=no", "kind=injected"], 2), (["bit=62"], 3)],
)
def test_filters(own, where, count):
    assert len(listing(own, where).rows) == count


@pytest.mark.parametrize(
    ("where", "notes"),
    [
        (["kind=golden", "success=no,yes"], ()),
        (["status=colision"], ("no run has status = colision; the ledger has: success, collision, unknown",)),
        (["stage=nosuch"], ("no run has stage = nosuch; the ledger has: planning",)),
        (["seed=1,9"], ("no run has seed = 9; the ledger has: 1, 2, 3",)),
    ],
)
def test_a_value_that_no_run_has_is_named_with_those_that_occur(own, where, notes):
    assert listing(own, where).notes == notes


@pytest.mark.parametrize(
    ("where", "message"), [("seed", "allowed: column=value"), ("seeds=1", "column 'seeds': not known")]
)
def test_filters_that_are_none_are_refused(own, where, message):
    with pytest.raises(BadInputError, match=message):
        listing(own, [where])


def test_rows_are_sorted_by_columns_and_those_without_a_value_come_last(own):
    seeds = [(True, 1), (True, 2), (False, 1), (False, 2), (False, 3)]  # golden or not
    found = listing(own, sort=["-kind", "-seed"])
    assert list(zip([kind == "golden" for kind in found.column("kind")], found.column("seed"), strict=True)) == [
        (False, 3), (False, 2), (False, 1), (True, 2), (True, 1),
    ]  # fmt: skip
    plain = listing(own)
    assert list(zip([kind == "golden" for kind in plain.column("kind")], plain.column("seed"), strict=True)) == seeds
    for sort, turned in (("flight_time_s", False), ("-flight_time_s", True)):
        times = listing(own, sort=[sort]).column("flight_time_s")
        known = [time for time in times if time is not None]
        assert known == sorted(known, reverse=turned) and times == [*known, *[None] * (5 - len(known))]
        assert len(known) < 5


def test_a_column_that_there_is_not_cannot_be_sorted_by(own):
    with pytest.raises(BadInputError, match="--sort: column 'seeds': not known; allowed: run_id, kind, "):
        listing(own, sort=["-seeds"])
