from dataclasses import replace

import pytest

from mavfi.analysis.listing import listing
from mavfi.analysis.rows import SCHEMA
from tests.core.unit.analysis.handmade import UNKNOWN, flown, golden, injected, runs


@pytest.fixture
def own():
    unknown = replace(injected(3, UNKNOWN), note="Traceback\n  ...\nKeyError: 3\nmy:Own: KeyError: 3 (my.py:2, check)")
    return runs(golden(1), golden(2), injected(1, flown()), injected(2, flown(success=False)), unknown)


def test_every_run_is_a_row_with_all_columns_in_files(own):
    found = listing(own)
    assert len(found.rows) == 5 and found.title == "5 of 5 runs"
    assert {column.key for column in found.columns} == set(SCHEMA)
    assert [column.key for column in found.columns if not column.hidden][:3] == ["run_id", "status", "flight_time_s"]


def test_the_reason_is_shown_where_a_run_could_not_be_judged(own):
    shown = [column.key for column in listing(own).columns if not column.hidden]
    assert shown[-1] == "reason" and listing(own).column("reason")[-1] == "my:Own: KeyError: 3 (my.py:2, check)"
    assert set(listing(own.where("judged")).column("reason")) == {""}
    shown = [column.key for column in listing(own.where("judged")).columns if not column.hidden]
    assert "reason" not in shown


def test_failed_are_those_that_did_not_succeed(own):
    assert listing(own, failed=True).column("status") == ["collision", "unknown"]
