"""The summary at the head of a leaderboard is the sum of the page's rows."""

import pytest

from mavfi.campaign.analysis.views import VIEWS
from mavfi.campaign.bench import load_bench
from tools import build_leaderboard, build_pages
from tools.bench_summary import BEGIN, COLUMNS, OBSERVER, _sections, brought_back, lost_alone, with_summary
from tools.build_leaderboard import NAME, main

BENCH = load_bench(NAME)
STATE = "| scheme | faults | only it lost |\n| --- | --- | ---: |\n"
CALLS = "| scheme | faults | same value injected | of these, only it lost |\n| --- | --- | ---: | ---: |\n"


def section(part, table):
    return f"## {BENCH.parts[part].title}\n\n{table}\n- a note | with a bar\n"


PAGE = "\n".join([
    "# Top\n\nFlown on 1.\n",
    section("sites", STATE + "| gaussian | 900 | 2 |\n| recommended | 900 | 0 |"),
    section("hardened-state", STATE + "| recommended | 1600 | 0 |"),
    section("observer", STATE + "| recommended | 180 | 7 |"),
    section("instruction", CALLS + "| recommended | 1000 | 990 | 0 |\n| latched | 1000 | 1000 | — |"),
    section("memory", STATE + "| recommended | 500 | 0 |"),
    section("sensor", STATE + "| recommended | 500 | 9 |"),
    "## No part of the bench\n\n" + STATE + "| recommended | 500 | 9 |\n",
])  # fmt: skip


def test_every_part_of_the_levels_counts_and_no_other():
    found = lost_alone(_sections(PAGE, BENCH))
    assert found["recommended"] == {"state": (0, 2500), OBSERVER: (7, 180), "instruction": (0, 990), "memory": (0, 500)}
    assert found["gaussian"] == {"state": (2, 900)} and "latched" not in found


def test_the_sums_stand_at_the_head_with_their_interval():
    top = with_summary(PAGE, BENCH).partition("\n## ")[0]
    assert top.startswith("# Top\n\nFlown on 1.\n\n<!--")
    assert (
        "| recommended | 0/2500 | — | 0/990 | 0/500 | 0 [0, 0.096] 0/3990 | 7/180 | 0.17 [0.081, 0.35] 7/4170 |" in top
    )
    assert "| gaussian | 2/900 | — | — | — | 0.22 [0.061, 0.81] 2/900 | — | 0.22 [0.061, 0.81] 2/900 |" in top


BACK = "| scheme | brought back |\n| --- | ---: |\n"
RANKED = "\n".join([
    "# Top\n\nParts:\n\n- [a](#a)\n",
    section("sites", BACK + "| gaussian | 20.0 [3.6, 62.4] 1/5 |\n| recommended | 100.0 [56.6, 100.0] 5/5 |"),
    section("state", BACK + "| gaussian | 50.0 [9.5, 90.5] 1/2 |\n| recommended | 100.0 [34.2, 100.0] 2/2 |"),
    section("hardened", BACK + "| recommended | 100.0 [34.2, 100.0] 2/2 |"),
    section("observer", BACK + "| gaussian | 100.0 [43.9, 100.0] 3/3 |\n| recommended | — |"),
    section("instruction", BACK + "| gaussian | — |\n| recommended | 0/4 |\n| latched | 75.0 [30.1, 95.4] 3/4 |"),
    section("golden", "| environment | setting | per hour |\n| --- | --- | ---: |\n| dense | golden_gaussian | 3.0 |\n"
            "| all | golden_gaussian | 2.0 [1.0, 3.0] |\n|  | golden_recommended | 0.0 [0.0, 0.3] |"),
])  # fmt: skip


def test_what_is_brought_back_is_the_sum_of_parts_with_every_detector_the_most_first():
    found = brought_back(_sections(RANKED, BENCH), BENCH)
    assert found["recommended"] == {"state": (7, 7), "instruction": (0, 4)}, "part hardened lacks the other one"
    assert found["gaussian"] == {"state": (2, 7), OBSERVER: (3, 3)} and found["latched"] == {"instruction": (3, 4)}
    page = with_summary(RANKED, BENCH)
    head, _, rest = page.partition("\n\nParts:\n")
    assert rest.startswith("\n- [a](#a)\n") and with_summary(page, BENCH) == page
    assert head.splitlines()[5:-1] == [
        "| scheme | state | instruction | coupling observer | false alarms, `published` |",
        "| --- | ---: | ---: | ---: | ---: |",
        "| recommended | 100.0 [64.6, 100.0] 7/7 | 0.0 [0.0, 49.0] 0/4 | — | 0.0 [0.0, 0.3] |",
        "| gaussian | 28.6 [8.2, 64.1] 2/7 | — | 100.0 [43.9, 100.0] 3/3 | 2.0 [1.0, 3.0] |",
        "| latched | — | 75.0 [30.1, 95.4] 3/4 | — | — |",
    ]


def test_a_summary_is_replaced_by_the_next():
    once = with_summary(PAGE, BENCH)
    assert with_summary(once, BENCH) == once and once.partition("\n## ")[2] == PAGE.partition("\n## ")[2]
    again = with_summary(once.replace("| gaussian | 900 | 2 |", "| gaussian | 900 | 3 |"), BENCH)
    assert again.count(BEGIN) == 1 and "| gaussian | 3/900 |" in again and "2/900" not in again
    assert with_summary("# Top\n\n## Other\n\n| x |\n", BENCH) == "# Top\n\n## Other\n\n| x |\n"


def test_the_columns_are_those_of_the_views():
    for part in BENCH.parts.values():
        headings = {measure.heading for measure in VIEWS[part.view].measures}
        if part.view.startswith("schemes"):
            assert any({lost, flown} <= headings for lost, flown in COLUMNS.items()), part.view


def test_sections_that_were_flown_earlier_are_in_the_sum(tmp_path, monkeypatch):
    for name in ("ROOT", "GENERATED", "DOCS", "IMAGES"):
        monkeypatch.setattr(build_leaderboard, name, tmp_path)
    (tmp_path / "configs" / "bench").mkdir(parents=True)
    (tmp_path / "bench").mkdir()
    for part, lost in (("sites", 1), ("memory", 2)):
        flown = "# Top\n\nFlown on 1.\n\n" + section(part, STATE + f"| a | 10 | {lost} |")
        (tmp_path / "bench" / "leaderboard.md").write_text(flown)
        assert main([str(tmp_path / "bench")]) == 0
    assert "| a | 1/10 | — | — | 2/10 | 15 [5.2, 36] 3/20 | — |" in (tmp_path / "leaderboard.md").read_text()


@pytest.mark.parametrize("page", ["leaderboard.md", "leaderboard-paper.md"])
def test_shipped_pages_have_the_sums_of_their_sections(page):
    made = {path.name: text for path, text in build_pages.leaderboards().items()}
    assert made[page] == (build_pages.GENERATED / page).read_text(encoding="utf-8"), "run `make docs`"
