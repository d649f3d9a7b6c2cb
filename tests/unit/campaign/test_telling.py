import polars as pl

from mavfi.campaign.analysis.rows import SCHEMA
from mavfi.campaign.telling import choose, ordered, partner


def _row(index, success, *, arm="", time=100.0, distance=50.0, **changes):
    return {
        "run_id": f"{arm}{index}", "kind": "injected", "setting": f"dr_{arm}" if arm else "fi", "arm": arm,
        "detector": arm, "environment": "sparse", "target": "planning", "index": index, "judged": True,
        "site_outcome": "activated", "success": success, "golden_success": True, "distance_m": distance,
        "inflation": time / 100.0 - 1 if success else None, **changes,
    }  # fmt: skip


def _chosen(*rows):
    chosen = choose(pl.DataFrame(rows, schema=SCHEMA))
    return None if chosen is None else [None if row is None else row["run_id"] for row in chosen]


def test_a_failure_that_a_detector_heals_comes_first():
    rows = [_row(0, False, distance=90.0), _row(1, False), _row(1, True, arm="gaussian"), _row(2, True, time=200.0)]
    assert _chosen(*rows) == ["1", "gaussian1"]


def test_then_a_failure_then_the_slowest():
    failed, slow = _row(0, False), _row(1, True, time=150.0)
    assert _chosen(slow, failed) == ["0", None]
    assert _chosen(slow, _row(2, True)) == ["1", None]
    assert _chosen(slow, _row(1, True, arm="gaussian")) == ["1", "gaussian1"]


def test_nothing_worth_a_picture():
    assert _chosen() is None
    assert _chosen(_row(0, True, time=100.5)) is None
    assert _chosen(_row(0, False, site_outcome="not_activated")) is None


def test_missions_whose_golden_run_fails_say_nothing_of_the_fault():
    assert _chosen(_row(0, False, golden_success=False)) is None


def _frame(*rows):
    return pl.DataFrame(rows, schema=SCHEMA)


def test_lost_missions_come_first_then_slower_ones_then_changed_then_masked_ones():
    flown = {"end": "flown", "effect": "sdc"}
    rows = [
        _row(0, True, **flown | {"effect": "masked"}), _row(1, True, **flown), _row(2, True, time=150.0, **flown),
        _row(3, False, **flown), _row(4, False, **flown), _row(5, False, **flown | {"target": "control"}),
        _row(6, False, **flown | {"site_outcome": "no_site"}), _row(7, False, **flown | {"end": "due"}),
    ]  # fmt: skip
    assert ordered(_frame(*rows)) == ["3", "5", "4", "2", "1", "0"]  # another target before the next of the same one


def test_the_partner_has_the_same_fault_and_succeeds_where_one_does():
    flown = {"end": "flown", "world": "sparse 7"}
    rows = [
        _row(1, False, **flown), _row(1, False, arm="autoencoder", **flown), _row(1, True, arm="gaussian", **flown),
        _row(2, True, arm="other", **flown), _row(3, False, **flown),
    ]  # fmt: skip
    frame = _frame(*rows)
    assert partner(frame, "1") == "gaussian1"
    assert partner(frame, "autoencoder1") == "1"
    assert partner(frame, "3") is None and partner(frame, "other2") is None
