"""The worth of each rule alone is that of the ledgers; bad input is one line."""

from dataclasses import replace
from pathlib import Path

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import load_bench
from tests.core.unit.analysis.handmade import INSTRUCTION, died, flown, golden, injected, runs
from tools import build_rules
from tools.build_leaderboard import RULES
from tools.build_rules import ALL, SINGLE, main, single_rules


@pytest.fixture
def bench(monkeypatch):
    """One lost mission at each target; each comes back under its own rule and under all of them."""
    arms = (*SINGLE, ALL)
    sites, dead = [golden(1), *(golden(1, arm=arm) for arm in arms)], []
    dead += sites
    lost = flown(success=False)
    for place, (target, number) in enumerate(RULES.items()):
        sites.append(injected(1, lost, index=place, target=target))
        for arm in arms:
            back = arm in (ALL, f"rule {number}")
            sites.append(injected(1, flown() if back else lost, index=place, target=target, arm=arm))
    kernel = replace(INSTRUCTION, kernel="rrt_connect")
    dead.append(injected(1, died(success=False), kernel, target="rrt_connect"))
    for arm in arms:
        dead.append(injected(1, died(success=arm in (ALL, "rule 5")), kernel, arm=arm, target="rrt_connect"))
    ledgers = {"sites": runs(*sites), "instruction": runs(*dead)}
    monkeypatch.setattr(build_rules, "load", lambda folder: ledgers[folder.name])
    return Path("bench")


def test_each_rule_brings_back_its_own_faults(bench):
    rows = single_rules(bench / "sites", bench / "instruction").splitlines()[2:]
    assert len(rows) == len(RULES) + 1
    for row in rows:
        _, number, lost, *cells = (cell.strip() for cell in row.strip("|").split("|"))
        assert lost == "1"
        good = [place for place, cell in enumerate(cells, 1) if cell.strip("*").startswith("100 [")]
        assert good == [int(number), len(cells)]
        assert [place for place, cell in enumerate(cells, 1) if cell.startswith("**")] == [int(number)]


def test_the_shipped_bench_flies_each_rule_and_all():
    assert list(load_bench("five-rules").arms) == [*SINGLE, ALL]


def test_the_tables_go_to_the_page(bench, monkeypatch, tmp_path):
    monkeypatch.setattr(build_rules, "DOCS", tmp_path)
    page = tmp_path / "engineers.md"
    page.write_text("a\n<!-- single-rules:begin -->\n<!-- single-rules:end -->\nb\n")
    assert main([str(bench)]) == 0
    assert "| way-point | 4 | 1 |" in page.read_text()


def test_bad_input_is_one_line(monkeypatch, capsys, tmp_path):
    def absent(folder):
        raise BadInputError(f"{folder}: no ledger")

    monkeypatch.setattr(build_rules, "load", absent)
    assert main([str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert message.startswith("bad input: ") and message.count("\n") == 1
