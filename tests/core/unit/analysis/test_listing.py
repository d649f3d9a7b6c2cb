from dataclasses import replace

import polars as pl
import pytest

from mavfi.analysis.listing import listing, ordered, partner
from mavfi.analysis.rows import SCHEMA
from tests.core.unit.analysis.handmade import UNKNOWN, flown, golden, injected, runs


@pytest.fixture
def campaign_runs():
    unknown = replace(injected(3, UNKNOWN), note="Traceback\n  ...\nKeyError: 3\nmy:Own: KeyError: 3 (my.py:2, check)")
    return runs(golden(1), golden(2), injected(1, flown()), injected(2, flown(success=False)), unknown)


def test_every_run_is_a_row_with_all_columns_in_files(campaign_runs):
    listed = listing(campaign_runs)
    assert len(listed.rows) == 5 and listed.title == "5 of 5 runs"
    assert {column.key for column in listed.columns} == {"number", *SCHEMA}
    assert [column.key for column in listed.columns if not column.hidden][:4] == [
        "number",
        "run_id",
        "status",
        "effect",
    ]


def test_the_reason_is_shown_where_a_run_could_not_be_judged(campaign_runs):
    shown = [column.key for column in listing(campaign_runs).columns if not column.hidden]
    assert (
        shown[-1] == "reason" and listing(campaign_runs).column("reason")[-1] == "my:Own: KeyError: 3 (my.py:2, check)"
    )
    assert set(listing(campaign_runs.where("judged")).column("reason")) == {""}
    shown = [column.key for column in listing(campaign_runs.where("judged")).columns if not column.hidden]
    assert "reason" not in shown


def test_failed_are_those_that_did_not_succeed(campaign_runs):
    failed = listing(campaign_runs, failed=True)
    assert failed.column("status") == ["collision", "unknown"]
    assert failed.column("number") == [4, 5]  # as in the list of all


def _row(index, success, *, arm="", time=100.0, distance=50.0, **changes):
    return {
        "run_id": f"{arm}{index}",
        "kind": "injected",
        "setting": f"dr_{arm}" if arm else "fi",
        "arm": arm,
        "detector": arm,
        "environment": "sparse",
        "target": "planning",
        "index": index,
        "judged": True,
        "site_outcome": "activated",
        "success": success,
        "golden_success": True,
        "distance_m": distance,
        "inflation": time / 100.0 - 1 if success else None,
        **changes,
    }


def _frame(*rows):
    return pl.DataFrame(rows, schema=SCHEMA)


def test_lost_missions_come_first_then_slower_ones_then_changed_then_masked_ones():
    flown = {"end": "flown", "effect": "sdc"}
    rows = [
        _row(0, True, **flown | {"effect": "masked"}),
        _row(1, True, **flown),
        _row(2, True, time=150.0, **flown),
        _row(3, False, **flown),
        _row(4, False, **flown),
        _row(5, False, **flown | {"target": "control"}),
        _row(6, False, **flown | {"site_outcome": "no_site"}),
        _row(7, False, **flown | {"end": "due"}),
    ]
    assert ordered(_frame(*rows)) == ["3", "5", "4", "2", "1", "0"]  # another target before the next of the same one


def test_the_partner_has_the_same_fault_and_succeeds_where_one_does():
    flown = {"end": "flown", "world": "sparse 7"}
    rows = [
        _row(1, False, **flown),
        _row(1, False, arm="autoencoder", **flown),
        _row(1, True, arm="gaussian", **flown),
        _row(2, True, arm="other", **flown),
        _row(3, False, **flown),
    ]
    frame = _frame(*rows)
    assert partner(frame, "1") == "gaussian1"
    assert partner(frame, "autoencoder1") == "1"
    assert partner(frame, "3") is None and partner(frame, "other2") is None


def test_a_run_that_a_host_could_not_judge_has_its_reason():
    """A host whose runs are no flights tells it in the record; there is no exception and no note."""
    unjudged = injected(3, replace(UNKNOWN, error="the number has no such bit"))
    table = listing(runs(golden(1), unjudged), failed=True)
    assert [row[[column.key for column in table.columns].index("reason")] for row in table.rows] == [
        "the number has no such bit"
    ]
