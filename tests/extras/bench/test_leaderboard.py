"""A detector of one's own beside the published rows."""

from mavfi.analysis.table import NUMBER, Column, Table
from mavfi.extras.bench.bench import load_bench, published_rows
from mavfi.extras.bench.leaderboard import beside_published

OWN = Table("sites", "Sites", (Column("arm", "scheme"), Column("lost", "lost", NUMBER)), [("mine", 4)], notes=("n",))


def test_published_rows_of_a_group_stand_above_ones_own_of_the_same_group():
    columns = (Column("environment", "environment"), Column("setting", "setting"), Column("alarms", "alarms", NUMBER))
    own = Table("golden", "Golden", columns, [("dense", "mine", 4), ("farm", "mine", 5)], keys=2)
    rows = [("dense", "theirs", "1"), ("dense", "mine", "2"), ("farm", "theirs", "3"), ("sparse", "theirs", "6")]
    found = beside_published(
        own, [dict(zip(("environment", "setting", "alarms"), row, strict=True)) for row in rows], "b"
    )
    assert found.rows == [
        ("dense", "theirs", "1"),
        ("dense", "mine", 4),
        ("farm", "theirs", "3"),
        ("farm", "mine", 5),
        ("sparse", "theirs", "6"),
    ]


def test_without_published_rows_it_stands_alone():
    assert beside_published(OWN, [], "b") is OWN
    assert beside_published(OWN, [{"environment": "dense"}], "b") is OWN


def test_shipped_rows_have_a_list_of_their_faults():
    bench = load_bench("mavfi-bench-1")
    rows = published_rows(bench, "sites", "quick")
    dropped = {"conformal", "cusum"}  # their rows are the evidence that `limits` does the same
    assert {"gaussian", "recommended"} <= {row["scheme"] for row in rows} <= {*bench.arms, *dropped}
    assert published_rows(bench, "state", "quick") == []
