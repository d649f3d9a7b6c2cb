import polars as pl

from mavfi.analysis.listing import ordered, partner
from mavfi.analysis.rows import SCHEMA


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
