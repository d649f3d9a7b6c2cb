"""The worth of each rule is that of the ledgers; bad input is one line."""

import pytest

from mavfi.analysis.statistics import Rate
from mavfi.analysis.views import VIEWS
from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import load_bench, published_rows
from tools import build_leaderboard, results
from tools.build_leaderboard import LOST_ALONE, NAME, OBSERVER, main, publish, summary
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


@pytest.mark.parametrize("arguments", [["a"], ["a", "b", "c"], ["no-such-folder", "paper"]])
def test_bad_input_is_one_line(arguments, capsys):
    assert main(arguments) == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith("bad input: ") and stderr.count("\n") == 1


BENCH = load_bench(NAME)
STATE = {"scheme": "gaussian", "faults": "900", "only it lost": "2", "brought back": "20.0 [3.6, 62.4] 1/5"}
OURS = {"scheme": "recommended", "faults": "900", "only it lost": "0", "brought back": "100.0 [56.6, 100.0] 5/5"}
CALLS = {"scheme": "recommended", "faults": "1000", "same value injected": "990", "of these, only it lost": "0"}
ROWS_BY_PART = {
    "sites": [STATE, OURS],
    "state": [STATE, OURS],
    "hardened": [OURS],
    "observer": [{**STATE, "brought back": "100.0 [43.9, 100.0] 3/3"}, {**OURS, "brought back": "—"}],
    "instruction": [STATE, {**CALLS, "brought back": "0/4"}, {"scheme": "readback", "brought back": "3/4"}],
    "sensor": [OURS],
    "golden": [
        {"environment": "dense", "setting": "golden_gaussian", "per hour": "3.0"},
        {"environment": "all", "setting": "golden_gaussian", "per hour": "2.0 [1.0, 3.0]"},
    ],
}


def test_what_is_brought_back_is_the_sum_of_parts_with_every_detector_the_most_first():
    found = summary(BENCH, ROWS_BY_PART)["summary"]
    rows = {row[0]: dict(zip((column.heading for column in found.columns), row, strict=True)) for row in found.rows}
    assert list(rows) == ["recommended", "gaussian", "readback"]
    sums = {
        scheme: {key: (rate.successes, rate.n) for key, rate in row.items() if isinstance(rate, Rate)}
        for scheme, row in rows.items()
    }
    assert sums["recommended"] == {"state": (10, 10), "instruction": (0, 4)}, "part hardened lacks the other one"
    assert sums["gaussian"] == {"state": (2, 10), "instruction": (1, 5), OBSERVER: (3, 3)}
    assert sums["readback"] == {"instruction": (3, 4)}
    assert rows["gaussian"]["false alarms/h, published"] == "2.0 [1.0, 3.0]"


def test_the_columns_are_those_of_the_views():
    for part in BENCH.parts.values():
        headings = {measure.heading for measure in VIEWS[part.view].measures}
        if part.view.startswith("schemes"):
            assert any({lost, flown} <= headings for lost, flown in LOST_ALONE.items()), part.view


def test_the_published_page_has_the_sums_of_the_published_rows():
    rows = {name: published_rows(BENCH, name, "paper") for name in BENCH.parts}
    for name, full in summary(BENCH, rows).items():
        path = results.TABLES / "leaderboard" / f"{name}.csv"
        assert path.read_text(encoding="utf-8") == full.to_csv(), "run `python -m tools.build_leaderboard page`"


def test_rows_of_schemes_that_were_not_flown_remain(tmp_path):
    path = tmp_path / "sites-paper.rows.csv"
    publish(BENCH, path, [{"scheme": "recommended", "lost": "5"}, {"scheme": "gone", "lost": "4"}])
    publish(BENCH, path, [{"scheme": "gaussian", "lost": "3", "late": "1"}, {"scheme": "recommended", "lost": "6"}])
    assert path.read_text(encoding="utf-8") == "scheme,lost,late\ngaussian,3,1\nrecommended,6,\ngone,4,\n"


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
