"""A detector of one's own beside the published rows."""

import io
from dataclasses import replace

from rich.console import Console

from mavfi.analysis.statistics import Rate, event_rate
from mavfi.analysis.table import NUMBER, Column, Table
from mavfi.extras.bench.bench import load_bench, published_rows
from mavfi.extras.bench.leaderboard import beside_published
from mavfi.extras.bench.verdict import results_of, sentences, short_table

OWN = Table("sites", "Sites", (Column("arm", "scheme"), Column("lost", "lost", NUMBER)), [("mine", 4)], notes=("n",))


def test_published_rows_of_a_group_stand_above_ones_own_of_the_same_group():
    columns = (Column("environment", "environment"), Column("setting", "setting"), Column("alarms", "alarms", NUMBER))
    flown_rows = Table("golden", "Golden", columns, [("dense", "mine", 4), ("farm", "mine", 5)], keys=2)
    rows = [("dense", "theirs", "1"), ("dense", "mine", "2"), ("farm", "theirs", "3"), ("sparse", "theirs", "6")]
    combined = beside_published(
        flown_rows,
        [dict(zip(("environment", "setting", "alarms"), row, strict=True)) for row in rows],
        "published in b",
    )
    assert combined.rows == [
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
    left = {"pca", "cusum"}  # rows of schemes that have left the bench are the evidence for that
    assert {"gaussian", "recommended", *left} <= {row["scheme"] for row in rows}
    assert not left & bench.arms.keys()
    assert published_rows(bench, "state", "quick") == []


def test_the_verdict_is_a_sentence_and_rows_are_sorted():
    rows = published_rows(load_bench("mavfi-bench-1"), "sites", "quick")
    keys = {"scheme": "arm", "brought back": "back", "only it lost": "newly_lost", "false alarms": "per_hour"}
    columns = tuple(Column(keys.get(heading, heading), heading) for heading in rows[0])
    table = Table("sites", "T", columns, [tuple(row.values()) for row in rows])
    mine = ("Jump", 72, 36, Rate(36, 0.25, 0.14, 0.41, 9), None, 1.0, 27, 0, None, None, None, event_rate(0, 0.13))
    table = replace(table, rows=[*table.rows, (*mine, 0.13, 0.0)])
    results = results_of(table)
    assert sentences(results, ["Jump"]) == [
        "Jump brings back 9 of 36, 25 % [14, 41]: better than 5 of 20 schemes; no false alarm (at most 28 per hour); "
        "loses nothing."
    ]
    (best,) = sentences(results, [])
    assert best.startswith("the best one, ") and "36 of 36" in best and "as good as 9" in best
    shares = [result.share for result in results]
    assert shares == sorted(shares, reverse=True) and len(results) == 21

    terminal = Console(width=80, record=True, file=io.StringIO(), color_system="standard", force_terminal=True)
    terminal.print(short_table(table, ["Jump"]))
    text = terminal.export_text(styles=True)
    (line,) = (line for line in text.splitlines() if "Jump" in line)
    assert "▶ Jump" in line and "9/36 25 [14, 41]" in line and "\x1b[1;32m" in line, "one's own row stands out"
    assert "…" not in text
