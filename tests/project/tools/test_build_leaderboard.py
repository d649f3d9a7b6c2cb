"""The worth of each rule is that of the ledgers; bad input is one line."""

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import load_bench, published_rows
from tools import build_leaderboard, results
from tools.build_leaderboard import NAME, summary
from tools.build_readme import recovery_block


def test_the_headline_counts_what_comes_back():
    back = {"gaussian": "16.7 [3.0, 56.4] 1/6", "autoencoder": "—", "recommended": "100.0 [61.0, 100.0] 6/6"}
    sites = [{"scheme": scheme, "lost": "6", "brought back": text} for scheme, text in back.items()]
    planner = [{**row, "lost": "8"} for row in sites]
    block = recovery_block(
        {"sites": sites, "instruction": planner, "memory": sites[:2]}, {"gaussian": "2.0 [1.0, 3.0]"}
    )
    assert [line for line in block.splitlines() if line.startswith("| a")] == [
        "| a value between kernels, fields and bits that lose most | 6 | 1 (17 %) | — | 6 (100 %) |",
        "| an instruction of the planner | 8 | 1 of 6 (17 %) | — | 6 of 6 (100 %) |",
    ]
    assert "remembers" not in block, "not flown with all three"
    assert "False alarms per hour of flight without a fault: 2.0 [1.0, 3.0] (`gaussian`)." in block
    assert "only faults that meet the same value" in block

    block = recovery_block({"sites": sites}, {})
    assert "alarms" not in block, "no golden flights, and no fault is moved by them"
    with pytest.raises(BadInputError, match="no part has rows of gaussian, autoencoder, recommended; needed: one"):
        recovery_block({"memory": sites[:2]}, {})


BENCH = load_bench(NAME)


def test_the_published_page_has_the_sums_of_the_published_rows():
    rows = {name: published_rows(BENCH, name, "paper") for name in BENCH.parts}
    for name, full in summary(BENCH, rows).items():
        path = results.TABLES / "leaderboard" / f"{name}.csv"
        assert path.read_text(encoding="utf-8") == full.to_csv(), "run `python -m tools.build_leaderboard page`"


def test_frozen_faults_are_not_overwritten(monkeypatch, tmp_path):
    monkeypatch.setattr(build_leaderboard, "ROOT", tmp_path)
    (tmp_path / "configs" / "bench").mkdir(parents=True)
    (tmp_path / "bench" / "sites").mkdir(parents=True)
    faults = tmp_path / "bench" / "sites" / "faults.csv"
    faults.write_text("a\n")
    build_leaderboard.freeze(tmp_path / "bench", "quick")
    faults.write_text("b\n")
    with pytest.raises(BadInputError, match=r"other faults than those of sites-quick\.csv, which is frozen"):
        build_leaderboard.freeze(tmp_path / "bench", "quick")
